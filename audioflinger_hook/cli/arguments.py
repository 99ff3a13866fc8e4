"""The argument parser of the commands, types of arguments, and options that commands share."""

import argparse
import math
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from device.errors import UsageError
from device.values import nearest

T = TypeVar("T")


class Parser(argparse.ArgumentParser):
    """A parser that raises UsageError for wrong usage and accepts no abbreviated options.

    any_order: whether options are allowed between positional arguments.
    add_options: adds a command's options only when the command is used, which saves time.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**{**options, "allow_abbrev": False})
        self.any_order = False
        self.add_options: Callable[[Parser], None] | None = None

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Return the parsed options and positional arguments, and the unknown arguments."""
        if self.add_options:
            add_options, self.add_options = self.add_options, None
            add_options(self)
        given: list[str] = []
        for argument in sys.argv[1:] if args is None else args:
            # `argparse` refuses `--option -,a`, but not `--option=-,a`.
            if argument.startswith("-,") and given and given[-1].startswith("--"):
                given[-1] += f"={argument}"
            else:
                given.append(argument)
        if not self.any_order:
            return super().parse_known_args(given, namespace)
        if "--" in given:
            # Arguments after "--" are parsed twice, so their names must not look like options.
            place = given.index("--")
            names = (f"./{name}" if name.startswith("-") else name for name in given[place + 1 :])
            given = [*given[:place], *names]
        self.any_order = False  # the parser calls this method again, for options and the rest
        try:
            return self.parse_known_intermixed_args(given, namespace)
        finally:
            self.any_order = True

    def add_value(
        self, flag: str, kind: Any, metavar: str, meaning: str, default: object = None
    ) -> argparse.Action:
        """Add an option with a value; return it. Its help states the default if there is one."""
        shown = f"{default:g}" if isinstance(default, float) else default
        described = meaning if default is None else f"{meaning}; default: {shown}"
        return self.add_argument(flag, type=kind, default=default, metavar=metavar, help=described)

    def add_switch(self, flag: str, meaning: str) -> None:
        """Add an option without a value."""
        self.add_argument(flag, action="store_true", help=meaning)

    def add_json(self) -> None:
        """Add `--json`."""
        self.add_switch("--json", "print one JSON document on stdout")

    def add_config(self) -> None:
        """Add `--config`, without a default."""
        self.add_value("--config", Path, "FILE", "read the settings from this file")

    def add_keys(self, *fields: str, **more: Any) -> None:
        """Add an option for the config key of each field. more: arguments for `add_argument`."""
        from audioflinger_hook.config.schema import option
        from device.values import Number, Switch

        for key in map(option, fields):
            kind: dict[str, Any] = {"metavar": key.metavar}
            if isinstance(key.description, Switch):
                kind = {"action": "store_true", "default": None}
            elif isinstance(key.description, Number):
                word = key.description.word
                kind["type"] = number_or(word) if word else float
            self.add_argument(key.flag, dest=key.field, help=key.help, **kind, **more)

    def add_profile(self, *, live: bool) -> None:
        """Add `--profile`. Its default is LIVE_DEFAULT if `live` is set, else OFFLINE_DEFAULT."""
        from audioflinger_hook.config.profiles import LIVE_DEFAULT, OFFLINE_DEFAULT
        from audioflinger_hook.config.schema import option

        default = LIVE_DEFAULT if live else OFFLINE_DEFAULT
        key = replace(option("profile"), default=default, live_default=default)
        self.add_argument(key.flag, dest=key.field, help=key.help, metavar=key.metavar)
        self.set_defaults(default_profile=default)

    def add_rendering(self, acceleration: bool = False) -> None:
        """Add the options for rendering a file. acceleration: whether to add `--acceleration`."""
        self.add_keys("form", "channels")
        self.add_profile(live=False)
        self.add_keys("rig", "damping", "protection", "model", "tolerance")
        if acceleration:
            what = "also write the simulated acceleration; its full scale is 100 m/s²"
            self.add_value("--acceleration", Path, "FILE", what)
        self.add_config()
        self.add_json()

    def add_exporting(self, default: str, format_name: str | None) -> None:
        """Add the options shared by `export` and `catalogue`. default: default format, in words."""
        from audioflinger_hook.exports.options import FORMATS

        formats = f"{', '.join(FORMATS)}; default: {default}"
        self.add_argument("--format", default=format_name, metavar="NAME", help=formats)
        self.add_value("--output-rate", count, "HZ", "rate of a waveform; default: the sound's")
        band = "band of the target's actuator, such as 55:200; 20-220 Hz is mapped to it"
        self.add_value("--device-band", band_hz, "LOW:HIGH", band)
        self.add_rendering()

    def error(self, message: str) -> NoReturn:
        """Raise UsageError for wrong usage. `argparse` calls this method."""
        raise UsageError(f"{message}; see `{self.prog} --help`")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Raise UsageError for an unknown word; the message names a similar word or all words."""
        if action.choices is None or value in action.choices:
            return
        known = [str(choice) for choice in action.choices]
        guess = nearest(str(value), known)
        allowed = f"did you mean {guess}?" if guess else f"allowed: {', '.join(known)}"
        self.error(f"{str(value)!r} is not known; {allowed}")


def given_values(options: argparse.Namespace, names: Iterable[str]) -> dict[str, Any]:
    """Return those options among `names` that the user gave, with their values."""
    values = {name: getattr(options, name) for name in names}
    return {name: value for name, value in values.items() if value is not None}


def _read(kind: Callable[[str], T], text: str, problem: str) -> T:
    """Return `kind(text)`. ArgumentTypeError: `kind` raised ValueError for this text."""
    try:
        return kind(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is {problem}") from None


def count(text: str) -> int:
    """Parse a whole number."""
    return _read(int, text, "not a whole number")


def number_or(word: str) -> Callable[[str], float | str]:
    """Return a function that parses a number, or returns the word."""
    return lambda text: text if text == word else _read(float, text, f"neither a number nor {word}")


def seconds(text: str) -> float:
    """Parse a time in seconds, 0 or more."""
    problem = "not a time; allowed: 0 seconds or more"
    value = _read(float, text, problem)
    if not 0.0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is {problem}")
    return value


def duration(text: str) -> float:
    """Parse a time in seconds, above 0."""
    value = seconds(text)
    if not value:
        raise argparse.ArgumentTypeError(f"{text!r} is not a duration; allowed: above 0 seconds")
    return value


def band_hz(text: str) -> tuple[float, float]:
    """Parse LOW:HIGH, a band in Hz."""
    low, _, high = text.partition(":")
    problem = "not a band; allowed: LOW:HIGH in Hz, such as 55:200"
    return _read(lambda _: (float(low), float(high)), text, problem)
