"""A live page on a sound server of its own, and the browser that looks at it.

    python -m tools.live_page [--out docs/images]    the pictures of the page in docs

The tests use `served` and `browser` directly. tools/fetch_servers.sh and tools/fetch_browser.sh
install what is needed.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tools.sound_server import SoundServer

if TYPE_CHECKING:
    from playwright.sync_api import Browser, FloatRect, Page

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
VIEWS = [(width, theme) for width in (1280, 390) for theme in ("dark", "light")]


def missing_browser() -> list[str]:
    """Return what a browser test lacks."""
    missing = [] if shutil.which(CHROMIUM) else ["chromium"]
    try:
        import playwright  # noqa: F401
    except ModuleNotFoundError:
        missing.append("playwright")
    return missing


class Monitor:
    """A running `cushion monitor`.

    environment: of its process. address: of the page, with its token; "" where it ended instead.
    stderr: what it has written.
    """

    def __init__(self, environment: Mapping[str, str], *options: str) -> None:
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
        self.address = self.stderr.partition("the live page: ")[2].strip()
        self.base, _, self.token = self.address.partition("#")
        self.host = self.base.removeprefix("http://").rstrip("/")
        self.port = int(self.host.rpartition(":")[2] or 0)

    @property
    def cookie(self) -> str:
        """The cookie that opens the page."""
        return f"cushion_{self.port}={self.token}"

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.stderr += line
            if "the live page: " in line:
                self._told.set()
        self._told.set()

    def close(self) -> int:
        """End it; return its exit code."""
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
    """A page on a free port of this computer."""
    monitor = Monitor(server.environment, "--listen", "127.0.0.1:0", *options)
    try:
        yield monitor
    finally:
        monitor.close()
        sys.stderr.write(monitor.stderr)


@contextmanager
def browser() -> Iterator[Browser]:
    """The system's Chromium, without a screen."""
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
def player(server: SoundServer, wav: Path, name: str, volume: float = 1.0) -> Iterator[None]:
    """A program of this name that plays a WAV file to the default sink; volume: a share."""
    process = subprocess.Popen(
        [
            *("pacat", "--playback", f"--client-name={name}", f"--volume={int(65_536 * volume)}"),
            *("--file-format=wav", str(wav)),
        ],
        env=server.environment,
        stdin=subprocess.DEVNULL,
    )
    try:
        yield
    finally:
        process.terminate()
        process.wait()


def take_pictures(folder: Path) -> None:
    """Write pictures of the page while the demo's scene plays."""
    with ExitStack() as stack:
        base = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="cushion-")))
        server = stack.enter_context(SoundServer("pipewire", base / "s"))
        environment = {**server.environment, "PYTHONPATH": str(ROOT)}
        capture = base / "scene"
        command = [*CUSHION, "capture", str(capture), "--tap", "scene:demo"]
        subprocess.run(command, env=environment, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        wav = next(capture.glob("*.wav"))
        run = [*CUSHION, "run", "--device", "haptic", "--profile", "cinema"]
        daemon = subprocess.Popen(run, env=environment, cwd=ROOT)
        stack.callback(daemon.wait)
        stack.callback(daemon.terminate)
        monitor = stack.enter_context(served(server))
        chromium = stack.enter_context(browser())
        for width, theme in VIEWS:
            with player(server, wav, "Film player"), player(server, wav, "Web browser", 0.05):
                page = open_page(chromium, monitor.address, width, theme)
                time.sleep(12.0)  # the waterfall shows ten seconds
                kind = "page" if width > 500 else "phone"
                tall = 1900.0 if kind == "page" else 1700.0
                clip: FloatRect = {"x": 0.0, "y": 0.0, "width": float(width), "height": tall}
                page.screenshot(path=folder / f"{kind}-{theme}.png", full_page=True, clip=clip)
                page.close()


def open_page(chromium: Browser, address: str, width: int, theme: str) -> Page:
    """Open the page in a browser of its own."""
    context = chromium.new_context(
        viewport={"width": width, "height": 900 if width > 500 else 844},
        color_scheme="light" if theme == "light" else "dark",
        device_scale_factor=1.0 if width > 500 else 2.0,
    )
    page = context.new_page()
    page.goto(address)
    return page


def main(arguments: Sequence[str] | None = None) -> None:
    """Take the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs/images")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    take_pictures(options.out)


if __name__ == "__main__":
    main()
