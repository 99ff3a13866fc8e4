"""`cushion fit --page` in a real browser: clicks of whoever feels the vibration of the device."""

import json
import re
import tempfile
import threading
from pathlib import Path
from typing import Any

import pytest

from tests.servers.daemons import environment
from tests.servers.listening import need, recording, wait_for
from tests.servers.test_fit import error_db, key_for
from tests.support.commands import start
from tools.live_page import browser, missing_browser
from tools.sound_server import SoundServer, missing_programs

pytestmark = pytest.mark.browser

TRIALS, KILLED_AFTER = 20, 6


class Fit:
    """A running `cushion fit --page` and the page that it serves."""

    def __init__(self, env, chromium):
        asked = ("fit", "--device", "sink:haptic", "--page", "--minutes", "1", "--json")
        self.process: Any = start(*asked, env=env)
        self.said: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        found = wait_for(
            lambda: re.search("http://[^ \n]+", "".join(self.said)), "an address", 40.0
        )
        self.page = chromium.new_page()
        self.page.goto(found[0])

    def _read(self):
        self.said.extend(iter(self.process.stderr.readline, ""))

    def close(self):
        self.page.close()
        self.process.kill()
        self.process.wait()
        self._reader.join()
        for stream in (self.process.stdout, self.process.stderr):
            stream.close()

    def click(self, question, name):
        title = self.page.locator("h1", has_text=question)
        title.wait_for()
        self.page.get_by_role("button", name=name).click()
        title.wait_for(state="detached")


def test_clicks_on_the_page_give_a_fit_and_kill_9_loses_none(tmp_path):
    need([*missing_browser(), *missing_programs("pipewire")])
    with (
        tempfile.TemporaryDirectory(prefix="cushion-") as folder,
        SoundServer("pipewire", Path(folder)) as server,
        browser() as chromium,
        recording(server, "haptic.monitor", tmp_path / "felt") as felt,
    ):
        env = {**environment(server), "XDG_STATE_HOME": str(tmp_path)}

        def opened():
            fit = Fit(env, chromium)
            for name in ["Stronger"] * 6 + ["Clear and comfortable"]:
                fit.click("How strong", name)
            return fit

        def answer(count):
            for _ in range(count):
                fit.page.locator("h1", has_text="Which vibration").wait_for()
                fit.click("Which vibration", {b"1": "First", b"2": "Second"}[key_for(felt)])

        fit = opened()
        answer(KILLED_AFTER)
        record = tmp_path / "cushion/fit/sink-haptic.jsonl"
        wait_for(lambda: record.read_bytes().count(b"\n") > KILLED_AFTER, "the last answer")
        fit.close()
        kept = record.read_bytes()
        fit = opened()  # the level starts low again
        answer(TRIALS - KILLED_AFTER - 1)
        fit.page.locator("h1", has_text="Which vibration").wait_for()
        fit.page.get_by_role("button", name={b"1": "First", b"2": "Second"}[key_for(felt)]).click()
        done = json.loads(fit.process.stdout.read())
        assert fit.process.wait() == 0
        fit.close()
    assert (done["accepted"], done["trials"]) == (True, TRIALS)
    assert done["resumed_trials"] == KILLED_AFTER
    assert record.with_suffix(".last.jsonl").read_bytes().startswith(kept)
    assert error_db(done) < 2.5
