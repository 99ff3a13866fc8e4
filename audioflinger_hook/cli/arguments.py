"""The parser of one command, the types of its arguments, and the options of several commands."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from device.errors import UsageError
from device.values import nearest

T = TypeVar("T")


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
        """Return the parsed options and the arguments left over; see `any_order`."""
        if self.add_options:
            add_options, self.add_options = self.add_options, None
            add_options(self)
        given = join_lists(sys.argv[1:] if args is None else args)
        if not self.any_order:
            return super().parse_known_args(given, namespace)
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

    def add_value(
        self, flag: str, kind: Any, metavar: str, meaning: str, default: object = None
    ) -> None:
        """Add an option with a value. Its help shows the default, unless the default is None."""
        shown = f"{default:g}" if isinstance(default, float) else default
        described = meaning if default is None else f"{meaning}; default: {shown}"
        self.add_argument(flag, type=kind, default=default, metavar=metavar, help=described)

    def add_switch(self, flag: str, meaning: str) -> None:
        """Add an option without a value."""
        self.add_argument(flag, action="store_true", help=meaning)

    def add_json(self) -> None:
        """Add `--json`."""
        self.add_switch("--json", "print one JSON document on stdout")

    def add_config(self) -> None:
        """Add `--config`, without a default."""
        self.add_value("--config", Path, "FILE", "take the settings from this file")

    def add_keys(self, *fields: str, **more: Any) -> None:
        """Add options for keys of the config file. more: further arguments of `add_argument`."""
        from audioflinger_hook.config.schema import option
        from device.values import Number, Switch

        for key in map(option, fields):
            kind: dict[str, Any] = {"metavar": key.metavar}
            if isinstance(key.description, Switch):
                kind = {"action": "store_true", "default": None}
            elif isinstance(key.description, Number):
                kind["type"] = number_or_off if key.description.off else float
            self.add_argument(key.flag, dest=key.field, help=key.help, **kind, **more)

    def add_profile(self, *, live: bool) -> None:
        """Add `--profile`, and `default_profile` to the parsed options. live: which default."""
        from audioflinger_hook.config.profiles import LIVE_DEFAULT, OFFLINE_DEFAULT
        from audioflinger_hook.config.schema import option

        default = LIVE_DEFAULT if live else OFFLINE_DEFAULT
        key = replace(option("profile"), default=default, live_default=default)
        self.add_argument(key.flag, dest=key.field, help=key.help, metavar=key.metavar)
        self.set_defaults(default_profile=default)

    def add_rendering(self, acceleration: bool = False) -> None:
        """Add the options of what a file is rendered with, and `--json`."""
        self.add_keys("form", "channels")
        self.add_profile(live=False)
        self.add_keys("rig", "damping", "protection", "model", "tolerance")
        if acceleration:
            what = "also write the simulated acceleration; its full scale is 100 m/s²"
            self.add_value("--acceleration", Path, "FILE", what)
        self.add_config()
        self.add_json()

    def add_exporting(self, default: str, format_name: str | None) -> None:
        """Add the options that `export` and `catalogue` share."""
        from audioflinger_hook.exports.options import FORMATS

        formats = f"{', '.join(FORMATS)}; default: {default}"
        self.add_argument("--format", default=format_name, metavar="NAME", help=formats)
        self.add_value("--output-rate", count, "HZ", "rate of a waveform; default: the sound's")
        band = "band of the target's actuator, such as 55:200; 20-220 Hz is mapped to it"
        self.add_value("--device-band", band_hz, "LOW:HIGH", band)
        self.add_rendering()

    def error(self, message: str) -> NoReturn:
        """Raise UsageError."""
        raise UsageError(f"{message}; see `{self.prog} --help`")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse an unknown word and name the nearest known one; argparse calls it, as it is."""
        if action.choices is None or value in action.choices:
            return
        known = [str(choice) for choice in action.choices]
        guess = nearest(str(value), known)
        allowed = f"did you mean {guess}?" if guess else f"allowed: {', '.join(known)}"
        self.error(f"{str(value)!r} is not known; {allowed}")


def join_lists(arguments: Sequence[str]) -> list[str]:
    """Return the arguments with `--option -,a` as `--option=-,a`: argparse sees no value there."""
    joined: list[str] = []
    for argument in arguments:
        if argument.startswith("-,") and joined and joined[-1].startswith("--"):
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined


def _read(kind: Callable[[str], T], text: str, problem: str) -> T:
    """Return `kind(text)`, whose ValueError becomes an error that names the text."""
    try:
        return kind(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is {problem}") from None


def count(text: str) -> int:
    """Return a whole number."""
    return _read(int, text, "not a whole number")


def number_or_off(text: str) -> float | str:
    """Return a number, or "off"."""
    return text if text == "off" else _read(float, text, "neither a number nor off")


def seconds(text: str) -> float:
    """Return a time of 0 seconds or more."""
    problem = "not a time; allowed: 0 seconds or more"
    value = _read(float, text, problem)
    if not 0.0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is {problem}")
    return value


def duration(text: str) -> float:
    """Return a time above 0 seconds."""
    value = seconds(text)
    if not value:
        raise argparse.ArgumentTypeError(f"{text!r} is not a duration; allowed: above 0 seconds")
    return value


def band_hz(text: str) -> tuple[float, float]:
    """Return a band in Hz from LOW:HIGH."""
    low, _, high = text.partition(":")
    problem = "not a band; allowed: LOW:HIGH in Hz, such as 55:200"
    return _read(lambda _: (float(low), float(high)), text, problem)
