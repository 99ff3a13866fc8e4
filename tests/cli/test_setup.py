from pathlib import Path

import numpy as np
import pytest

from audioflinger_hook.cli import setup_files
from audioflinger_hook.cli.outputs import CARD, COILS, SOUND, USB, Output, advice_for, list_outputs
from audioflinger_hook.cli.setup import PLAYED, SPEECH_FREE, _named, _new_text, _profile_values
from audioflinger_hook.cli.test_tone import Tone
from audioflinger_hook.config.edits import commented_text
from audioflinger_hook.config.file import check_text
from audioflinger_hook.config.profiles import LIVE_DEFAULT, PROFILES
from audioflinger_hook.config.schema import keys_of
from audioflinger_hook.service import autostart
from device.address import parse_device
from device.errors import UsageError
from device.server import ServerSnapshot
from device.server.snapshot import Sink
from device.stream.pcms import FALLBACK_SINK
from tests.support.commands import call, refused

QUAD = "front-left,front-right,rear-left,rear-right"
SURROUND = f"{QUAD},front-center,lfe,side-left,side-right"
DUALSENSE = {"device_bus": "usb", "device_vendor_id": "054c", "device_product_id": "0ce6"}


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("CONFIG_HOME", "DATA_HOME", "STATE_HOME", "RUNTIME_DIR"):
        monkeypatch.setenv(f"XDG_{name}", str(tmp_path / name.partition("_")[0].lower()))
    monkeypatch.setenv("PULSE_SERVER", f"unix:{tmp_path}/none")
    monkeypatch.setattr(autostart, "BOOTED", Path("/"))
    return tmp_path


@pytest.fixture
def path(home: Path) -> Path:
    (home / "config/cushion").mkdir(parents=True)
    return home / "config/cushion/config.toml"


def sink(name: str, positions: str = "front-left,front-right", **properties: str) -> Sink:
    channels = positions.count(",") + 1
    known = {key.replace("_", "."): value for key, value in properties.items()}
    return Sink(1, name, name, "", 48_000, channels, None, known, channel_map=positions)


def snapshot(*sinks: Sink, default: str = "speakers") -> ServerSnapshot:
    return ServerSnapshot("PulseAudio", "16.1", default, "", sinks, (), (), (), 0)


def test_without_a_server_it_ends_as_every_command_does(home: Path) -> None:
    done = call("setup", "--yes", "--device", "haptic")
    if done.code == 3:  # where not even the servers' library is installed
        assert "install it (libpulse0)" in refused(done, code=3)
    else:
        assert "sound server" in refused(done, code=4)
    assert not list(home.rglob("config.toml"))


def test_a_config_with_mistakes_is_left_to_its_owner(path: Path) -> None:
    path.write_text("profile = 7\n")
    assert "line 1: profile" in refused(call("setup", "--yes", "--device", "haptic"))
    assert path.read_text() == "profile = 7\n"


def test_what_cannot_be_done_is_refused_with_what_can_and_each_profile_asked_for_exists() -> None:
    error = refused(call("setup"))
    assert "not a terminal" in error
    assert "--yes --device DEVICE" in error
    assert "did you mean cinema?" in refused(call("setup", "--yes", "--profile", "cinena"))
    assert "nothing to undo" in refused(call("setup", "--undo"))
    assert set(PLAYED) - {SPEECH_FREE} <= set(PROFILES)


def test_voice_coils_come_first_and_what_plays_the_sound_last() -> None:
    pad = sink("pad", QUAD, **DUALSENSE)
    dac = sink("dac", **DUALSENSE | {"device_product_id": "ffff"})
    own = (sink("cushion"), sink(FALLBACK_SINK))  # are no outputs
    found = list_outputs(snapshot(sink("speakers"), sink("other"), dac, pad, *own), (), ())
    names = [output.address.removeprefix("sink:") for output in found]
    assert names == ["pad", "dac", "other", "speakers"]
    assert [found[0].rank, found[1].rank, found[3].rank] == [COILS, USB, SOUND]
    assert "channels 3 and 4" in found[0].note


def test_a_named_output_is_found_behind_a_card_that_no_server_uses() -> None:
    card = Output("hw:Card,0", "a card", CARD, "")
    speakers = Output("sink:speakers", "", SOUND, "plays the sound")
    seen = snapshot(sink("speakers"))
    assert _named(parse_device("speakers"), [card, speakers], seen).rank == SOUND


@pytest.mark.parametrize(
    ("positions", "wanted"),
    [
        (SURROUND, '[[actuator]] channels = ["side-left", "side-right"]'),
        (QUAD, '[[actuator]] channels = ["rear-left", "rear-right"]'),
        ("front-left,front-right", ""),
    ],
)
def test_the_advice_for_many_channels_is_valid_in_a_config(positions: str, wanted: str) -> None:
    assert advice_for(sink("card", positions)).endswith(wanted)
    assert check_text(wanted.replace("]] ", "]]\n"), Path(), LIVE_DEFAULT)[1] == []


@pytest.mark.parametrize("device", ['sink:a "b" \\ c', "usb:152a:8750"])
def test_a_new_config_holds_every_top_level_key_and_says_what_was_chosen(device: str) -> None:
    values = {"device": device, "gain_db": -12.0, "transform.speech_suppression_db": 12.0}
    text = commented_text(values, ("side-left",))
    found, mistakes = check_text(text, Path(), LIVE_DEFAULT)
    assert found is not None
    assert not mistakes
    assert (found.live.device, found.settings.gain_db) == (device, -12.0)
    assert found.settings.parameters.speech_suppression_db == 12.0
    assert found.settings.actuators[0].channels == ("side-left",)
    for name in keys_of(""):
        assert f"\n{name} = " in text or f"\n# {name} =" in text
    lines = [line.removeprefix("# ") for line in text.splitlines()]
    given = [line for line in lines if line.partition(" = ")[0] in keys_of("") and " = " in line]
    bare = "\n".join(given)
    assert check_text(bare, Path(), LIVE_DEFAULT)[1] == []  # every default is a valid value


@pytest.mark.parametrize("profile", ["cinema", "game"])
def test_another_choice_ends_what_was_written_to_leave_out_speech(home: Path, profile: str) -> None:
    path = home / "config.toml"
    text = _new_text(path, None, {"device": "sink:haptic", **_profile_values(SPEECH_FREE)}, ())
    text = _new_text(path, text, _profile_values(profile, text), ())
    found, _ = check_text(text, home, LIVE_DEFAULT)
    assert found is not None
    assert found.settings.profile == profile
    assert found.settings.parameters.speech_suppression_db == 0.0
    own = text + "speech_suppression_db = 6.0\n"  # its section is the last one
    assert _new_text(path, own, _profile_values(profile, own), ()) == own


def test_undo_gives_back_each_earlier_state_and_keeps_later_edits(home: Path, path: Path) -> None:
    unit = home / "config/systemd/user/cushion.service"
    mine = b"\xef\xbb\xbf# mine\r\n"
    path.write_bytes(mine)
    setup_files.write(path, setup_files.text_of(path), "gain_db = -1.0\n", with_service=True)
    assert unit.exists()
    setup_files.write(path, "gain_db = -1.0\n", "gain_db = -2.0\n", with_service=False)
    path.write_text("gain_db = -3.0\n")
    done, commands = setup_files.undo()
    undone = path.with_name("config.toml.undone")
    assert (path.read_text(), undone.read_text()) == ("gain_db = -1.0\n", "gain_db = -3.0\n")
    assert len(done) == 2
    assert unit.exists()
    assert not commands
    setup_files.undo()
    assert path.read_bytes() == mine
    assert not unit.exists()
    assert sorted(path.parent.iterdir()) == [path, undone]


@pytest.mark.parametrize("booted", ["/", "/nowhere"])
def test_undo_says_what_it_did_with_and_without_systemd(home, path, monkeypatch, booted):
    monkeypatch.setattr(autostart, "BOOTED", Path(booted))
    setup_files.write(path, None, "gain_db = -1.0\n", with_service=True)
    menu, unit = (next(home.rglob(f"*{name}"), None) for name in ("-cushion.desktop", ".service"))
    done = setup_files.undo()[0]
    removed = [f"{file}: removed" for file in (path, menu, unit) if file]
    assert sorted(done) == sorted([*removed, "start at login: off"])
    assert (len(removed) == 3) == (booted == "/")
    assert not [file for file in home.rglob("*cushion*") if file.is_file()]


@pytest.mark.parametrize("services", [(False,), (False, True), (True, False)], ids=str)
def test_the_menu_has_the_page_until_the_first_setup_is_undone(
    home: Path, path: Path, services: tuple[bool, ...]
) -> None:
    entry = home / "data/applications/haptic-cushion.desktop"
    before = None
    for number, with_service in enumerate(services):
        text = f"gain_db = -{number}.0\n"
        setup_files.write(path, before, text, with_service=with_service)
        before = text
        assert entry.exists()
    for _ in services:
        assert entry.exists()
        setup_files.undo()
    assert not [each for each in (home / "data").rglob("*") if each.is_file()]


def test_a_config_that_changed_or_whose_backup_is_gone_is_left_alone(path: Path) -> None:
    path.write_text("gain_db = -1.0\n")
    with pytest.raises(UsageError, match="changed during the setup"):
        setup_files.write(path, None, "gain_db = -2.0\n", with_service=False)
    assert path.read_text() == "gain_db = -1.0\n"
    backup = setup_files.write(path, "gain_db = -1.0\n", "gain_db = -2.0\n", with_service=False)
    Path(backup).unlink()
    with pytest.raises(UsageError, match="is not changed"):
        setup_files.undo()
    assert path.read_text() == "gain_db = -2.0\n"


@pytest.mark.parametrize("obstacle", ["config/systemd", "state/cushion"])
@pytest.mark.parametrize("mine", [None, "gain_db = -1.0  # mine\n"])
def test_a_setup_that_fails_half_way_leaves_everything_as_it_was(home, path, obstacle, mine):
    if mine is not None:
        path.write_text(mine)
    (home / obstacle).parent.mkdir(exist_ok=True)
    (home / obstacle).write_text("in the way of a folder")
    with pytest.raises(UsageError, match="cannot"):
        setup_files.write(path, mine, "gain_db = -2.0\n", with_service=True)
    found = {each for each in home.rglob("*") if each.is_file()}
    assert found == {home / obstacle} | ({path} if mine else set())
    assert setup_files.text_of(path) == mine
    (home / obstacle).unlink()
    with pytest.raises(UsageError, match="nothing to undo"):
        setup_files.undo()


@pytest.mark.parametrize("mine", [None, "gain_db = -1.0\n"])
def test_undoing_keeps_later_changes_that_are_no_text(path: Path, mine: str | None) -> None:
    if mine is not None:
        path.write_text(mine)
    setup_files.write(path, mine, "gain_db = -2.0\n", with_service=False)
    path.write_bytes(b"\xff\x00")
    setup_files.undo()
    assert path.with_name("config.toml.undone").read_bytes() == b"\xff\x00"
    assert setup_files.text_of(path) == mine


def test_damaged_records_are_reported_before_anything_is_written(home: Path, path: Path) -> None:
    path.write_text("gain_db = -1.0\n")
    (home / "state/cushion").mkdir(parents=True)
    (home / "state/cushion/setup-undo.json").write_text("[[")
    with pytest.raises(UsageError, match="move it away"):
        setup_files.write(path, "gain_db = -1.0\n", "gain_db = -2.0\n", with_service=True)
    assert (list(path.parent.iterdir()), path.read_text()) == ([path], "gain_db = -1.0\n")


def test_a_tone_fades_in_without_a_step_and_ends_by_itself() -> None:
    tone = Tone("dac", 50.0, 48_000, [1])
    tone.play(0.5, 1.0, 0.5)
    blocks = []
    while not tone.ended.is_set():
        blocks.append(np.zeros((500, 2), np.float32))
        tone.fill(blocks[-1], 0.0)
    silent, wave = np.concatenate(blocks).T
    assert not np.any(silent)
    # A sine of 0.5 at 50 Hz changes by 0.0033 a frame at most.
    assert np.abs(np.diff(wave)).max() < 0.0034
    assert np.abs(wave[:4_800]).max() < 0.11  # a fifth of the fade
    assert np.abs(wave[24_000:40_000]).max() == pytest.approx(0.5, rel=1e-3)
    assert len(wave) == pytest.approx(48_000, abs=1_500)
