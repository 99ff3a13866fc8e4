"""The start at login survives a login: real sessions of a user, by PAM, logind and systemd."""

import json
import sys

import pytest

from tests.servers import booted
from tests.servers.listening import need
from tools.sound_server import missing_programs

pytestmark = pytest.mark.servers

LIMIT_S = 120.0  # 15 s where nothing else runs


@pytest.fixture(scope="module")
def logins(tmp_path_factory):
    need(missing_programs("pipewire"))
    if why := booted.why_not():
        pytest.skip(why)
    folder = tmp_path_factory.mktemp("logins")
    booted.run(folder, [sys.executable, "-m", "tests.servers.logins", str(folder)], LIMIT_S)
    return json.loads((folder / "result.json").read_text())


def test_without_a_device_the_page_starts_no_daemon_but_what_setup_prints_does_now(logins):
    assert "names no device" in logins["page before"]["error"]
    before = logins["before"]
    assert (before["activestate"], before["unitfilestate"]) == ("inactive", "")
    assert logins["told"] == ["systemctl --user restart cushion.service"]
    assert_plays(logins["set up"], "cinema")


def test_what_setup_or_the_page_switched_on_starts_by_itself_at_the_next_login(logins):
    assert_plays(logins["after setup"], "cinema")
    assert logins["after setup"]["mainpid"] != logins["set up"]["mainpid"]
    assert logins["page says on"] == {"done": True, "autostart": True}
    assert logins["switched on"]["activestate"] == "inactive"
    assert_plays(logins["after on"], "music")


def test_another_setup_or_an_edit_that_is_reloaded_acts_at_once(logins):
    assert_plays(logins["set up again"], "game")
    assert_plays(logins["reloaded"], "music")
    assert logins["reloaded"]["mainpid"] == logins["set up again"]["mainpid"]


def test_what_the_page_switched_off_runs_until_the_end_of_the_session_and_not_again(logins):
    assert logins["page says off"] == {"done": True, "autostart": False}
    now, later = logins["switched off"], logins["after off"]
    assert (now["activestate"], now["unitfilestate"]) == ("active", "disabled")
    assert (later["activestate"], later["unitfilestate"]) == ("inactive", "disabled")


def test_undone_setups_leave_nothing_that_runs(logins):
    assert_plays(logins["undone once"], "cinema")
    for which in ("undone", "after undo"):
        assert (logins[which]["activestate"], logins[which]["unitfilestate"]) == ("inactive", "")


def assert_plays(seen, profile):
    assert (seen["activestate"], seen["unitfilestate"]) == ("active", "enabled")
    assert (seen["nrestarts"], seen["status"]["profile"]) == ("0", profile)
    assert seen["status"]["device"]["name"] == "haptic"
