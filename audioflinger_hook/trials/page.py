"""Asks a person questions on a page, `/trial` of the live page's server, in this process."""

import asyncio
import os
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from enum import Enum
from typing import Any, Protocol

from audioflinger_hook.service.runtime_folder import RuntimeFolder
from audioflinger_hook.trials.player import NotPlayedError, Played, Player
from device.errors import CushionError, LostError, UsageError, not_installed

RETURN_S = 120.0  # a page that is closed, or not opened, for this time is gone
LAST_S = 0.3  # time for the last screen to reach the page
AWAY_S = 2.0  # from the end of the page's connection until another address is told
DEVICE_S = 1.0  # between two looks whether a lost device is back


class Kind(Enum):
    """What a question shows."""

    CHOICE = "choice"  # large buttons with keys: fit, preference, simultaneity, order
    SLIDER = "slider"  # 0 to 100, for ratings
    ONE_OF = "one of"  # one of many buttons, for identification
    TEXT = "text"  # text to read, with buttons below: consent, instructions, pause, the end
    PLAYING = "playing"  # no answer: what plays now; `Answers.show` shows it


@dataclass(frozen=True)
class Choice:
    """A button. value: the answer. label: text on it. key: key that presses it, such as "1"."""

    value: str
    label: str
    key: str = ""


FIRST, SECOND = Choice("1", "First", "1"), Choice("2", "Second", "2")
AGAIN, UNKNOWN = Choice("again", "Again", "a"), Choice("unknown", "Don't know", "d")
"""The usual choices; AGAIN and UNKNOWN are drawn smaller, as `Question.also`."""


@dataclass(frozen=True)
class Question:
    """One screen of the page.

    title: one line. text: paragraphs, plain text. choices: large buttons. also: smaller ones below.
    labels: texts below the slider, from its left end to its right end.
    parts: (label, begin in s, end in s) of what plays: each label is lit while its part plays.
    done, total: trials for the progress bar; total 0 hides it. practice: whether to say that this
    is practice. can_pause: whether to offer a pause.
    """

    kind: Kind
    title: str
    text: tuple[str, ...] = ()
    choices: tuple[Choice, ...] = ()
    also: tuple[Choice, ...] = ()
    labels: tuple[str, ...] = ()
    parts: tuple[tuple[str, float, float], ...] = ()
    done: int = 0
    total: int = 0
    practice: bool = False
    can_pause: bool = True


@dataclass(frozen=True)
class Answer:
    """A person's answer. value: `Choice.value`, or 0 to 100 of a slider.

    after_s: time from the screen's first drawing to the answer, by the page's clock, without
    pauses. pauses: number of pauses meanwhile.
    """

    value: str | float
    after_s: float
    pauses: int = 0


class StoppedError(LostError):
    """The person has ended the session. What was recorded is valid."""


class Answers(Protocol):
    """Asks on a page, or wherever else. `PageAnswers` is the page; a simulation gives its own."""

    def show(self, question: Question) -> None:
        """Show a screen without an answer, such as Kind.PLAYING; return at once."""
        ...

    def ask(self, question: Question) -> Answer:
        """Show a question; return its answer. A pause does not end the question.

        StoppedError: the person ends the session. LostError: the page was closed, and not opened
        again within RETURN_S. In both cases, what was recorded is valid.
        """
        ...

    def wait(self) -> None:
        """Return when the page is open and not paused. For errors, see `ask`."""
        ...


def play_whole(
    player: Player, answers: Answers, files: tuple[Any, Any], question: Question
) -> Played:
    """Play a trial until it was played to its end, again after each pause or loss of the device.

    files: sound and vibration, as for `Player.play`. question: screen while it plays. For errors,
    see `Answers.ask` and `Player.play`.
    """
    while True:
        answers.wait()
        answers.show(question)
        try:
            played = player.play(*files)
            if not played.stopped:
                return played
        except NotPlayedError as error:
            lost = f"The trial is played again as soon as possible: {error}."
            answers.show(Question(Kind.PLAYING, "One moment", (lost,)))
            while not player.wait(DEVICE_S):
                answers.wait()


class PageAnswers:
    """Serves the page in a thread until `close`; implements `Answers`.

    If the person pauses, stops or closes the page, `on_stop` is called at once, in another thread:
    give `Player.stop`. tell: called in that thread with the page's address, which opens it once,
    and with another address while the page is closed. clock: returns the time of day.
    listen: HOST:PORT. UsageError: the address cannot be used, or a package is not installed.
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
        self._on_stop = on_stop
        self._changed = threading.Condition()
        self._screen: dict[str, Any] = {"number": 0, "paused": False}
        self._answer: Answer | None = None
        self._is_stopped, self._pages, self._is_gone = False, 0, False
        self._leaving: asyncio.TimerHandle | None = None
        self._failure: CushionError | None = None
        folder, address = RuntimeFolder(environ, create=True), Listen.parse(listen)
        self._server = PageServer(address, folder, 1.0, clock, environ, self)
        self._loop, self._told = asyncio.new_event_loop(), tell

        self._address_of: Callable[[], str] = str

        def serve(served: Listen) -> None:
            self._address_of = lambda: f"{served.url}trial#{new_code(folder, clock())}"
            self._miss()

        def run() -> None:
            try:
                self._loop.run_until_complete(self._task)
            except asyncio.CancelledError:
                pass
            except CushionError as error:
                self._failure = error
                self._note()
            self._loop.close()
            folder.close()

        self._task = self._loop.create_task(self._server.run(serve))
        self._thread = threading.Thread(target=run, name="trial-page", daemon=True)
        self._thread.start()

    def show(self, question: Question) -> None:
        """Show a screen without an answer."""
        with self._changed:
            self._answer = None
            shown = asdict(question) | {"kind": question.kind.value}
            self._screen = shown | {k: self._screen[k] for k in ("number", "paused")}
            self._screen["number"] += 1
        self._tell()

    def ask(self, question: Question) -> Answer:
        """Show a question; return its answer. For errors, see `Answers`."""
        self.show(question)
        while True:
            with self._changed:
                self._check()
                if self._answer is not None:
                    return self._answer
                self._changed.wait()

    def wait(self) -> None:
        """Return when the page is open and not paused. For errors, see `Answers`."""
        while True:
            with self._changed:
                self._check()
                if self._pages and not self._screen["paused"]:
                    return
                self._changed.wait()

    def close(self) -> None:
        """Stop serving the page, which keeps its last screen. May be repeated."""
        if self._thread.is_alive():
            end = lambda: self._loop.call_later(LAST_S, self._task.cancel)  # noqa: E731
            self._loop.call_soon_threadsafe(end)
        self._thread.join()

    def _miss(self) -> None:
        """Tell an address, except after the last screen, which has no choices; wait for a page."""
        is_last = self._screen.get("kind") == Kind.TEXT.value and not self._screen["choices"]
        if not (self._is_stopped or is_last):
            self._told(self._address_of())
        self._leaving = self._loop.call_later(RETURN_S, self._lose)

    def _lose(self) -> None:
        self._is_gone = True
        self._note()

    def _check(self) -> None:
        if self._failure is not None:
            raise self._failure
        if self._is_stopped:
            raise StoppedError("the session was stopped on the page; all answers are kept")
        if self._is_gone:
            raise LostError("the page was closed; all answers are kept; run the command again")

    # ------------------------------------------------------------- called by the server's thread

    def joined(self) -> None:
        """Note that a page has connected."""
        self._pages += 1
        self._is_gone = False
        if self._leaving is not None:
            self._leaving.cancel()
        self._note()

    def left(self) -> None:
        """Note that a page has gone: the session pauses, and a trial that plays ends."""
        self._pages -= 1
        if not self._pages:
            self._pause(True)
            self._leaving = self._loop.call_later(AWAY_S, self._miss)  # a reload is shorter

    def take(self, said: object) -> dict[str, Any]:
        """Take what a page says, and return what it is told."""
        match said:
            case {"paused": bool(paused)}:
                self._pause(paused)
            case {"stopped": True}:
                self._is_stopped = True
                self._pause(True)
            case {"number": number, "value": value, "after_s": float(s) | int(s), "pauses": int(n)}:
                with self._changed:
                    screen = self._screen
                    known = [one["value"] for one in (*screen["choices"], *screen["also"])]
                    is_slid = screen["kind"] == Kind.SLIDER.value and type(value) in (int, float)
                    if number != screen["number"] or not (
                        value in known or (is_slid and 0 <= value <= 100)
                    ):
                        return {"error": "this question is not open any more"}
                    self._answer = self._answer or Answer(value, float(s), n)
            case _:
                return {"error": "this answer is not known"}
        self._note()
        return {"done": True}

    def _pause(self, paused: bool) -> None:
        with self._changed:
            self._screen = self._screen | {"paused": paused}
        if paused:
            self._on_stop()
        self._tell()
        self._note()

    def _note(self) -> None:
        with self._changed:
            self._changed.notify_all()

    def _tell(self) -> None:
        with suppress(RuntimeError):  # the server has ended
            self._loop.call_soon_threadsafe(self._server.show_trial, self._screen)
