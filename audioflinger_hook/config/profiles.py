"""Profiles: named sets of the transform's parameters, from the file `profiles.toml`."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from audioflinger_hook.transform import TransformParameters


@dataclass(frozen=True)
class ProfileValue:
    """A profile's value of one parameter, and the reason for it."""

    value: float | int | str
    reason: str


def _read() -> dict[str, dict[str, ProfileValue]]:
    text = files("audioflinger_hook.config").joinpath("profiles.toml").read_text(encoding="utf-8")
    profiles = {
        name: {parameter: ProfileValue(*given) for parameter, given in values.items()}
        for name, values in tomllib.loads(text).items()
    }
    shared = profiles.pop("following")
    return {name: {**shared, **own} if name != "paper" else own for name, own in profiles.items()}


PROFILES = _read()
OFFLINE_DEFAULT = "paper"  # published values; default of this library and of commands on files
LIVE_DEFAULT = "cinema"  # default of `run`, `demo` and the plugin


def parameters_of(profile: str, said: Mapping[str, Any] | None = None) -> TransformParameters:
    """Return a profile's parameters; `said` replaces some values. KeyError: no such profile."""
    return TransformParameters(**(values_of(profile) | dict(said or {})))


def values_of(profile: str) -> dict[str, Any]:
    """Return a profile's values, keyed by parameter. KeyError: no such profile."""
    return {name: choice.value for name, choice in PROFILES[profile].items()}
