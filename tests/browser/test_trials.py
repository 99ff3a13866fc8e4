"""Trials through the page in a real browser: played by a daemon on a server, answered by clicks."""

import queue
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

from audioflinger_hook.trials.page import AGAIN, UNKNOWN, Answer, PageAnswers, StoppedError, screen
from audioflinger_hook.trials.person import Person
from audioflinger_hook.trials.player import DaemonPlayer, Played
from tests.servers.daemons import FELT, felt_now, running, tone
from tests.servers.listening import RATE_HZ, need, recording, wait_for
from tests.servers.test_trials import SECONDS, WITHIN_FRAMES, lags, link_a_clock
from tools.live_latency.bursts import recorded_together
from tools.live_page import browser, missing_browser
from tools.sound_server import SoundServer, missing_programs

pytestmark = pytest.mark.browser

TRIALS = 20
CHOICES = ("1", "First", "1"), ("2", "Second", "2"), AGAIN, UNKNOWN
STRONGER = screen("choice", "Which was stronger?", choices=CHOICES[:2], also=CHOICES[2:])
PLAYING = screen("playing", "Feel and listen", total=TRIALS)
SOUNDS = [(name, name, str(n)) for n, name in enumerate(["Rain", "Door", "Speech"], 1)]
SCREENS = {
    "choice": STRONGER,
    "slider": screen("slider", "How well?", labels=("bad", "good"), practice=True, total=3),
    "one of": screen("one of", "Which was it?", choices=SOUNDS, also=[AGAIN], done=2, total=3),
    "text": screen("text", "Consent", "You may stop.", choices=[("yes", "I agree", "1")]),
    "playing": PLAYING,
    "end": screen("text", "Thank you", "You can close this page."),
}


class Study:
    """The daemon's player, the page, and a browser that shows it. errors: of its console."""

    def __init__(self, server: SoundServer, chromium: Any) -> None:
        self.server, self._chromium = server, chromium
        self.player = DaemonPlayer(time.monotonic)
        self.errors: list[str] = []
        told: queue.SimpleQueue[str] = queue.SimpleQueue()
        self.answers = PageAnswers(self.player.stop, told.put, time.time)
        self.person = Person(self.player, self.answers)
        self._context = chromium.new_context()
        self.address = partial(told.get, timeout=10.0)
        self.page = self.open()
        assert self.player.wait(10.0)

    def open(self) -> Any:
        page = self._context.new_page()
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("console", self._note)
        page.goto(self.address())
        return page

    def _note(self, said: Any) -> None:
        if said.type == "error" and "WebSocket" not in said.text:  # the server may be away
            self.errors.append(said.text)

    def close(self) -> None:
        self.answers.close()
        self.player.close()
        self._context.close()


@pytest.fixture(scope="module")
def server() -> Iterator[SoundServer]:
    need([*missing_browser(), *missing_programs("pipewire")])
    with (
        tempfile.TemporaryDirectory(prefix="cushion-") as folder,
        SoundServer("pipewire", Path(folder)) as made,
        running(made, engine="native"),
        pytest.MonkeyPatch.context() as patch,
    ):
        for name in ("XDG_RUNTIME_DIR", "PULSE_SERVER", "PULSE_COOKIE", "PIPEWIRE_RUNTIME_DIR"):
            if name in made.environment:
                patch.setenv(name, made.environment[name])
        yield made


@pytest.fixture(scope="module")
def chromium(server: SoundServer) -> Iterator[Any]:
    with browser() as found:
        yield found


@pytest.fixture
def study(server, chromium):
    with closing(Study(server, chromium)) as made:
        yield made
    assert made.errors == []


@pytest.fixture
def wav(tmp_path) -> Callable[[Any, str], Path]:
    def written(samples: Any, name: str) -> Path:
        path: Path = tmp_path / name
        soundfile.write(path, samples, RATE_HZ, subtype="FLOAT")
        return path

    return written


class InBackground:
    """Runs the session beside the browser, which only this test's thread may use."""

    def __init__(self, work: Callable[[], Any]) -> None:
        self._found: list[Any] = []
        self._thread = threading.Thread(target=lambda: self._run(work), daemon=True)
        self._thread.start()

    def _run(self, work: Callable[[], Any]) -> None:
        try:
            self._found.append(work())
        except Exception as error:  # `result` raises it
            self._found.append(error)

    def result(self, page: Any = None) -> Any:
        wait_for(lambda: self._found or (page and page.wait_for_timeout(10)), "a result", 30.0)
        if isinstance(self._found[0], Exception):
            raise self._found[0]
        return self._found[0]


def test_20_trials_are_heard_and_felt_together_and_answered(study, wav, tmp_path):
    noise = wav(np.random.default_rng(1).uniform(-0.4, 0.4, round(SECONDS * RATE_HZ)), "n.wav")
    wanted = [CHOICES[number % 4] for number in range(TRIALS)]
    both = ("desktop", "monitor_FL"), ("haptic", "monitor_FL")

    def session() -> list[tuple[Played, Answer]]:
        found = []
        for _ in wanted:
            played = study.person.play(noise, noise, PLAYING)
            found.append((played, study.answers.ask(STRONGER)))
        return found

    with recorded_together(*both, tmp_path, study.server.environment, RATE_HZ) as path:
        link_a_clock(study.server)
        running_session = InBackground(session)
        question = study.page.locator("h1", has_text=STRONGER["title"])
        for number, (_, label, key) in enumerate(wanted):
            question.wait_for()
            if number % 2:
                study.page.keyboard.press(key)
            else:
                study.page.get_by_role("button", name=label).click()
            if number + 1 < TRIALS:
                question.wait_for(state="detached")
        found = running_session.result(study.page)
    found_lags = lags(path)
    print(found_lags)
    assert len(found_lags) == TRIALS
    assert max(np.abs(found_lags)) <= WITHIN_FRAMES
    assert [answer.value for _, answer in found] == [value for value, _, _ in wanted]
    assert all(0.0 < answer.after_s < 5.0 for _, answer in found)
    levels = [played.level_dbfs for played, _ in found]
    felt = soundfile.read(path)[0][:, 1]
    level_db = 10.0 * np.log10(np.sum(felt**2) / (TRIALS * SECONDS * RATE_HZ))
    assert levels == pytest.approx([level_db] * TRIALS, abs=0.3)
    study.server.remove("clock")


@pytest.mark.parametrize("how", ["closed", "paused"])
def test_a_page_closed_or_paused_in_mid_trial_stops_it_and_the_trial_is_played_again(
    study, wav, how, tmp_path
):
    long = wav(tone(70.0, 4.0)[:, 0], "long.wav")
    with recording(study.server, "haptic.monitor", tmp_path / "felt") as felt:
        playing = InBackground(lambda: study.person.play(long, long, PLAYING))
        wait_for(lambda: felt_now(felt, 0.2), "vibration")
        if how == "closed":
            study.page.close()
        else:
            study.page.click("#pause")
        wait_for(lambda: np.abs(felt()[-RATE_HZ // 2 :]).max() < FELT, "silence", 1.5)
        ends = int(np.flatnonzero(np.abs(felt()[:, 0]) > FELT)[-1])
        if how == "closed":
            study.page = study.open()
        study.page.click("#go-on")
        played = playing.result(study.page)
    assert (played.stopped, played.seconds) == (False, pytest.approx(4.0, abs=0.01))
    last = felt()[ends - RATE_HZ // 20 : ends + 1, 0]
    assert np.abs(last[: RATE_HZ // 100]).max() > 0.1
    assert (
        np.abs(np.diff(last)).max() < 0.01
    )  # the end is a fade, whatever the machine loses before


def test_a_device_unplugged_in_mid_trial_is_told_and_the_trial_is_played_again(
    study, wav, tmp_path
):
    long = wav(tone(70.0, 4.0)[:, 0], "long.wav")
    playing = InBackground(lambda: study.person.play(long, long, PLAYING))
    study.page.locator("h1", has_text=PLAYING["title"]).wait_for()
    study.server.remove("haptic")
    study.page.locator("h1", has_text="One moment").wait_for()
    assert "waiting-for-device" in study.page.inner_text("#screen")
    study.server.add_sink("haptic")
    assert not playing.result(study.page).stopped


def test_a_rating_needs_a_movement_and_a_person_can_stop(study):
    rating = InBackground(lambda: study.answers.ask(SCREENS["slider"]))
    study.page.locator("h1", has_text="How well?").wait_for()
    assert study.page.get_by_role("button", name="Next").is_disabled()
    study.page.locator("input[type=range]").focus()
    for _ in range(5):
        study.page.keyboard.press("ArrowRight")
    study.page.keyboard.press("Enter")
    assert rating.result(study.page).value == 55
    asked = InBackground(lambda: study.answers.ask(STRONGER))
    study.page.locator("h1", has_text=STRONGER["title"]).wait_for()
    study.page.click("#stop")
    study.page.click("#end")
    with pytest.raises(StoppedError, match="all answers are kept"):
        asked.result(study.page)
    study.page.locator("h1", has_text="The session has ended").wait_for()


@pytest.mark.parametrize("size", [(1366, 768), (390, 844)], ids=str)
@pytest.mark.parametrize("theme", ["dark", "light"])
def test_axe_finds_no_violation_and_each_screen_fits(study, size, theme):
    spec = find_spec("axe_playwright_python")
    if spec is None or not spec.submodule_search_locations:
        pytest.skip("axe-playwright-python is not installed")
    axe = Path(spec.submodule_search_locations[0], "axe.min.js").read_text()
    page, found = study.page, {}
    page.emulate_media(color_scheme=theme)
    page.set_viewport_size({"width": size[0], "height": size[1]})
    for name, question in SCREENS.items():
        study.answers.show(question)
        page.locator("h1", has_text=question["title"]).wait_for()
        page.evaluate(axe)
        found[name] = [one["id"] for one in page.evaluate("axe.run()")["violations"]]
        room = page.evaluate("[document.documentElement.scrollWidth, document.body.scrollHeight]")
        assert (room[0] <= size[0], room[1] <= size[1]) == (True, True), name
    assert found == {name: [] for name in SCREENS}
