"""Profiles: named sets of the transform's parameters, with a reason for each value.

The profile `paper` has the default of every parameter. docs/decisions.md describes measurements
that support the reasons.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from audioflinger_hook.transform import TransformParameters


@dataclass(frozen=True)
class ProfileValue:
    """A profile's value of one parameter, and the reason for it."""

    value: float | int | str
    reason: str


BY_ENERGY = ProfileValue("energy", "noise and chords feel as strong as a tone of the same energy")
FOLLOWED = ProfileValue(54.0, "whispers cause vibration; silence and room noise do not")
FLOOR = ProfileValue(-68.0, "soft sounds at low volume cause vibration; inaudible hiss does not")
FELT = ProfileValue("felt", "all frequencies feel equally strong to a seated body")
SONE = ProfileValue(0.68, "nearly proportional to sone: twice as loud feels twice as strong")
STEADY = ProfileValue(1.25, "steady sounds give steady vibration; small changes are followed")
ROOM = ProfileValue(-24.0, "headroom for the loudest sounds")
WARBLE = "tones too close to feel as two would beat"

FOLLOWING = {  # for all profiles except `paper`: louder sounds cause stronger vibration
    "amplitude_mapping": BY_ENERGY,
    "loudness_db": FOLLOWED,
    "loudness_floor_db": FLOOR,
    "strength": FELT,
    "band_low_hz": ProfileValue(20.0, "sub-bass causes vibration, down to the lowest notes"),
    "mapping": ProfileValue(
        "jnd", "a seated body feels low frequencies better, and amplifiers have headroom"
    ),
    "dynamics": SONE,
    "jitter_db": STEADY,
}

PROFILES: dict[str, dict[str, ProfileValue]] = {
    "paper": {},
    "cinema": {**FOLLOWING, "merge_ratio": ProfileValue(0.8, WARBLE), "loudness_target_db": ROOM},
    "game": {
        **FOLLOWING,
        "window_s": ProfileValue(
            0.033, "sustained levels and endings are 11 ms earlier; vibration begins at 30 Hz"
        ),
        "merge_ratio": ProfileValue(
            0.8, "few steady vibrations, so that shots and footsteps stand out"
        ),
        "loudness_target_db": ROOM,
    },
    "music": {**FOLLOWING, "merge_ratio": ProfileValue(0.6, WARBLE), "loudness_target_db": ROOM},
    "speech": {
        **FOLLOWING,
        "band_low_hz": ProfileValue(150.0, "the bass of music and engines does not hide a voice"),
        "band_high_hz": ProfileValue(2_000.0, "sounds above the vowels do not hide a voice"),
        "vibration_top_hz": ProfileValue(
            60.0, "the pitch of a voice is not felt, only its syllables"
        ),
        "dynamics": ProfileValue(0.75, "syllables feel distinct; music under speech is soft"),
        "rise_db": ProfileValue(
            0.0, "consonants do not feel like impacts; vibration follows the syllables"
        ),
        "jitter_db": ProfileValue(1.0, "even small changes of a voice are followed"),
        "merge_ratio": ProfileValue(0.9, WARBLE),
        "loudness_floor_db": ProfileValue(-75.0, "soft words cause vibration"),
        "loudness_target_db": ROOM,
    },
}
OFFLINE_DEFAULT = "paper"  # published values; default of this library and of commands on files
LIVE_DEFAULT = "cinema"  # default of `run`, `demo` and the plugin


def parameters_of(profile: str, said: Mapping[str, Any] | None = None) -> TransformParameters:
    """Return a profile's parameters; `said` replaces some values. KeyError: no such profile."""
    return TransformParameters(**(values_of(profile) | dict(said or {})))


def values_of(profile: str) -> dict[str, Any]:
    """Return a profile's values, keyed by parameter. KeyError: no such profile."""
    return {name: choice.value for name, choice in PROFILES[profile].items()}
