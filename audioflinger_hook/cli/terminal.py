"""Output of the commands: warnings, progress, and levels as text."""

from __future__ import annotations

import math
import shlex
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from rich.console import Console

from device.units import amplitude_to_db


def warn(message: str) -> None:
    """Print a warning of one line on stderr."""
    print(f"cushion: warning: {message}", file=sys.stderr)


def complain(message: str) -> None:
    """Print an error of one line on stderr, if the command goes on with its other items."""
    print(f"cushion: error: {message}", file=sys.stderr, flush=True)


def as_typed(command: str) -> str:
    """Return a command of ours, such as "setup", as this user can type it.

    `cushion setup` where the shell finds cushion, else with the path that it was started by.
    """
    started = Path(sys.argv[0])
    known = started.name != "cushion" or shutil.which("cushion")
    return f"{'cushion' if known else shlex.quote(str(started))} {command}"


def level_text(amplitude: float) -> str:
    """Return an amplitude as dBFS, or `silence` for 0."""
    # An amplitude barely under full scale rounds to -0.0; adding 0 makes it 0.0.
    level_db = round(amplitude_to_db(amplitude), 1) + 0.0
    return "silence" if level_db == -math.inf else f"{level_db:.1f} dBFS"


class LineConsole(Console):
    """A console that raises BrokenPipeError if its reader is gone, as print does."""

    def on_broken_pipe(self) -> None:
        """Raise BrokenPipeError."""
        raise BrokenPipeError


class Advance(Protocol):
    """Shows progress."""

    def __call__(self, done: float, total: float | None, note: str = "") -> None:
        """Draw the finished and the total amount (None: unknown), and a note."""


@contextmanager
def progress_bar(label: str) -> Iterator[Advance]:
    """Yield a function that shows progress.

    The bar is drawn on stderr if that is a terminal, and removed at the end.
    """
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
