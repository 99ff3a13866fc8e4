"""Profiles: named sets of the transform's parameters, each value with its reason.

The profile `paper` changes no parameter. docs/decisions.md has the measurements behind the reasons.
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
FOLLOWED = ProfileValue(54.0, "whispers vibrate, too; silence and the noise of the room do not")
FLOOR = ProfileValue(-68.0, "soft sounds vibrate at a low volume; inaudible hiss does not")
FELT = ProfileValue("felt", "as strong as a seated body feels it, whatever its frequency")
DEEP = ProfileValue(20.0, "sub-bass vibrates, down to the lowest notes")
SONE = ProfileValue(
    0.68, "amplitude nearly in proportion to sone: what is twice as loud is felt so"
)
STEADY = ProfileValue(1.5, "what is steady stays so, and small changes are followed")
ROOM = ProfileValue(-24.0, "room for what is louder than the rest")
WARBLE = "tones that a body cannot distinguish would warble"
LOWER = ProfileValue("jnd", "a seated body feels lower vibration better, and amplifiers have room")

FOLLOWING = {
    "amplitude_mapping": BY_ENERGY,
    "loudness_db": FOLLOWED,
    "loudness_floor_db": FLOOR,
    "strength": FELT,
    "band_low_hz": DEEP,
    "mapping": LOWER,
    "dynamics": SONE,
    "jitter_db": STEADY,
}
"""What all profiles but the paper's have in common: vibration as strong as sound is loud."""

PROFILES: dict[str, dict[str, ProfileValue]] = {
    "paper": {},
    "cinema": {**FOLLOWING, "merge_ratio": ProfileValue(0.8, WARBLE), "loudness_target_db": ROOM},
    "game": {
        **FOLLOWING,
        "window_s": ProfileValue(
            0.033, "sustained levels and endings are 11 ms earlier; vibration begins at 30 Hz"
        ),
        "merge_ratio": ProfileValue(0.8, "shots and steps stand out of few, steady vibrations"),
        "loudness_target_db": ROOM,
    },
    "music": {**FOLLOWING, "merge_ratio": ProfileValue(0.6, WARBLE), "loudness_target_db": ROOM},
    "speech": {
        **FOLLOWING,
        "band_low_hz": ProfileValue(150.0, "the bass of music and engines does not hide a voice"),
        "band_high_hz": ProfileValue(2_000.0, "nor does what is brighter than vowels"),
        "vibration_top_hz": ProfileValue(
            60.0, "all of a voice is felt alike, so that its syllables are what changes"
        ),
        "dynamics": ProfileValue(0.75, "syllables are felt apart; music under speech is soft"),
        "rise_db": ProfileValue(0.0, "consonants are no blows: vibration follows the syllables"),
        "jitter_db": ProfileValue(1.0, "even small changes of a voice are followed"),
        "merge_ratio": ProfileValue(0.9, WARBLE),
        "loudness_floor_db": ProfileValue(-75.0, "soft words vibrate, too"),
        "loudness_target_db": ROOM,
    },
}
OFFLINE_DEFAULT = "paper"
"""Default of this library and of all commands on files: published figures stay what they are."""

LIVE_DEFAULT = "cinema"
"""Default of `run`, `demo` and the plugin: as strong as sound is loud, also when it is soft."""


def parameters_of(profile: str, said: Mapping[str, Any] | None = None) -> TransformParameters:
    """Return a profile's parameters, overridden by those set individually.

    Raises as `TransformParameters`, and KeyError if there is no such profile.
    """
    return TransformParameters(**(values_of(profile) | dict(said or {})))


def values_of(profile: str) -> dict[str, Any]:
    """Return a profile's values by parameter; KeyError if there is no such profile."""
    return {name: choice.value for name, choice in PROFILES[profile].items()}
