"""Methods of converting sound to vibration, as functions of whole sounds."""

from __future__ import annotations

import importlib
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import soundfile

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.offline.render import render_file
from audioflinger_hook.transform import FloatArray, TransformParameters
from device.errors import UsageError
from tools.bench.baselines import BASELINES, NULL_MODELS
from tools.bench.report import Must
from tools.bench.sounds.signals import SAMPLERATE
from tools.bench.workbench import Subject

UNLIMITED = "paper"  # profile that follows the paper; no limits apply to this profile
PARTIAL = "speech"  # profile for speech only; no limits on films apply to this profile

Render = Callable[[FloatArray, int], FloatArray]
"""Converts sound, (frames,) or (frames, channels), at a rate in Hz, to vibration, (frames,),
without delay.
"""


@dataclass(frozen=True)
class Method:
    """A method of converting sound to vibration.

    name: heading of the method's column.
    render: function of a sound and its rate in Hz that returns equally long vibration without
        latency.
    limited: whether the measured values must meet limits.
    whole: whether the method is meant for all kinds of sound; it must then meet more limits.
    parameters: parameters of a profile; None for other methods.
    """

    name: str
    render: Render
    limited: bool = False
    whole: bool = True
    parameters: TransformParameters | None = None

    def vibration(
        self, sound: FloatArray, volume_db: float = 0.0, samplerate: int = SAMPLERATE
    ) -> FloatArray:
        """Return the vibration of a sound, (frames,), without delay.

        volume_db: gain to apply to the sound, in dB.
        """
        return self.render(10.0 ** (volume_db / 20.0) * sound, samplerate)

    def must(self, relation: str, bound: float) -> Must | None:
        """Return a limit with this relation and bound if limits apply to this method, else None."""
        return Must(relation, bound) if self.limited else None  # type: ignore[arg-type]

    def must_of_whole(self, relation: str, bound: float) -> Must | None:
        """Return the result of `must`; None if the method is not meant for all kinds of sound."""
        return self.must(relation, bound) if self.whole else None


def profile_methods(
    names: Iterable[str] = PROFILES, said: dict[str, Any] | None = None
) -> list[Method]:
    """Return, for each profile, a method that gives the same vibration as `cushion render`.

    said: parameters that replace those of the profiles.
    """
    return [_profile(name, parameters_of(name, said)) for name in names]


def _profile(name: str, parameters: TransformParameters) -> Method:
    settings = Settings(parameters=parameters)

    def render(sound: FloatArray, samplerate: int) -> FloatArray:
        return rendered(sound, samplerate, settings)

    return Method(name, render, name != UNLIMITED, name != PARTIAL, parameters)


def rendered(sound: FloatArray, samplerate: int, settings: Settings) -> FloatArray:
    """Return the first channel of the vibration that `cushion render` writes, (frames,)."""
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "sound.wav", Path(folder) / "vibration.wav"
        soundfile.write(source, sound.astype(np.float32), samplerate, "FLOAT", format="WAVEX")
        render_file(source, target, settings)
        vibration, _ = soundfile.read(target, dtype="float64", always_2d=True)
    return np.asarray(vibration[:, 0])


def other_methods() -> list[Method]:
    """Return the baselines and the methods that ignore the sound. No limits apply to them."""
    return [_streamed(subject) for subject in (*NULL_MODELS, *BASELINES)]


def _streamed(subject: Subject) -> Method:
    def render(sound: FloatArray, samplerate: int) -> FloatArray:
        frames = sound if sound.ndim == 2 else sound[:, None]
        stream = subject.start(samplerate, frames.shape[1])
        vibration = np.concatenate((stream.process(frames), stream.finish()))[:, 0]
        return vibration[-len(frames) :]

    return Method(subject.name, render)


def function_method(said: str) -> Method:
    """Return a method that calls the function MODULE:FUNCTION with sound at 48 kHz.

    UsageError: there is no such module or function.
    """
    module, _, function = said.partition(":")
    if "" not in sys.path:
        sys.path.insert(0, "")
    try:
        found = getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise UsageError(f"{said!r} is no MODULE:FUNCTION that can be imported ({error})") from None
    return Method(said, lambda sound, _samplerate: np.asarray(found(sound)), limited=True)
