"""Asks a person questions on a page, `/trial` of the live page's server, in this process."""

import asyncio
import math
import os
import queue
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, Literal, NamedTuple

from audioflinger_hook.service.runtime_folder import RuntimeFolder
from device.errors import LostError, UsageError, not_installed

LAST_S = 0.3  # time for the last screen to reach the page
LOOK_S = 0.05  # between two looks for pages and answers

Kind = Literal["choice", "slider", "one of", "text", "playing"]
Choice = tuple[str, str, str]  # the answer, the button's text, and the key that presses it, or ""
Screen = dict[str, Any]

AGAIN, UNKNOWN = ("again", "Again", "a"), ("unknown", "Don't know", "d")
_EMPTY: Screen = {"choices": (), "also": (), "labels": (), "done": 0, "total": 0, "practice": False}


def screen(kind: Kind, title: str, *text: str, **more: Any) -> Screen:
    """Return one screen of the page.

    kind: "choice" has large buttons, "one of" many, "slider" a rating from 0 to 100, "text"
    paragraphs to read; "playing" takes no answer. more: choices, also: large and smaller buttons.
    labels: below the slider. done, total: trials, for the progress bar. practice: shown as such.
    """
    return {**_EMPTY, "kind": kind, "title": title, "text": text, **more}


class Answer(NamedTuple):
    """A person's answer. value: of the button, or 0 to 100 of a slider.

    after_s: time since the screen was drawn, by the page's clock, without the number of `pauses`.
    """

    value: str | float
    after_s: float = 0.0
    pauses: int = 0


class StoppedError(LostError):
    """The person has ended the session. The record stays valid."""


class PageAnswers:
    """Serves the page in a thread until `close`; implements `Link`.

    on_stop: called in this thread if the person pauses, stops or closes the page. tell: called with
    an address that opens the page once, again after its end. clock: returns the time of day.
    UsageError: a package is missing. `ask` and `wait` raise StoppedError and those of PageServer.
    """

    def __init__(
        self, on_stop: Callable[[], None], tell: Callable[[str], None], clock: Callable[[], float]
    ) -> None:
        try:
            from audioflinger_hook.monitor.access import Listen, new_code
            from audioflinger_hook.monitor.server import PageServer
        except ModuleNotFoundError as error:
            raise UsageError(not_installed(str(error.name), "study")) from error
        self._on_stop = on_stop
        self._screen: Screen = {**_EMPTY, "number": 0, "kind": "", "paused": False}
        self._number, self._answers = 0, queue.SimpleQueue[tuple[int, Answer]]()
        self._ended: Exception | None = None
        self._invite: Callable[[], None]
        folder = RuntimeFolder(os.environ, create=True)
        self._server = PageServer(
            Listen.parse("127.0.0.1:0"), folder, 1.0, clock, os.environ, link=self
        )

        def served(at: Listen) -> None:
            self._invite = lambda: tell(f"{at.url}trial#{new_code(folder, clock())}")

        def work() -> None:
            try:
                self._loop.run_until_complete(self._serving)
            except asyncio.CancelledError:
                pass
            except Exception as error:  # the session's thread raises it
                self._ended = error
            self._loop.close()
            folder.close()

        self._loop = asyncio.new_event_loop()
        self._serving = self._loop.create_task(self._server.run(served))
        self._thread = threading.Thread(target=work, name="trial-page", daemon=True)
        self._thread.start()

    def show(self, shown: Screen) -> None:
        """Show a screen without an answer, such as one of kind "playing"; return at once."""
        self._number += 1
        with suppress(RuntimeError):  # the page's thread has ended
            self._loop.call_soon_threadsafe(self._change, {**shown, "number": self._number})

    def ask(self, shown: Screen) -> Answer:
        """Show a question; return its answer. A pause does not end the question."""
        self.show(shown)
        while True:
            self._check()
            with suppress(queue.Empty):
                number, answer = self._answers.get(timeout=LOOK_S)
                if number == self._number:
                    return answer

    def wait(self) -> None:
        """Return when the page is open and not paused."""
        self._check()
        while self._screen["paused"] or not self._server.clients:
            self._thread.join(LOOK_S)
            self._check()

    def close(self) -> None:
        """Stop serving the page, which keeps its last screen. May be repeated."""
        if self._thread.is_alive():
            self._thread.join(LAST_S)
            with suppress(RuntimeError):  # the loop is closed
                self._loop.call_soon_threadsafe(self._serving.cancel)
            self._thread.join()

    def _check(self) -> None:
        if self._ended is not None:
            raise self._ended

    def _change(self, changes: dict[str, Any]) -> None:
        self._screen = self._screen | changes
        self._server.clients.tell("trial", self._screen)
        if changes.get("paused"):
            self._on_stop()

    async def run(self) -> None:
        """Announce the address, and pause the session while the page is closed."""
        pages = 0
        self._invite()
        while True:
            await asyncio.sleep(LOOK_S)
            before, pages = pages, len(self._server.clients)
            if before and not pages:
                self._change({"paused": True})
                self._invite()

    async def control(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Take what a page says, and return what it is told."""
        now = self._screen
        match request:
            case {"paused": bool(paused)}:
                self._change({"paused": paused})
            case {"stopped": True}:
                told = "the session was stopped on the page; all answers are kept"
                self._ended = StoppedError(told)
                self._change({"paused": True})
            case {
                "number": number, "value": value, "after_s": float(s) | int(s), "pauses": int(n)
            } if math.isfinite(s):  # fmt: skip
                is_known = value in [one[0] for one in (*now["choices"], *now["also"])]
                is_slid = now["kind"] == "slider" and type(value) in (int, float)
                if number != now["number"] or not (is_known or (is_slid and 0 <= value <= 100)):
                    return {"error": "this question is not open any more"}
                self._answers.put((number, Answer(value, float(s), n)))
            case _:
                return {"error": "this answer is not known"}
        return {"done": True}
