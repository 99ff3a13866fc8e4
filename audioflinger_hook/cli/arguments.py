"""The parser of one command, and the types of its arguments."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from device.errors import UsageError


class Parser(argparse.ArgumentParser):
    """A parser that reports wrong usage like other errors and accepts no abbreviations.

    any_order: whether options may be placed between the names of files, of any number.
    add_options: adds the options once the command is known, so that others cost no time.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**{**options, "allow_abbrev": False})
        self.any_order = False
        self.add_options: Callable[[Parser], None] | None = None

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Return the parsed options and the arguments left over."""
        if self.add_options:
            add_options, self.add_options = self.add_options, None
            add_options(self)
        if not self.any_order:
            return super().parse_known_args(args, namespace)
        given = list(sys.argv[1:] if args is None else args)
        if "--" in given:
            # The rest is parsed again without the mark "--": no name may look like an option then.
            place = given.index("--")
            names = (f"./{name}" if name.startswith("-") else name for name in given[place + 1 :])
            given = [*given[:place], *names]
        self.any_order = False  # the options first, then the rest; both calls come here again
        try:
            return self.parse_known_intermixed_args(given, namespace)
        finally:
            self.any_order = True

    def error(self, message: str) -> NoReturn:
        """Raise UsageError."""
        raise UsageError(f"{message}; see `{self.prog} --help`")


def count(text: str) -> int:
    """Return a whole number."""
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None


def number_or_off(text: str) -> float | str:
    """Return a number, or "off"."""
    try:
        return text if text == "off" else float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is neither a number nor off") from None


def seconds(text: str) -> float:
    """Return a time of 0 seconds or more."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not a time; allowed: 0 seconds or more")
    return value


def duration(text: str) -> float:
    """Return a time above 0 seconds."""
    value = seconds(text)
    if not value:
        raise argparse.ArgumentTypeError(f"{text!r} is not a duration; allowed: above 0 seconds")
    return value
