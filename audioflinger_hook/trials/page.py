"""Asks a person questions on a page, `/trial` of the live page's server, in this process."""

import asyncio
import os
import threading
from collections.abc import Callable, Coroutine, Mapping
from contextlib import suppress
from functools import partial
from typing import Any, Literal, NamedTuple, TypeVar

from audioflinger_hook.service.runtime_folder import RuntimeFolder
from device.errors import CushionError, LostError, UsageError, not_installed

RETURN_S = 120.0  # a page that is closed, or not opened, for this time is gone
LAST_S = 0.3  # time for the last screen to reach the page
AWAY_S = 2.0  # from the end of the page's connection until another address is told

Kind = Literal["choice", "slider", "one of", "text", "playing"]
Choice = tuple[str, str, str]  # the answer, the button's text, and the key that presses it, or ""
Screen = dict[str, Any]
Found = TypeVar("Found")

AGAIN, UNKNOWN = ("again", "Again", "a"), ("unknown", "Don't know", "d")
_EMPTY: Screen = {"choices": (), "also": (), "labels": (), "done": 0, "total": 0, "practice": False}


def screen(kind: Kind, title: str, *text: str, **more: Any) -> Screen:
    """Return one screen of the page.

    kind: "choice" has large buttons, "one of" many, "slider" a rating from 0 to 100, "text" text to
    read with buttons below; "playing" takes no answer. text: paragraphs. more: choices: large
    buttons. also: smaller ones. labels: texts below the slider, from left to right. done, total:
    trials, for the progress bar. practice: whether to say that it is.
    """
    return {**_EMPTY, "kind": kind, "title": title, "text": text, **more}


class Answer(NamedTuple):
    """A person's answer. value: of the button, or 0 to 100 of a slider.

    after_s: time from the screen's first drawing to the answer, by the page's clock, without
    pauses. pauses: number of pauses meanwhile.
    """

    value: str | float
    after_s: float = 0.0
    pauses: int = 0


class StoppedError(LostError):
    """The person has ended the session. What was recorded is valid."""


class PageAnswers:
    """Serves the page in a thread until `close`.

    on_stop: called at once in this thread if the person pauses, stops or closes the page. tell:
    called with the page's address, which opens it once, and with another while it is closed.
    clock: returns the time of day. listen: HOST:PORT. UsageError: a package is not installed.

    Errors of `ask` and `wait`: StoppedError: the person ends the session. LostError: the page was
    closed for RETURN_S. UsageError: the address cannot be used.
    """

    def __init__(
        self,
        on_stop: Callable[[], None],
        tell: Callable[[str], None],
        clock: Callable[[], float],
        listen: str = "127.0.0.1:0",
        environ: Mapping[str, str] = os.environ,
    ) -> None:
        try:
            from audioflinger_hook.monitor.access import Listen, new_code
            from audioflinger_hook.monitor.server import PageServer
        except ModuleNotFoundError as error:
            raise UsageError(not_installed(str(error.name), "study")) from error
        self._on_stop, self._told, self._pages = on_stop, tell, 0
        self._screen: Screen = {"number": 0, "paused": False}
        self._address: Callable[[], str] = str
        self._loop, self._ready = asyncio.new_event_loop(), asyncio.Event()
        self._answer: asyncio.Future[Answer] = self._loop.create_future()
        self._ended: asyncio.Future[CushionError] = self._loop.create_future()
        self._leaving: asyncio.TimerHandle | None = None
        folder = RuntimeFolder(environ, create=True)
        self._server = PageServer(Listen.parse(listen), folder, 1.0, clock, environ, self)

        def serve(served: Listen) -> None:
            self._address = lambda: f"{served.url}trial#{new_code(folder, clock())}"
            self._miss()

        async def run() -> None:
            try:
                await self._server.run(serve)
            except CushionError as error:
                self._end(error)
                await asyncio.Future()

        def work() -> None:
            with suppress(asyncio.CancelledError):
                self._loop.run_until_complete(self._task)
            self._loop.close()
            folder.close()

        self._task = self._loop.create_task(run())
        self._thread = threading.Thread(target=work, name="trial-page", daemon=True)
        self._thread.start()

    def show(self, shown: Screen) -> None:
        """Show a screen without an answer, such as one of kind "playing"; return at once."""

        async def show() -> None:
            self._answer = self._loop.create_future()
            self._tell({**shown, "number": self._screen["number"] + 1})

        asyncio.run_coroutine_threadsafe(show(), self._loop).result()

    def ask(self, shown: Screen) -> Answer:
        """Show a question; return its answer. A pause does not end the question."""
        self.show(shown)
        return self._unless_ended(self._answer)

    def wait(self) -> None:
        """Return when the page is open and not paused."""
        self._unless_ended(self._ready.wait())

    def close(self) -> None:
        """Stop serving the page, which keeps its last screen. May be repeated."""
        with suppress(RuntimeError):  # the loop is closed
            end = partial(self._loop.call_later, LAST_S, self._task.cancel)
            self._loop.call_soon_threadsafe(end)
        self._thread.join()

    def _unless_ended(self, work: Coroutine[Any, Any, Found] | asyncio.Future[Found]) -> Found:
        async def first() -> Found:
            wanted = asyncio.ensure_future(work)
            both: set[asyncio.Future[Any]] = {wanted, self._ended}
            await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
            if self._ended.done():
                wanted.cancel()
                raise self._ended.result()
            return wanted.result()

        return asyncio.run_coroutine_threadsafe(first(), self._loop).result()

    # ---------------------------------------------------------------- called by the page's thread

    def _tell(self, changed: Screen) -> None:
        self._screen = {"paused": self._screen["paused"], **changed}
        is_ready = self._pages and not self._screen["paused"]
        (self._ready.set if is_ready else self._ready.clear)()
        self._server.show_trial(self._screen)

    def _miss(self) -> None:
        """Tell an address, except after the last screen, which has no choices; wait for a page."""
        is_last = self._screen.get("kind") == "text" and not self._screen["choices"]
        if not (self._ended.done() or is_last):
            self._told(self._address())
        gone = LostError("the page was closed; all answers are kept; run the command again")
        self._leaving = self._loop.call_later(RETURN_S, self._end, gone)

    def _end(self, error: CushionError) -> None:
        if not self._ended.done():
            self._ended.set_result(error)

    def _pause(self, paused: bool) -> None:
        self._tell({**self._screen, "paused": paused})
        if paused:
            self._on_stop()

    def joined(self) -> None:
        """Note that a page has connected."""
        self._pages += 1
        if self._leaving is not None:
            self._leaving.cancel()
        self._tell(self._screen)

    def left(self) -> None:
        """Note that a page has gone: the session pauses, and a trial that plays ends."""
        self._pages -= 1
        if not self._pages:
            self._pause(True)
            self._leaving = self._loop.call_later(AWAY_S, self._miss)  # a reload is shorter

    def take(self, said: object) -> dict[str, Any]:
        """Take what a page says, and return what it is told."""
        now = _EMPTY | self._screen
        match said:
            case {"paused": bool(paused)}:
                self._pause(paused)
            case {"stopped": True}:
                self._end(StoppedError("the session was stopped on the page; all answers are kept"))
                self._pause(True)
            case {"number": number, "value": value, "after_s": float(s) | int(s), "pauses": int(n)}:
                is_known = value in [one[0] for one in (*now["choices"], *now["also"])]
                is_slid = now.get("kind") == "slider" and type(value) in (int, float)
                if number != now["number"] or not (is_known or (is_slid and 0 <= value <= 100)):
                    return {"error": "this question is not open any more"}
                if not self._answer.done():
                    self._answer.set_result(Answer(value, float(s), n))
            case _:
                return {"error": "this answer is not known"}
        return {"done": True}
