"""A whole study in a real browser: a session with a daemon on a server, and the reports."""

import json
import re
import tempfile
import threading
from contextlib import closing
from importlib.util import find_spec
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from scipy.signal import sosfilt

from device.drive.exposure import wk_sections
from tests.servers.daemons import environment
from tests.servers.listening import RATE_HZ, need, wait_for
from tests.servers.test_trials import SECONDS, WITHIN_FRAMES, lags, link_a_clock
from tests.support.commands import call, start
from tests.support.studies import QUESTIONS, TRUTHS, make_study
from tools.live_latency.bursts import recorded_together
from tools.live_page import browser, missing_browser
from tools.sound_server import SoundServer, missing_programs

pytestmark = pytest.mark.browser

CONTROLLER = """(index) => {
  window.pressed = index;
  const buttons = () => Array.from({ length: 17 }, (_, i) => ({ pressed: i === window.pressed }));
  navigator.getGamepads = () => [null, { buttons: buttons() }];
  dispatchEvent(new Event("gamepadconnected"));
}"""
TRIALS, LATE_MS, WEAK_DB = 20, 40.0, -6.0
ASKED = "Which vibration fits the sound better?"
CONDITIONS = {"own": "", "late": f"delay_ms = {LATE_MS}", "weak": f"gain_db = {WEAK_DB}"}
DESIGN = (
    'title = "Three"\nparticipants = 2\nlevel_db = -30\nblock = 10\nfastest_s = 0\n'
    + "".join(
        f'[[condition]]\nname = "{name}"\nmethod = "noise.wav"\n{more}\n'
        for name, more in CONDITIONS.items()
    )
    + '[[question]]\nname = "fits"\nparadigm = "preference"\nstimuli = ["noise.wav"]\n'
    f"conditions = {[*CONDITIONS]}\nrepeats = 6\n"
)


@pytest.fixture(scope="module")
def chromium():
    need(missing_browser())
    with browser() as found:
        yield found


class Session:
    """A running `cushion study run`, and a browser on its page."""

    def __init__(self, folder, env, chromium):
        asked = ("study", "run", folder, "--participant", "P01", "--device", "sink:haptic")
        self.process: Any = start(*asked, env=env)
        self.said: list[str] = []
        self._reader = threading.Thread(
            target=lambda: self.said.extend(iter(self.process.stdout.readline, "")), daemon=True
        )
        self._reader.start()
        said = lambda: re.search("http://[^ \n]+", "".join(self.said))  # noqa: E731
        self._context = chromium.new_context(viewport={"width": 390, "height": 844})
        self.page = self._context.new_page()
        self.page.goto(wait_for(said, "an address", 60.0)[0])

    def press(self, question, name):
        """Click a button of the screen with this heading, and wait for the next screen."""
        shown = self.page.locator("h1", has_text=question)
        shown.wait_for()
        self.page.get_by_role("button", name=name).click()
        shown.wait_for(state="detached")

    def press_on_a_controller(self, question, index):
        """Press a button of a controller, and hold it until the next screen."""
        shown = self.page.locator("h1", has_text=question)
        shown.wait_for()
        self.page.evaluate(CONTROLLER, index)
        shown.wait_for(state="detached")
        self.page.evaluate("pressed = -1")

    def close(self):
        self._context.close()
        self.process.kill()
        self.process.wait()
        self._reader.join()
        self.process.stdout.close()
        self.process.stderr.close()


def weighted_db(felt):
    return 10.0 * np.log10(np.sum(sosfilt(wk_sections(RATE_HZ), felt) ** 2))


def test_a_study_of_three_conditions_through_the_page_and_the_daemon(chromium, tmp_path):
    need(missing_programs("pipewire"))
    study = tmp_path / "study"
    study.mkdir()
    (study / "design.toml").write_text(DESIGN)
    noise = np.random.default_rng(1).uniform(-0.2, 0.2, round(SECONDS * RATE_HZ))
    soundfile.write(study / "noise.wav", noise, RATE_HZ, subtype="FLOAT")
    both = ("desktop", "monitor_FL"), ("haptic", "monitor_FL")
    with (
        tempfile.TemporaryDirectory(prefix="cushion-") as folder,
        SoundServer("pipewire", Path(folder)) as server,
        closing(Session(study, environment(server), chromium)) as session,
        recorded_together(*both, tmp_path, server.environment, RATE_HZ) as path,
    ):
        link_a_clock(server)
        session.press("Consent", "I agree")
        for number in range(TRIALS):
            if number == 12:  # the block is over: 10 trials after 2 for practice
                session.press("Pause", "Go on")
            if number == 4:
                session.press_on_a_controller(ASKED, 1)
            else:
                session.press(ASKED, "First" if number % 2 else "Second")
        session.page.locator("h1", has_text="The end").wait_for()
        assert session.process.wait(20.0) == 0
    rows = [json.loads(line) for line in (study / "data/P01.jsonl").read_text().splitlines()]
    assert [row["trial"] for row in rows[1:]] == list(range(1, TRIALS + 1))
    wanted = ["2", "1"] * (TRIALS // 2)
    wanted[4] = rows[5]["choices"][1]
    assert [row["answer"] for row in rows[1:]] == wanted
    played = [row[f"condition_{i}"] for row in rows[1:] for i in (1, 2)]
    heard, felt = soundfile.read(path)[0].T
    loud = np.flatnonzero(np.abs(heard) > 1e-4)
    begins = loud[np.diff(loud, prepend=-RATE_HZ) > RATE_HZ // 10]
    # A busy machine makes intervals fail, which are played again. The rows have the times of those
    # that count. The recording also loses frames, so that only differences of times are alike.
    began_s = np.array([row[f"sound_began_s_{i}"] for row in rows[1:] for i in (1, 2)])
    apart_s = lambda some: np.diff(np.delete(begins, some)) / RATE_HZ - np.diff(began_s)  # noqa: E731
    failed = min(
        combinations(range(len(begins)), len(begins) - len(began_s)),
        key=lambda some: np.abs(apart_s(some)).sum(),
    )
    found, begins = (np.delete(one, failed) for one in (lags(path), begins))
    begins -= int(np.flatnonzero(np.abs(noise) > 1e-4)[0])
    levels: dict[str, list[float]] = {name: [] for name in CONDITIONS}
    for begin, name, lag in zip(begins, played, found, strict=True):
        # Where the recording has lost frames, neither lag nor level can be measured.
        if np.allclose(heard[begin : begin + len(noise)], noise, atol=1e-4):
            print(name, lag)
            assert abs(lag - LATE_MS * RATE_HZ / 1e3 * (name == "late")) <= WITHIN_FRAMES
            parts = felt[begin + lag : begin + len(noise)], noise[: len(noise) - lag]
            level_db, whole_db = map(weighted_db, parts)
            levels[name].append(level_db - whole_db - WEAK_DB * (name == "weak"))
    print(levels)
    assert all(levels.values())
    assert np.ptp(np.concatenate([*levels.values()])) <= 0.5
    assert call("study", "report", study).code == 0
    shown, complaints = opened_report(chromium, study / "report.html", 390)
    assert complaints == []
    assert "1 of 2 participants began" in shown.inner_text("main")
    assert "SIMULATED" not in shown.inner_text("main")
    shown.context.close()


def opened_report(chromium, path, width, theme="light"):
    """Return the page of a report, and what axe, the console and the width complain of."""
    spec = find_spec("axe_playwright_python")
    if spec is None or not spec.submodule_search_locations:
        pytest.skip("axe-playwright-python is not installed")
    size = {"width": width, "height": 800}
    page = chromium.new_context(viewport=size, color_scheme=theme).new_page()
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda said: complaints.append(said.text))
    page.goto(f"file://{path}")
    page.evaluate(Path(spec.submodule_search_locations[0], "axe.min.js").read_text())
    complaints += [one["id"] for one in page.evaluate("axe.run()")["violations"]]
    if page.evaluate("document.documentElement.scrollWidth") > width:
        complaints.append("wider than the window")
    return page, complaints


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("simulated")
    more = "reference_share = 1"
    make_study(folder, *QUESTIONS, participants=3, more=more)
    (folder / "people.json").write_text(json.dumps({"people": 3, "questions": TRUTHS}))
    assert call("study", "run", folder, "--simulate", folder / "people.json").code == 0
    assert call("study", "report", folder).code == 0
    return folder / "report.html"


@pytest.mark.parametrize("width", [1366, 390])
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_each_question_has_a_figure_and_a_table_and_what_is_simulated_says_so(
    chromium, simulated, width, theme
):
    page, complaints = opened_report(chromium, simulated, width, theme)
    assert complaints == []
    sections = page.locator("section")
    assert sections.count() == len(QUESTIONS)
    for number in range(len(QUESTIONS)):
        figures = sections.nth(number).locator("figure")
        assert figures.count() >= 1
        assert all("SIMULATED" in text for text in figures.all_text_contents())
        assert sections.nth(number).locator("table").count() >= 1
    page.context.close()
