"""A sound server, a daemon, a page and a browser, which the tests of one file share."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.servers.daemons import Daemon, running, tone
from tests.servers.listening import need, own_server, playing, wait_for
from tests.support.data import text
from tools.live_page import Monitor, browser, missing_browser, open_page, served
from tools.sound_server import SoundServer, missing_programs

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

CONFIG = text("page-config.toml")


@dataclass
class Room:
    """All of it. errors: what the browser's console complained of."""

    server: SoundServer
    daemon: Daemon
    monitor: Monitor
    chromium: Browser
    config: Path
    errors: list[str] = field(default_factory=list)

    def open(self, width: int = 1280, theme: str = "dark") -> Page:
        """Open the page and its details, and wait until it shows the daemon."""
        page = open_page(self.chromium, self.monitor.new_address(), width, theme)
        page.on("console", lambda said: self.complain(said.type, said.text))
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        state(page, "Running", "Idle")
        page.evaluate("document.getElementById('details').open = true")
        return page

    def complain(self, kind: str, text: str) -> None:
        """Keep an error of the console. While a server is away, connections fail."""
        if kind == "error" and "ERR_CONNECTION_REFUSED" not in text:
            self.errors.append(text)


def state(page: Page, *words: str, limit_s: float = 30.0) -> str:
    found: list[str] = []

    def holds() -> bool:
        found[:] = [page.inner_text("#state-word")]
        return found[0] in words

    wait_for(holds, f"state {words}", limit_s)
    return found[0]


def says(page: Page, selector: str, text: str, limit_s: float = 10.0) -> None:
    wait_for(lambda: text in page.inner_text(selector), text, limit_s)


def shown(page: Page) -> list[dict[str, Any]]:
    return list(page.evaluate("window.cushion.partials"))


@pytest.fixture(scope="module")
def room() -> Iterator[Room]:
    need([*missing_browser(), *missing_programs("pipewire")])
    with own_server() as server:
        config = Path(server.environment["XDG_CONFIG_HOME"]) / "cushion" / "config.toml"
        config.parent.mkdir(parents=True)
        config.write_text(CONFIG)
        with (
            running(server, device=None, engine=None) as daemon,
            served(server) as monitor,
            browser() as chromium,
        ):
            made = Room(server, daemon, monitor, chromium, config)
            yield made
            made.monitor.close()  # tests replace it


@pytest.fixture
def film(room: Room) -> Iterator[None]:
    """A player of this name, with a tone."""
    with playing(room.server, "desktop", tone(440.0, 120.0), name="Film"):
        yield


@pytest.fixture
def page(room: Room) -> Iterator[Page]:
    """An open page, without a complaint of the browser's at its end."""
    room.errors.clear()
    opened = room.open()
    yield opened
    opened.context.close()
    assert room.errors == []
