"""Profiles: named sets of the transform's parameters, each value with its reason.

The profile `paper` changes no parameter. Other profiles change some parameters; a config file
overrides the profile. docs/decisions.md has the measurements behind the reasons.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from audioflinger_hook.transform import TransformParameters


@dataclass(frozen=True)
class ProfileValue:
    """A profile's value of one parameter, with the reason."""

    value: float | int | str
    reason: str


BY_ENERGY = ProfileValue("energy", "noise and chords as strong as a tone of the same energy")
FOLLOWED = ProfileValue(30.0, "the same vibration from full volume to 20 dB below, with a reserve")

PROFILES: dict[str, dict[str, ProfileValue]] = {
    "paper": {},
    "cinema": {
        "level_law": BY_ENERGY,
        "strength": ProfileValue("felt", "as strong as a seated body feels it"),
        "merge_ratio": ProfileValue(0.35, "closer partials are felt as one that warbles"),
        "band_low_hz": ProfileValue(20.0, "sub-bass is felt, too"),
        "mapping": ProfileValue("jnd", "lower vibration, which a seated body feels better"),
        "loudness_target_db": ProfileValue(-21.0, "headroom"),
        "loudness_db": FOLLOWED,
    },
    "game": {
        "level_law": BY_ENERGY,
        "strength": ProfileValue("felt", "as strong as a seated body feels it"),
        "merge_ratio": ProfileValue(0.35, "closer partials are felt as one that warbles"),
        "band_low_hz": ProfileValue(20.0, "sub-bass is felt, too"),
        "mapping": ProfileValue("jnd", "lower vibration, which a seated body feels better"),
        "loudness_target_db": ProfileValue(-21.0, "headroom"),
        "loudness_db": FOLLOWED,
        "window_s": ProfileValue(
            0.03, "sustained levels and endings are 13 ms earlier; vibration begins at 33 Hz"
        ),
            },
    "music": {
        "level_law": BY_ENERGY,
        "strength": ProfileValue("felt", "as strong as a seated body feels it"),
        "merge_ratio": ProfileValue(0.35, "closer partials are felt as one that warbles"),
        "band_low_hz": ProfileValue(20.0, "sub-bass is felt, too"),
        "mapping": ProfileValue("jnd", "lower vibration, which a seated body feels better"),
        "loudness_target_db": ProfileValue(-21.0, "headroom"),
        "loudness_db": FOLLOWED,
        "dynamics": ProfileValue(
            0.5, "music has a small range of loudness: keep half of it"
        ),
            },
}
"""Every profile by its name."""

DEFAULT_PROFILE = "paper"


def parameters_of(profile: str, said: Mapping[str, Any] | None = None) -> TransformParameters:
    """Return a profile's parameters, overridden by those set individually.

    UsageError: parameters are out of range or contradict each other; see `TransformParameters`.
    KeyError: there is no such profile.
    """
    return TransformParameters(**(values_of(profile) | dict(said or {})))


def values_of(profile: str) -> dict[str, Any]:
    """Return a profile's values by parameter; KeyError if there is no such profile."""
    return {name: choice.value for name, choice in PROFILES[profile].items()}
