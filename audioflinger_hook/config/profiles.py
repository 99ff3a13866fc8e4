"""Profiles: named sets of the transform's parameters, each value with its reason.

`paper` changes nothing. What a profile does not name is the paper's, too; what a config file names
goes over the profile. docs/decisions.md has the measurements that the reasons are taken from.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from audioflinger_hook.transform import TransformParameters


@dataclass(frozen=True)
class ProfileValue:
    """What a profile says of one parameter, and why."""

    value: float | int | str
    reason: str


BY_ENERGY = ProfileValue("energy", "noise and chords as strong as a tone of the same energy")
FOLLOWED = ProfileValue(30.0, "the same vibration from full volume to 20 dB below, with a reserve")

PROFILES: dict[str, dict[str, ProfileValue]] = {
    "paper": {},
    "cinema": {
        "level_law": BY_ENERGY,
        "loudness_db": FOLLOWED,
    },
    "game": {
        "level_law": BY_ENERGY,
        "loudness_db": FOLLOWED,
        "window_s": ProfileValue(
            0.03, "what lasts, and its end, is felt 13 ms earlier; vibration begins at 33 Hz"
        ),
        "partials_max": ProfileValue(8, "as many as so short a window tells apart"),
    },
    "music": {
        "level_law": BY_ENERGY,
        "loudness_db": FOLLOWED,
        "loudness_slope_db": ProfileValue(
            10.0, "music has few phons between soft and loud: keep half"
        ),
        "partials_max": ProfileValue(6, "a chord's strongest, with room between them"),
    },
}
"""Every profile by its name."""

DEFAULT_PROFILE = "paper"


def parameters_of(profile: str, said: Mapping[str, Any] | None = None) -> TransformParameters:
    """Return a profile's parameters, and over them what was said by name.

    UsageError: they are out of range or contradict one another; see `TransformParameters`.
    KeyError: there is no such profile.
    """
    return TransformParameters(**(values_of(profile) | dict(said or {})))


def values_of(profile: str) -> dict[str, Any]:
    """Return what a profile says, by parameter; KeyError where there is no such profile."""
    return {name: choice.value for name, choice in PROFILES[profile].items()}
