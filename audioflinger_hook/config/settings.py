"""What a user may choose: profile, transform, level, rig and what is done for it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.transform import Form, TransformParameters
from audioflinger_hook.transform.parameters import Problem
from device.drive import (
    ActuatorSettings,
    ChannelMap,
    channels_needed,
    problems_together,
    sources_of,
    wiring_of,
)
from device.errors import UsageError
from device.rig.rig_file import SHIPPED, SUFFIX, read_rig

Channels = Literal["mono", "each"]

CHOICES: dict[str, tuple[str, ...]] = {
    "profile": tuple(PROFILES),
    "damping": ("off", "auto"),
    "protection": ("off", "on"),
    "exposure_cap": ("off", "action", "limit"),
    "form": ("live", "reference"),
    "channels": ("mono", "each"),
}
"""Every choice by name, with the values that exist; the first one, the paper's, is the default."""

GAIN_MIN_DB = -60.0
GAIN_MAX_DB = 0.0

OF_PROFILE = TransformParameters()
"""Stands for the parameters of whichever profile is chosen: it itself, not its equals."""

LABELS = {"form": "transform"}
"""What a choice is called on the command line, where that differs."""


@dataclass(frozen=True)
class Settings:
    """One complete set of choices.

    profile: a named set of parameters (`profiles.PROFILES`); form: which form of the transform;
    channels: `mono` mixes before the transform, `each` transforms every channel by itself; damping:
    whether residual vibration is reduced; protection: whether the rig is kept within its limits,
    which comes with damping; exposure_cap: the value of 2002/44/EC that all vibration since the
    start is kept under, which brings protection along; rig: what is driven, one that ships or a
    file, NAME.toml; gain_db: level of the vibration, -60 to 0; effects_file: an audio_effects.xml
    that says which effects run, None for the bundled one. actuators: what each gets that the device
    drives, on which of its channels; none: the vibration, on all of them. With actuators, their
    sources say what is transformed, and `channels` is `mono`.

    parameters: the profile's where not given; said: the names of those that were chosen one by one
    and stay where another profile is chosen (`choosing`).

    Raises
    ------
    UsageError
        Names every choice that does not exist or is out of range, all at once.
    """

    profile: str = CHOICES["profile"][0]
    damping: str = CHOICES["damping"][0]
    protection: str = CHOICES["protection"][0]
    exposure_cap: str = CHOICES["exposure_cap"][0]
    form: Form = "live"
    channels: Channels = "mono"
    rig: str = SHIPPED[0]
    gain_db: float = GAIN_MAX_DB
    effects_file: Path | None = None
    parameters: TransformParameters = OF_PROFILE
    said: tuple[str, ...] = ()
    actuators: tuple[ActuatorSettings, ...] = ()

    def __post_init__(self) -> None:
        if self.parameters is OF_PROFILE:
            known = self.profile if self.profile in CHOICES["profile"] else CHOICES["profile"][0]
            object.__setattr__(self, "parameters", parameters_of(known))
        problems = [
            f"{LABELS.get(name, name)} {getattr(self, name)!r} is not known; "
            f"allowed: {', '.join(allowed)}"
            for name, allowed in CHOICES.items()
            if getattr(self, name) not in allowed
        ]
        if wrong := wrong_rig(self.rig):
            problems.append(f"rig {self.rig!r} {wrong.wrong}; allowed: {wrong.allowed}")
        if wrong := wrong_gain(self.gain_db):
            problems.append(f"gain_db={self.gain_db!r} {wrong.wrong}; allowed: {wrong.allowed}")
        for number, actuator in enumerate(self.actuators, 1):
            if actuator.rig is not None and (wrong := wrong_rig(actuator.rig)):
                problems.append(
                    f"rig {actuator.rig!r} of actuator {number} {wrong.wrong}; "
                    f"allowed: {wrong.allowed}"
                )
        problems += [
            f"actuator {number} {wrong_wiring}; allowed: {allowed}"
            for number, (wrong_wiring, allowed) in problems_together(
                wiring_of(self.actuators)
            ).items()
        ]
        if self.actuators and self.channels != "mono":
            problems.append(
                f"channels {self.channels!r} cannot be with [[actuator]]; allowed: mono, since "
                "every actuator's source says what it plays"
            )
        if problems:
            raise UsageError("; ".join(problems))

    def choosing(self, **given: Any) -> Settings:
        """Return these settings with others of the given names.

        A profile brings its parameters, but for those that were said by name.

        Raises
        ------
        UsageError
            As upon making them.
        """
        if given.get("profile") in CHOICES["profile"] and "parameters" not in given:
            kept = {name: getattr(self.parameters, name) for name in self.said}
            given["parameters"] = parameters_of(given["profile"], kept)
        return replace(self, **given)

    @property
    def sources(self) -> tuple[str, ...]:
        """The sources that the actuators play, one vibration each; none without actuators."""
        return sources_of(self.actuators)

    @property
    def numbered_channels(self) -> ChannelMap:
        """The actuators on a device of as many channels as they need, such as a file.

        UsageError: one of them goes by a name, and a file's channels have none.
        """
        wiring = wiring_of(self.actuators)
        return ChannelMap.of(
            wiring, channels_needed(wiring), device="a file, a card itself or the twin"
        )


def wrong_rig(value: object, folder: Path | None = None) -> Problem | None:
    """Return what is wrong with a `rig`, None where nothing is. folder: where files are."""
    allowed = f"{', '.join(SHIPPED)}, or a file, NAME{SUFFIX}"
    if not isinstance(value, str):
        return Problem("is not a name", allowed)
    if value in SHIPPED:
        return None
    if not value.endswith(SUFFIX):
        return Problem("is not known", allowed)
    try:
        read_rig((folder or Path()) / value)
    except (UsageError, ValueError) as error:  # ValueError: a path that cannot be
        return Problem(f"cannot be used ({error})", allowed)
    return None


def wrong_gain(value: object) -> Problem | None:
    """Return what is wrong with a `gain_db`, None where nothing is."""
    allowed = f"{GAIN_MIN_DB:g} to {GAIN_MAX_DB:g} dB"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return Problem("is not a number", allowed)
    return None if GAIN_MIN_DB <= value <= GAIN_MAX_DB else Problem("is out of range", allowed)
