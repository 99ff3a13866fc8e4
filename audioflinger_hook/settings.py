"""What a user may choose: profile, transform, level, damping, rig. Defaults are the paper's."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from audioflinger_hook.transform import Form, TransformParameters
from audioflinger_hook.transform.parameters import Problem
from device.errors import UsageError

Channels = Literal["mono", "each"]

CHOICES: dict[str, tuple[str, ...]] = {
    "profile": ("paper",),
    "damping": ("off",),
    "form": ("live", "reference"),
    "channels": ("mono", "each"),
    "rig": ("paper",),
}
"""Every choice by name, with the values that exist; the first one is the default."""

GAIN_MIN_DB = -60.0
GAIN_MAX_DB = 0.0

LABELS = {"form": "transform"}
"""What a choice is called on the command line, where that differs."""


@dataclass(frozen=True)
class Settings:
    """One complete set of choices.

    profile: a named set of parameters; form: which form of the transform; channels: `mono`
    mixes before the transform, `each` transforms every channel by itself; damping: how residual
    vibration is reduced; rig: the simulated device; gain_db: level of the vibration, -60 to 0;
    effects_file: an audio_effects.xml that says which effects run, None for the bundled one.

    Raises
    ------
    UsageError
        Names every choice that does not exist or is out of range, all at once.
    """

    profile: str = CHOICES["profile"][0]
    damping: str = CHOICES["damping"][0]
    form: Form = "live"
    channels: Channels = "mono"
    rig: str = CHOICES["rig"][0]
    gain_db: float = GAIN_MAX_DB
    effects_file: Path | None = None
    parameters: TransformParameters = field(default_factory=TransformParameters)

    def __post_init__(self) -> None:
        problems = [
            f"{LABELS.get(name, name)} {getattr(self, name)!r} is not known; "
            f"allowed: {', '.join(allowed)}"
            for name, allowed in CHOICES.items()
            if getattr(self, name) not in allowed
        ]
        if wrong := wrong_gain(self.gain_db):
            problems.append(f"gain_db={self.gain_db!r} {wrong.wrong}; allowed: {wrong.allowed}")
        if problems:
            raise UsageError("; ".join(problems))


def wrong_gain(value: object) -> Problem | None:
    """Return what is wrong with a `gain_db`, None where nothing is."""
    allowed = f"{GAIN_MIN_DB:g} to {GAIN_MAX_DB:g} dB"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return Problem("is not a number", allowed)
    return None if GAIN_MIN_DB <= value <= GAIN_MAX_DB else Problem("is out of range", allowed)
