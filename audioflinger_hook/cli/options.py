"""Options that several commands share, and the ways to add one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from audioflinger_hook.cli.arguments import Parser, band_hz, count, number_or_off

CONFIG_HELP = "take the settings from this file"


def add_exporting(command: Parser, default: str, format_name: str | None) -> None:
    """Add the options that `export` and `catalogue` share."""
    from audioflinger_hook.exports.options import FORMATS

    formats = f"{', '.join(FORMATS)}; default: {default}"
    command.add_argument("--format", default=format_name, metavar="NAME", help=formats)
    add_value(command, "--output-rate", count, "HZ", "rate of a waveform; default: the sound's")
    band = "band of the target's actuator, such as 55:200; 20-220 Hz is mapped to it"
    add_value(command, "--device-band", band_hz, "LOW:HIGH", band)
    _add_offline(command)


def add_json(command: Parser) -> None:
    """Add `--json`."""
    add_switch(command, "--json", "print one JSON document on stdout")


def add_rendering(command: Parser) -> None:
    """Add the options that `render` and `replay` share."""
    acceleration = "also write the simulated acceleration; its full scale is 100 m/s²"
    _add_offline(command, lambda: add_value(command, "--acceleration", Path, "FILE", acceleration))


def _add_offline(command: Parser, add_more: Callable[[], None] = lambda: None) -> None:
    add_keys(command, "form", "channels")
    add_profile(command, live=False)
    add_keys(command, "rig", "damping", "protection", "model", "tolerance")
    add_more()
    add_value(command, "--config", Path, "FILE", CONFIG_HELP)
    add_json(command)


def add_profile(command: Parser, *, live: bool) -> None:
    """Add `--profile`, and `default_profile` to the parsed options. live: which default it is."""
    from audioflinger_hook.config.profiles import LIVE_DEFAULT, OFFLINE_DEFAULT
    from audioflinger_hook.config.schema import option

    default = LIVE_DEFAULT if live else OFFLINE_DEFAULT
    key = replace(option("profile"), default=default, live_default=default)
    command.add_argument(key.flag, dest=key.field, help=key.help, metavar=key.metavar)
    command.set_defaults(default_profile=default)


def add_keys(command: Parser, *fields: str, **more: Any) -> None:
    """Add the options for keys of the config file. more: further arguments of `add_argument`."""
    from audioflinger_hook.config.schema import option
    from device.values import Number, Switch

    for key in map(option, fields):
        kind: dict[str, Any] = {"metavar": key.metavar}
        if isinstance(key.description, Switch):
            kind = {"action": "store_true", "default": None}
        elif isinstance(key.description, Number):
            kind["type"] = number_or_off if key.description.off else float
        command.add_argument(key.flag, dest=key.field, help=key.help, **kind, **more)


def add_value(
    command: Parser, flag: str, kind: Any, metavar: str, meaning: str, default: object = None
) -> None:
    """Add an option with a value. Its help shows the default, unless the default is None."""
    shown = f"{default:g}" if isinstance(default, float) else default
    described = meaning if default is None else f"{meaning}; default: {shown}"
    command.add_argument(flag, type=kind, default=default, metavar=metavar, help=described)


def add_switch(command: Parser, flag: str, meaning: str) -> None:
    """Add an option without a value."""
    command.add_argument(flag, action="store_true", help=meaning)
