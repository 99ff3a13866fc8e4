"""A live page on a private sound server, and a browser that shows the page.

    python -m tools.live_page [--out docs/images] [--moving]

writes the pictures of the live page for the docs. With --moving, it writes an animation (live.webp)
of the demo scene instead.

The tests use `served` and `browser` directly. tools/fetch_servers.sh and tools/fetch_browser.sh
install the required programs.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from base64 import b64decode
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.io import wavfile

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from audioflinger_hook.monitor.access import new_code
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from tools.sound_server import SoundServer

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

ROOT = Path(__file__).resolve().parents[1]
CUSHION = (sys.executable, "-m", "audioflinger_hook")
CHROMIUM = "/usr/bin/chromium"
CHROMIUM_OPTIONS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
START_S = 20.0
MOVING_WIDTH, MOVING_HEIGHT = 1000, 760
"""In pixels: width of the animation, and height of the shown part of a page 1280 pixels wide."""

MOVING_HZ, MOVING_S, MOVING_AFTER_S = 10.0, 7.5, 5.0
MOVING_BYTES_MAX = 2_000_000
FILLED_S = 10.6  # time until the chart of 10 s is full; the scene's chord follows
VIBRATION_S, TRY_S = 5.0, 0.05  # longest wait for strong vibration, and period of the checks
STRONG, STRONG_COUNT = 0.03, 4  # strong vibration: least amplitude, least number of partials
ENGINE_S = 3.6  # time in the scene "engine" with strong vibration
QUIET = np.float32(0.05)  # gain of the second application
VIEWS = [(size, theme) for size in ((1366, 768), (390, 844)) for theme in ("dark", "light")]
"""Width and height of the page in pixels, and its theme, for each picture."""


def missing_browser() -> list[str]:
    """Return the names of programs and packages that browser tests need, but that are missing."""
    missing = [] if shutil.which(CHROMIUM) else ["chromium"]
    try:
        import playwright  # noqa: F401
    except ModuleNotFoundError:
        missing.append("playwright")
    return missing


class Monitor:
    """A running `cushion monitor`.

    environment: environment variables of the process. address: address of the page with a code,
        which works once; "" if the process ended. key: the page's key.
        stderr: text on standard error so far.
    """

    def __init__(self, environment: Mapping[str, str], *options: str) -> None:
        self._environment = environment
        self.process = subprocess.Popen(
            [*CUSHION, "monitor", *options],
            env={**environment, "PYTHONPATH": str(ROOT)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.stderr = ""
        self._told = threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        if not self._told.wait(START_S):
            self.close()
            raise RuntimeError(f"the page does not start: {self.stderr}")
        self.address = self.stderr.partition("the live page: ")[2].partition("\n")[0]
        self.base = self.address.partition("#")[0]
        self.host = self.base.removeprefix("http://").rstrip("/")
        self.port = int(self.host.rpartition(":")[2] or 0)

    @property
    def key(self) -> str:
        """The key that gives access to the page."""
        return Path(self._environment["XDG_RUNTIME_DIR"], "cushion", "page.token").read_text()

    def new_address(self) -> str:
        """Return the page's address with another code."""
        with RuntimeFolder(self._environment, create=False) as folder:
            return f"{self.base}#{new_code(folder, time.time())}"

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.stderr += line
            if "it opens once" in line:
                self._told.set()
        self._told.set()

    def close(self) -> int:
        """End the process and return its exit code."""
        self.process.terminate()
        try:
            code = self.process.wait(10.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            code = self.process.wait()
        self._reader.join(5.0)
        assert self.process.stderr is not None
        self.process.stderr.close()
        return code


@contextmanager
def served(server: SoundServer, *options: str) -> Iterator[Monitor]:
    """A context in which `cushion monitor` serves the page on a free port of this computer."""
    monitor = Monitor(server.environment, "--listen", "127.0.0.1:0", *options)
    try:
        yield monitor
    finally:
        monitor.close()
        sys.stderr.write(monitor.stderr)


@contextmanager
def browser() -> Iterator[Browser]:
    """A context with a headless browser, the system's Chromium."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        found = playwright.chromium.launch(
            executable_path=CHROMIUM, headless=True, args=list(CHROMIUM_OPTIONS)
        )
        try:
            yield found
        finally:
            found.close()


@contextmanager
def player(server: SoundServer, wav: Path, name: str) -> Iterator[None]:
    """A context in which a program, called `name`, plays a WAV file."""
    process = subprocess.Popen(
        ["pacat", "--playback", f"--client-name={name}", "--file-format=wav", str(wav)],
        env=server.environment,
        stdin=subprocess.DEVNULL,
    )
    try:
        yield
    finally:
        process.terminate()
        process.wait()


@contextmanager
def cinema() -> Iterator[tuple[SoundServer, Path, Monitor, Browser]]:
    """A context with a daemon, its page, a browser, and a WAV file of the demo scene."""
    with ExitStack() as stack:
        base = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="cushion-")))
        server = stack.enter_context(SoundServer("pipewire", base / "s"))
        environment = {**server.environment, "PYTHONPATH": str(ROOT)}
        capture = base / "scene"
        command = [*CUSHION, "capture", str(capture), "--tap", "scene:demo"]
        subprocess.run(command, env=environment, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        wav = next(capture.glob("*.wav"))
        run = [*CUSHION, "run", "--device", "haptic"]
        daemon = subprocess.Popen(run, env=environment, cwd=ROOT)
        stack.callback(daemon.wait)
        stack.callback(daemon.terminate)
        monitor = stack.enter_context(served(server))
        yield server, wav, monitor, stack.enter_context(browser())


def take_pictures(folder: Path) -> None:
    """Write a picture of the first screen for each size and theme; for phones also of the end."""
    with cinema() as (server, wav, monitor, chromium):
        # The daemon compensates a stream's volume, so a quieter file is needed.
        samplerate, frames = wavfile.read(wav)
        quiet = wav.with_name("quiet.wav")
        wavfile.write(quiet, samplerate, QUIET * frames)
        for (width, height), theme in VIEWS:
            with player(server, wav, "Film player"), player(server, quiet, "Web browser"):
                page = open_page(chromium, monitor.new_address(), width, theme)
                page.set_viewport_size({"width": width, "height": height})
                page.wait_for_timeout(1e3 * FILLED_S)
                wait_for_vibration(page)
                kind = "page" if width > 500 else "phone"
                page.screenshot(path=folder / f"{kind}-{theme}.png")
                if kind == "phone":
                    page.evaluate("scrollTo(0, document.body.scrollHeight)")
                    wait_for_vibration(page)
                    page.screenshot(path=folder / f"{kind}-below-{theme}.png")
                page.close()
        for (width, height), theme in VIEWS:
            page = open_page(chromium, f"{monitor.base}try/", width, theme)
            page.set_viewport_size({"width": width, "height": height})
            page.click("[data-scene=engine]")
            page.wait_for_timeout(1e3 * ENGINE_S)
            page.screenshot(path=folder / f"try-{'phone-' if width < 500 else ''}{theme}.png")
            page.close()


def wait_for_vibration(page: Page) -> None:
    """Wait until the page shows strong vibration, since the scene has pauses."""
    strong = f"window.cushion.partials.filter(({{ amplitude }}) => amplitude > {STRONG}).length"
    for _ in range(round(VIBRATION_S / TRY_S)):
        if page.evaluate(strong) >= STRONG_COUNT:
            page.wait_for_timeout(300)  # the words change at most every 250 ms
            return
        page.wait_for_timeout(1e3 * TRY_S)
    raise RuntimeError(f"the page shows no strong vibration within {VIBRATION_S:g} s")


def take_moving_picture(path: Path) -> None:
    """Write an animation, of at most 2 MB, that shows the upper part of the page."""
    from PIL import Image

    shots: list[tuple[float, bytes]] = []
    with cinema() as (server, wav, monitor, chromium), player(server, wav, "Film player"):
        page = open_page(chromium, monitor.new_address(), 1280, "dark")
        page.set_viewport_size({"width": 1280, "height": MOVING_HEIGHT})
        session = page.context.new_cdp_session(page)

        def keep(shot: dict[str, Any]) -> None:
            shots.append((shot["metadata"]["timestamp"], b64decode(shot["data"])))
            session.send("Page.screencastFrameAck", {"sessionId": shot["sessionId"]})

        page.wait_for_timeout(1e3 * MOVING_AFTER_S)
        session.on("Page.screencastFrame", keep)
        session.send("Page.startScreencast", {"format": "jpeg", "quality": 95})
        page.wait_for_timeout(1e3 * MOVING_S)
        session.send("Page.stopScreencast")
        session.remove_listener("Page.screencastFrame", keep)
    print(f"{len(shots) / (shots[-1][0] - shots[0][0]):.1f} pictures a second were drawn")
    frames = []
    for number in range(int((shots[-1][0] - shots[0][0]) * MOVING_HZ)):
        at_s = shots[0][0] + number / MOVING_HZ
        newest = max((shot for shot in shots if shot[0] <= at_s), key=lambda shot: shot[0])
        frame = Image.open(BytesIO(newest[1]))
        size = (MOVING_WIDTH, round(MOVING_WIDTH * frame.height / frame.width))
        frames.append(frame.resize(size, Image.Resampling.LANCZOS))
    for quality in (80, 70, 60, 50, 40, 30):
        made = BytesIO()
        frames[0].save(
            made,
            "WEBP",
            save_all=True,
            append_images=frames[1:],
            duration=round(1e3 / MOVING_HZ),
            loop=0,
            quality=quality,
            method=4,
        )
        if made.tell() <= MOVING_BYTES_MAX:
            path.write_bytes(made.getvalue())
            print(f"{path}: {made.tell()} bytes, {len(frames)} pictures, quality {quality}")
            return
    raise RuntimeError(f"{path} would have {made.tell()} bytes; at most {MOVING_BYTES_MAX}")


def open_page(chromium: Browser, address: str, width: int, theme: str) -> Page:
    """Open the page in a new browser context, with a width in pixels and a theme, dark or light."""
    context = chromium.new_context(
        viewport={"width": width, "height": 900 if width > 500 else 844},
        color_scheme="light" if theme == "light" else "dark",
        device_scale_factor=1.0 if width > 500 else 2.0,
    )
    page = context.new_page()
    page.goto(address)
    return page


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the pictures, or the animation with --moving."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs/images")
    parser.add_argument("--moving", action="store_true", help="record the animation instead")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    if options.moving:
        take_moving_picture(options.out / "live.webp")
    else:
        take_pictures(options.out)


if __name__ == "__main__":
    main()
