"""The page's key in Chromium: what is kept of it, who gets it, and which tabs have it."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from tests.browser.conftest import says, state
from tests.monitor.stand_in import daemon_socket, page
from tests.servers.listening import need
from tools.live_page import CHROMIUM, CHROMIUM_OPTIONS, missing_browser

pytestmark = pytest.mark.browser


@contextmanager
def another_server() -> Iterator[tuple[str, list[str]]]:
    """A server at another port, and all that it is sent."""
    sent: list[str] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            sent.append(f"{self.requestline}\n{self.headers}")
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_: Any) -> None: ...

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/", sent
        server.shutdown()


@contextmanager
def kept_browser(profile: Path) -> Iterator[Any]:
    """A context of a browser that keeps its profile in a folder."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        context = playwright.chromium.launch_persistent_context(
            profile, executable_path=CHROMIUM, args=CHROMIUM_OPTIONS, chromium_sandbox=False
        )
        yield context
        context.close()


def test_the_key_stays_in_the_session_storage_of_the_tabs_that_may_have_it(tmp_path):
    need(missing_browser())
    profile = tmp_path / "profile"
    with (
        daemon_socket(tmp_path),
        page(tmp_path) as served,
        another_server() as (other, sent),
        kept_browser(profile) as context,
    ):
        first = context.new_page()
        first.goto(served.address)
        state(first, "Running")
        assert first.url == served.base
        first.reload()
        state(first, "Running")
        first.click("summary")
        for how in ({}, {"modifiers": ["Control"]}, {"button": "middle"}):
            with context.expect_page() as opened:
                first.click("#second", **how)
            state(opened.value, "Running")
            opened.value.close()
        stranger = context.new_page()
        for address in (served.base, served.address):  # the code was used
            stranger.goto(address)
            says(stranger, "#state-text", f"cushion monitor --listen {served.host} --open")
            assert stranger.inner_text("#state-word") == "Not connected"
        stranger.goto(served.new_address())  # only the part after # differs
        state(stranger, "Running")
        stranger.reload()
        state(stranger, "Running")
        for tab in (first, stranger):
            tab.goto(other)
            tab.evaluate("fetch('/fetched')")
        assert context.cookies() == []
        key = served.key
    assert len(sent) >= 4
    assert not any(key in one or "cookie:" in one.lower() for one in sent)
    forms = key.encode(), key.encode("utf-16-le")
    files = {path: path.read_bytes() for path in profile.rglob("*") if path.is_file()}
    places = {path.parent.name for path, text in files.items() if any(f in text for f in forms)}
    assert places == {"Session Storage"}
    (history,) = (text for path, text in files.items() if path.name == "History")
    assert served.base.encode() in history  # it is kept, without the key
