"""Terminal output: warnings, progress, levels as text, and questions."""

import math
import os
import select
import shlex
import shutil
import sys
import termios
import tty
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Protocol

from rich.console import Console

from device.errors import CushionError
from device.units import amplitude_to_db


def warn(*messages: str) -> None:
    """Print one-line warnings on stderr."""
    for message in messages:
        print(f"cushion: warning: {message}", file=sys.stderr)


def complain(message: str) -> None:
    """Print a one-line error on stderr without ending the command."""
    print(f"cushion: error: {message}", file=sys.stderr, flush=True)


def as_typed(command: str) -> str:
    """Return the shell command `cushion ...`, with the path of `cushion` if it is not on PATH."""
    started = Path(sys.argv[0])
    known = started.name != "cushion" or shutil.which("cushion")
    return f"{'cushion' if known else shlex.quote(str(started))} {command}"


def level_text(amplitude: float) -> str:
    """Return an amplitude in dBFS, or `silence` for 0."""
    # Rounding a level just below 0 dBFS gives -0.0; adding 0 makes it 0.0.
    level_db = round(amplitude_to_db(amplitude), 1) + 0.0
    return "silence" if level_db == -math.inf else f"{level_db:.1f} dBFS"


class LineConsole(Console):
    """A console that, like `print`, raises BrokenPipeError if the reader has closed the pipe."""

    def on_broken_pipe(self) -> None:
        """Raise BrokenPipeError."""
        raise BrokenPipeError


class Advance(Protocol):
    """Shows progress."""

    def __call__(self, done: float, total: float | None, note: str = "") -> None:
        """Show the finished and the total amount, and a note. total: None if unknown."""


@contextmanager
def progress_bar(label: str) -> Iterator[Advance]:
    """Yield a function that shows progress on stderr, if stderr is a terminal."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeRemainingColumn(compact=True),
    )
    console, off = LineConsole(stderr=True), not sys.stderr.isatty()
    with Progress(*columns, console=console, transient=True, disable=off) as bar:
        task = bar.add_task(label, total=None)

        def advance(done: float, total: float | None, note: str = "") -> None:
            text = f"{label}, {note}" if note else label
            bar.update(task, completed=done, total=total, description=text)

        yield advance


def choose(
    question: str,
    answers: Mapping[str, str],
    default: str = "",
    meanwhile: Callable[[], None] | None = None,
) -> str:
    """Ask until one of the answers is given, and return it.

    answers: each allowed answer with its meaning. The first letter of an answer is enough.
    default: the answer to an empty line; "" for none.
    meanwhile: called repeatedly while waiting for a line. It may raise; the caller gets the error.
    KeyboardInterrupt: the terminal was closed, or Ctrl+D was typed.
    """
    words = {answer[0]: answer for answer in answers} | {answer: answer for answer in answers}
    prompt = f"{question} [{default}] " if default else f"{question} "
    while True:
        given = _read(prompt, meanwhile).strip().lower() or default
        if given in words:
            return words[given]
        if given not in ("", "?"):
            print(f"{given[:60]!r} is not an answer.")
        print("Please type one of these:")
        for answer, meaning in answers.items():
            print(f"  {answer}: {meaning}")


def agree(question: str, *, default: bool) -> bool:
    """Ask for yes or no. KeyboardInterrupt: as for `choose`."""
    answers = {"yes": "do it", "no": "do not do it"}
    return choose(question, answers, "yes" if default else "no") == "yes"


def pick(question: str, items: Sequence[str], default: int | None) -> int:
    """List items and return the index of the chosen item; an empty line chooses the default."""
    for number, item in enumerate(items, 1):
        print(f"  {number}  {item}")
    answers = {str(number): item for number, item in enumerate(items, 1)}
    return int(choose(question, answers, "" if default is None else str(default + 1))) - 1


def name_some(question: str, names: Sequence[str]) -> tuple[str, ...]:
    """Ask for some of the names, separated by commas, and return them; empty for all."""
    while True:
        given = _read(f"{question} [all] ").strip()
        if given in ("", "all"):
            return ()
        chosen = tuple(name.strip() for name in given.split(","))
        if set(chosen) <= set(names) and len(set(chosen)) == len(chosen):
            return chosen
        print(f"Please type all, or some of: {', '.join(names)}.")


def _read(prompt: str, meanwhile: Callable[[], None] | None = None) -> str:
    # `input` would print the prompt through C's stderr, which audio commands silence.
    print(prompt, end="", flush=True)
    try:
        while not select.select([sys.stdin], [], [], 0.1)[0]:
            if meanwhile:
                meanwhile()
        return input()
    except EOFError:
        print(flush=True)
        raise KeyboardInterrupt from None
    except CushionError:
        print(flush=True)
        raise


@contextmanager
def pressed_keys() -> Iterator[Callable[[float], str]]:
    """Yield a function that waits for a key of the terminal, which need not be followed by Enter.

    The function takes the longest wait in seconds. It returns what the terminal sends for the key,
    such as "f", or "\\x1b[D" for the left arrow; "" if no key was pressed. Standard input must be a
    terminal. KeyboardInterrupt: the terminal was closed, or Ctrl+D was pressed.
    """
    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)

    def read(limit_s: float) -> str:
        if not select.select([terminal], [], [], limit_s)[0]:
            return ""
        pressed = b""
        with suppress(OSError):  # the terminal is closed
            pressed = os.read(terminal, 32)
        if pressed in (b"", b"\x04"):
            raise KeyboardInterrupt
        return pressed.decode(errors="replace")

    tty.setcbreak(terminal)
    try:
        yield read
    finally:
        with suppress(termios.error):  # the terminal is closed
            termios.tcsetattr(terminal, termios.TCSAFLUSH, before)
