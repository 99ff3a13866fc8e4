"""The page "Try it" in a real browser: files, bad input, outputs, and times without a network."""

import gzip
import json
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import psutil
import pytest
import soundfile

from audioflinger_hook.monitor.try_page import PROFILES, RATES, first_files, page_files
from tests.browser.conftest import says
from tests.servers.listening import ATTEMPTS, RATE_HZ, arriving, need, wait_for
from tests.support.commands import call
from tests.support.recordings import ROOT
from tools import try_page
from tools.live_page import CHROMIUM, CHROMIUM_OPTIONS, browser, missing_browser
from tools.sound_server import SoundServer, missing_programs

pytestmark = pytest.mark.browser

FAKES = ("--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream")
PLAYS_ALONE = "--autoplay-policy=no-user-gesture-required"
PLAY = "document.getElementById('player').play()"
LOOP = "document.getElementById('player').loop = true"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of the page, on a server of static files."""
    need(missing_browser())
    folder = tmp_path_factory.mktemp("site") / "try"
    try_page.write(folder)
    with try_page.server(folder, 0) as serving:
        threading.Thread(target=serving.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{serving.server_port}/"
        serving.shutdown()


@pytest.fixture(scope="module")
def chromium(site):
    with browser() as first, another(first, *FAKES, PLAYS_ALONE) as found:
        yield found


def another(chromium, *options: str, **how):
    """Return another browser, which plays sound and closes itself."""
    own = {"args": [*CHROMIUM_OPTIONS, *options], "ignore_default_args": ["--mute-audio"], **how}
    return chromium.browser_type.launch(executable_path=CHROMIUM, headless=True, **own)


@contextmanager
def opened(chromium, site, script="", allowed=(), **options):
    """A context with the page; the console must stay empty, and other origins unasked."""
    context, said = chromium.new_context(**options), []
    context.add_init_script(script)
    page = context.new_page()
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on(
        "request", lambda asked: said.extend({asked.url} if is_foreign(asked.url, site) else ())
    )
    page.goto(site)
    page.wait_for_function("document.getElementById('profile').length || !window.WebAssembly")
    yield page
    context.close()
    assert [one for one in said if one not in allowed] == []


def is_foreign(url: str, site: str) -> bool:
    return not url.startswith((site, "blob:"))


def saved(page, path: Path, profile: str, folder: Path) -> bytes:
    """Return the WAV that the page saves for a sound."""
    page.select_option("#profile", profile)
    page.set_input_files("#sound", path)
    page.click("#make")
    page.wait_for_selector("#vibration[data-state=done]", timeout=120_000)
    with page.expect_download() as download:
        page.click("#vibration")
    download.value.save_as(folder / "saved.wav")
    return (folder / "saved.wav").read_bytes()


def sound(folder: Path, rate: int, channels: int, subtype: str) -> Path:
    path, rng = folder / f"{channels}-{subtype}.wav", np.random.default_rng(rate)
    frames = rng.normal(0.0, 0.3, (rate, channels)) * np.hanning(rate)[:, None]
    if subtype == "FLOAT":
        frames[100:110], frames[200] = 1e30, np.nan
    soundfile.write(path, frames, rate, subtype)
    return path


def rendered(path: Path, profile: str, folder: Path) -> bytes:
    assert call("render", path, folder / "rendered.wav", "--profile", profile).code == 0
    return (folder / "rendered.wav").read_bytes()


FORMS = [(2, "PCM_16"), (1, "PCM_U8"), (8, "PCM_24"), (2, "FLOAT"), (6, "DOUBLE"), (1, "PCM_32")]


@pytest.mark.parametrize("rate", RATES)
def test_a_saved_file_has_the_bytes_of_render(site, chromium, rate, tmp_path):
    with opened(chromium, site) as page:
        for profile, form in zip([*PROFILES, "cinema", "game"], FORMS, strict=True):
            path = sound(tmp_path, rate, *form)
            expected = rendered(path, profile, tmp_path)
            assert saved(page, path, profile, tmp_path) == expected, (profile, form)


def test_sounds_of_other_rates_and_formats_are_decoded_by_the_browser(site, chromium, tmp_path):
    with opened(chromium, site) as page:
        saved(page, sound(tmp_path, 8_000, 1, "PCM_16"), "cinema", tmp_path)
        says(page, "#status", "Its 8000 Hz were converted to 48000 Hz.")
        assert soundfile.info(tmp_path / "saved.wav").duration == pytest.approx(1.0, abs=0.01)
        soundfile.write(tmp_path / "x.flac", np.zeros((RATE_HZ, 2)), RATE_HZ)
        saved(page, tmp_path / "x.flac", "music", tmp_path)
        says(page, "#status", "The browser decoded it")


def three_hours(path: Path) -> None:
    soundfile.write(path, np.zeros(1, np.int16), RATE_HZ, "PCM_16")
    size, head = 2 * 3 * 3_600 * RATE_HZ, path.read_bytes()[:40]
    path.write_bytes(head + size.to_bytes(4, "little"))
    with path.open("r+b") as file:
        file.truncate(44 + size)


def three_compressed_hours(path: Path) -> None:
    with soundfile.SoundFile(path, "w", 8_000, 1, "PCM_16", format="FLAC") as file:
        for _ in range(180):
            file.write(np.zeros(60 * 8_000, np.int16))


def three_streamed_hours(path: Path) -> None:
    three_compressed_hours(path)
    head = path.read_bytes()
    path.write_bytes(head[:21] + bytes([head[21] & 0xF0, 0, 0, 0, 0]) + head[26:])  # no length


BAD_FILES = {
    "is no sound that this browser can read": lambda path: path.write_text("no sound\n" * 99),
    "is empty (0 bytes)": lambda path: path.write_bytes(b""),
    "has no sound: it lasts 0 s": lambda path: soundfile.write(path, np.zeros((0, 2)), RATE_HZ),
    "lasts 180 minutes and needs 2.1 GB of memory; at most 1.0 GB": three_hours,
    "lasts 180 minutes and needs 6.2 GB of memory; at most 1.0 GB": three_compressed_hours,
    "lasts 180 minutes and needs 6.2 GB of memory": three_streamed_hours,
    "has no length that this browser can read": lambda path: path.write_bytes(b"no" * 10**7),
    "has 9 channels; at most 8": lambda path: soundfile.write(path, np.zeros((9, 9)), RATE_HZ),
}


@pytest.mark.parametrize("words", BAD_FILES)
def test_a_file_that_cannot_be_used_is_refused_in_one_line(site, chromium, words, tmp_path):
    BAD_FILES[words](tmp_path / "bad.wav")
    with opened(chromium, site) as page:
        page.set_input_files("#sound", tmp_path / "bad.wav")
        if page.is_enabled("#make"):
            page.click("#make")
        says(page, "#status", words)
        assert page.get_attribute("#vibration", "data-state") == "none"
        assert page.inner_text("#make") == "Make the vibration as a file"
        assert page.is_disabled("#make")


NO = "Promise.reject(new DOMException('', 'NotAllowedError'))"
REFUSED = f"navigator.mediaDevices.getDisplayMedia = () => {NO}"


@pytest.mark.parametrize(
    ("script", "press", "words"),
    [
        ("delete window.WebAssembly", None, "lacks WebAssembly"),
        ("delete window.AudioWorkletNode", None, "it lacks AudioWorklet"),
        ("", "#microphone", "The microphone was refused"),
        ("", "#find", "name the outputs only with this permission"),
        (REFUSED, "#screen", "No tab was shared"),
    ],
)
def test_what_a_browser_lacks_or_a_person_refuses_is_said(site, chromium, script, press, words):
    with another(chromium, FAKES[0]) as plain, opened(plain, site, script) as page:
        if press:
            page.click(press)
        says(page, "#status", words)
        assert page.get_attribute("#state", "data-tone") == "bad"


def apart_ms(page) -> float:
    words = page.inner_text("#apart").split()
    return float(words[words.index("ms") - 1]) if "ms" in words else 1e9


DROP = """async () => {
  const dropped = new DataTransfer(), scene = await fetch("chord.wav");
  dropped.items.add(new File([await scene.blob()], "dropped.wav"));
  document.body.dispatchEvent(new DragEvent("drop", { dataTransfer: dropped, bubbles: true }));
}"""
CHOOSES = """navigator.mediaDevices.selectAudioOutput = async () =>
  (await navigator.mediaDevices.enumerateDevices()).findLast((one) => one.kind == "audiooutput")"""


def test_a_file_can_be_dropped_and_a_browser_may_ask_for_the_output_itself(site, chromium):
    with opened(chromium, site, CHOOSES) as page:
        page.evaluate(DROP)
        says(page, "#status", "dropped.wav is chosen")
        page.click("#find")
        says(page, "#status", "Vibration plays on Fake Audio Output 2")
        assert "Fake Audio Output 2" in page.inner_text("#output option:checked")


KEEPS = """const devices = navigator.mediaDevices, asks = devices.getUserMedia.bind(devices);
window.streams = [];
devices.getUserMedia = async (wanted) => {
  streams.push(await asks(wanted));
  return new Promise((allow) => setTimeout(allow, 500, streams.at(-1)));
};"""
ACTIVE = "streams.map(({ active }) => active)"
UNPLUGGED = "streams[0].getTracks()[0].dispatchEvent(new Event('ended'))"


def test_a_microphone_may_be_unplugged(site, chromium):
    with opened(chromium, site, KEEPS) as page:
        page.click("#microphone")
        says(page, "#status", "becomes vibration")
        page.evaluate(UNPLUGGED)
        says(page, "#status", "has ended or was unplugged. Choose a sound.")
        assert page.is_hidden("#stop")


def test_a_microphone_that_is_no_longer_wanted_is_closed(site, chromium):
    with opened(chromium, site, KEEPS) as page:
        page.dblclick("#microphone")
        says(page, "#status", "becomes vibration")
        wait_for(lambda: page.evaluate(ACTIVE) == [False, True], "one open microphone")
        page.click("#microphone")
        page.evaluate(DROP)
        wait_for(lambda: page.evaluate(ACTIVE) == [False] * 3, "no open microphone")
        says(page, "#status", "dropped.wav is chosen")


GAME_IS_SLOW = """const loads = window.fetch, Node = window.AudioWorkletNode;
const later = (name) => new Promise((settle) => setTimeout(settle, 1000 * name.startsWith("game")));
window.fetch = (name) => later(name).then(() => loads(name));
window.AudioWorkletNode = function (context, name, options) {
  return Object.assign(new Node(context, name, options), options.processorOptions);
};"""


def test_the_profile_that_is_shown_plays_although_another_comes_later(site, chromium):
    with opened(chromium, site, GAME_IS_SLOW) as page:
        page.select_option("#profile", "game")
        page.click("[data-scene=engine]")
        for profile, wait_ms in (("game", 300), ("speech", 2_000), ("game", 0), ("music", 2_000)):
            page.select_option("#profile", profile)
            page.wait_for_timeout(wait_ms)
            if wait_ms == 2_000:
                rate, *plays = page.evaluate("[cushion.context.sampleRate, ...cushion.node.design]")
                assert bytes(plays) == page_files()[f"{profile}-{rate}.design"]()


@pytest.mark.parametrize("way", ["", "delete AudioContext.prototype.setSinkId"])
def test_vibration_plays_only_on_a_chosen_output_and_together(site, chromium, way):
    with opened(chromium, site, way) as page:
        page.click("[data-scene=chord]")
        wait_for(lambda: page.evaluate("window.cushion.partials.length") > 2, "partials")
        says(page, "#apart", "silent and only shown")
        page.evaluate(LOOP)
        page.evaluate(PLAY)
        says(page, "#power-word", "Vibration is only shown")
        page.click("#power")
        says(page, "#power-word", "Vibration is off")
        says(page, "#vibration-meters", "silent")
        page.click("#power")
        wait_for(lambda: "silent" not in page.inner_text("#vibration-meters"), "vibration")
        page.click("#find")
        says(page, "#status", "Choose the output of the vibration, not your speakers")
        assert "Default" not in page.inner_text("#output")
        page.select_option("#output", index=1)
        page.evaluate(PLAY)
        says(page, "#status", "Vibration plays on Fake Audio Output 1")
        says(page, "#power-word", "Vibration is on")
        wait_for(lambda: apart_ms(page) < 5.0, "one clock beside the other", 20.0)
        page.evaluate("navigator.mediaDevices.enumerateDevices = async () => []")
        page.evaluate("navigator.mediaDevices.dispatchEvent(new Event('devicechange'))")
        says(page, "#status", "The output of the vibration has gone")
        for source in ("microphone", "screen"):
            page.click(f"#{source}")
            says(page, "#status", "becomes vibration")
        page.click("#stop")


def test_a_drifting_clock_is_followed():
    if not shutil.which("node"):
        pytest.skip("node is not installed")
    drift = ["node", str(ROOT / "tests/support/drifting_clocks.mjs")]
    found = json.loads(subprocess.run(drift, capture_output=True, text=True, check=True).stdout)
    for ppm, one in found.items():
        assert (one["worst_ms"] < 5.0, one["dry"]) == (True, 0), (ppm, one)
        assert one["told_ppm"] == pytest.approx(float(ppm), abs=40.0)


BY_CHROMIUM = [  # what it says itself, before a page knows, when an output is unplugged
    "The AudioContext encountered an error from the audio device or the WebAudio renderer."
]


def begins(frames) -> np.ndarray:
    """Return the frames at which bursts begin."""
    loud = np.flatnonzero(np.abs(frames) > 0.3 * np.abs(frames).max())
    return loud[np.insert(np.diff(loud) > 0.15 * RATE_HZ, 0, True)]


def test_sound_and_vibration_come_together_on_two_sinks(site, chromium, tmp_path):
    need(missing_programs("pipewire"))
    time_s = np.arange(40 * RATE_HZ) / RATE_HZ
    bursts = 0.5 * np.sin(2 * np.pi * 150.0 * time_s) * (time_s % 0.5 < 0.2)
    soundfile.write(tmp_path / "bursts.wav", np.stack([bursts, bursts], 1), RATE_HZ)
    rendered(tmp_path / "bursts.wav", "cinema", tmp_path)
    made, _ = soundfile.read(tmp_path / "rendered.wav")
    offline_ms = 1e3 * (begins(made)[2] - begins(bursts)[2]) / RATE_HZ
    with (
        tempfile.TemporaryDirectory(prefix="cushion-") as folder,
        SoundServer("pipewire", Path(folder)) as sinks,
        another(chromium, PLAYS_ALONE, env=sinks.environment) as listening,
        opened(listening, site, allowed=BY_CHROMIUM, permissions=["microphone"]) as page,
    ):
        page.set_input_files("#sound", tmp_path / "bursts.wav")
        page.evaluate(LOOP)
        page.evaluate(PLAY)
        page.click("#find")
        says(page, "#output", "haptic")
        page.select_option("#output", label="haptic")
        with (
            arriving(sinks, "desktop.monitor") as heard,
            arriving(sinks, "haptic.monitor") as felt,
        ):
            for _ in range(5):  # after a dropout of a busy machine, the clocks are found again
                first = [len(of.frames()) for of in (heard, felt)]
                page.wait_for_timeout(10_000)
                at_s = [
                    [of.at_s(begun + int(at)) for at in begins(of.frames()[begun:, 0])]
                    for of, begun in zip((heard, felt), first, strict=True)
                ]
                late = [1e3 * min((f - h for f in at_s[1]), key=abs) for h in at_s[0][1:-1]]
                print(
                    f"late: {np.median(late):.1f} ms, {offline_ms:.1f} in the file", np.round(late)
                )
                if abs(np.median(late) - offline_ms) < 5.0:
                    break
            else:
                raise AssertionError("sound and vibration stay apart")
        sinks.remove("haptic")
        says(page, "#status", "The output of the vibration has gone")


def test_the_page_works_without_a_network_after_the_first_visit(
    site, chromium, tmp_path, monkeypatch
):
    contents, asked = page_files(), set()
    monkeypatch.setattr(
        try_page.Handler, "log_request", lambda self, *_: asked.add(self.path.lstrip("/"))
    )
    with opened(chromium, site) as page:
        wait_for(lambda: page.evaluate("navigator.serviceWorker.controller !== null"), "worker")
        first = {name or "index.html" for name in asked}
        wire = sum(len(gzip.compress(contents[name]())) for name in first)
        print(f"{wire} bytes over the wire, compressed")
        assert (first, wire < 250_000) == ({*first_files(), "offline.js"}, True)
        page.click("[data-scene=engine]")
        kept = "caches.keys().then(([name]) => caches.open(name)).then((all) => all.keys())"
        wait_for(lambda: len(page.evaluate(kept)) == len(contents), "all files")
        page.context.set_offline(True)
        page.reload()
        path = sound(tmp_path, 48_000, 2, "PCM_16")
        for profile in ("cinema", "speech"):
            assert saved(page, path, profile, tmp_path) == rendered(path, profile, tmp_path)


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("size", [(1366, 768), (390, 844), (360, 640)])
def test_everyone_can_use_the_page(site, chromium, size, theme, tmp_path):
    viewport = {"width": size[0], "height": size[1]}
    spec = find_spec("axe_playwright_python")
    if spec is None or not spec.submodule_search_locations:
        pytest.skip("axe-playwright-python is not installed")
    axe = Path(spec.submodule_search_locations[0], "axe.min.js").read_text()
    with opened(chromium, site, viewport=viewport, color_scheme=theme) as page:
        page.evaluate(axe)
        for press, words in (("[data-scene=engine]", "plays"), ("#make", "Done: 4")):
            page.click(press)
            says(page, "#status", words)
            assert page.evaluate("axe.run()")["violations"] == []
        (tmp_path / "bad").write_bytes(b"")
        page.set_input_files("#sound", tmp_path / "bad")
        says(page, "#status", "is empty")
        assert page.evaluate("axe.run()")["violations"] == []
        assert page.evaluate("document.documentElement.scrollWidth") <= size[0]
        page.click("[data-scene=engine]")
        says(page, "#status", "plays")
        reached = set()
        for _ in range(30):
            page.keyboard.press("Tab")
            reached.add(page.evaluate("document.activeElement.id"))
        assert {"sound", "profile", "make", "output", "find", "strength", "power"} <= reached


DELAY = """() => new Promise((settle) => {
  const { context, node } = window.cushion, { port1, port2 } = new MessageChannel(), felt = [];
  const tone = new OscillatorNode(context, { frequency: 1000 }), begin = context.currentTime + 0.5;
  tone.connect(node);
  tone.start(begin);
  tone.stop(begin + 0.1);
  port1.onmessage = ({ data: { frame, samples } }) => {
    const first = frame - Math.round(begin * context.sampleRate);
    samples.forEach((sample, at) => { if (first + at >= 0) felt[first + at] = sample; });
    if (felt.length > 0.05 * context.sampleRate) settle([context.sampleRate, felt]);
  };
  node.port.postMessage({ to: port2 }, [port2]);
})"""  # the vibration from the start of a tone on, in the page's live AudioContext


def half_of_peak_ms(rate: float, felt: list[float]) -> float:
    level = np.abs(felt)
    return 1e3 * float(np.argmax(level > 0.5 * level.max())) / rate


def test_a_film_is_made_fast_and_can_be_cancelled_and_live_sound_is_felt_soon(
    site, chromium, tmp_path
):
    frames = np.tile(np.random.default_rng(3).normal(0.0, 0.1, (10 * RATE_HZ, 2)), (60, 1))
    soundfile.write(tmp_path / "film.wav", frames, RATE_HZ, "PCM_16")
    with opened(chromium, site) as page:
        page.set_input_files("#sound", tmp_path / "film.wav")
        page.click("#make")
        for act in (lambda: page.click("#make"), lambda: page.select_option("#profile", "game")):
            wait_for(
                lambda: page.evaluate("document.getElementById('progress').value") > 0.05, "some"
            )
            act()
            says(page, "#status", "Cancelled.")
            page.click("#make")
        page.click("#make")
        for _ in range(ATTEMPTS):
            saved(page, tmp_path / "film.wav", "cinema", tmp_path)
            status = page.inner_text("#status")
            if (speed := float(status.partition("made ")[2].split()[0])) >= 25.0:
                break
        page.click("[data-scene=engine]")
        says(page, "#status", "Engine plays")
        page.evaluate("document.getElementById('player').pause()")
        delay_ms = np.median([half_of_peak_ms(*page.evaluate(DELAY)) for _ in range(9)])
        print(f"{status} Half of the peak after {delay_ms:.1f} ms.")
        assert speed >= 25.0
        assert delay_ms < 15.0


PLAIN = "void new ConstantSourceNode(window.plain = new AudioContext()).connect(plain.destination)"
LOST = """async () => {
  const began = [window.cushion.context, window.plain].map(() => []);
  for (let at = 0; at < 600; at++) {
    [window.cushion.context, window.plain].forEach(({ currentTime }, which) =>
      began[which].push(performance.now() - 1000 * currentTime));
    await new Promise((settle) => setTimeout(settle, 1));
  }
  return began.map((values) => Math.min(...values));
}"""
QUANTUM_MS = 2.6


def lost_ms(page, seconds, meanwhile=lambda page: None):
    """Milliseconds of sound lost by the page, and by a context without a worklet."""
    page.click("[data-scene=engine]")
    page.evaluate(LOOP)
    page.evaluate(PLAIN)
    page.wait_for_timeout(8_000)
    first = np.array(page.evaluate(LOST))
    page.wait_for_timeout(1e3 * seconds)
    meanwhile(page)
    return np.array(page.evaluate(LOST)) - first


def test_interruptions_of_15_ms_are_not_heard_in_the_sound_of_a_file(site, chromium):
    def interrupt(page):
        own = [one for one in psutil.Process().children(recursive=True) if "chrom" in one.name()]
        for _ in range(40):
            for act, then_ms in ((psutil.Process.suspend, 15), (psutil.Process.resume, 300)):
                for process in own:
                    act(process)
                threading.Event().wait(1e-3 * then_ms)

    with opened(chromium, site) as page:
        own_ms, plain_ms = lost_ms(page, 0, interrupt)
    assert own_ms < 0.2 * plain_ms, (own_ms, plain_ms)


@pytest.mark.soak
def test_no_quantum_is_missed_in_twenty_minutes(site, chromium):
    """On a calm machine; a busy one stops a context without a worklet, too."""
    with opened(chromium, site) as page:
        own_ms, plain_ms = lost_ms(page, 1_200)
    print(f"lost in 20 minutes: {own_ms:.2f} ms, without a worklet {plain_ms:.2f} ms")
    if own_ms > QUANTUM_MS and plain_ms > QUANTUM_MS:
        pytest.skip("the machine is too busy for any sound of the browser")
    assert own_ms <= QUANTUM_MS
