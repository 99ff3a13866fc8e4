"""Ways from sound to vibration, measured from outside: a whole sound in, its vibration out."""

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

UNLIMITED = "paper"
"""The profile that keeps to the paper and is asked no limit here."""
PARTIAL = "speech"
"""The profile that leaves out on purpose what is not speech; films are not asked of it."""

Render = Callable[[FloatArray, int], FloatArray]
"""Sound, (frames,) or (frames, channels), and its rate in Hz, to vibration (frames,) in time."""


@dataclass(frozen=True)
class Method:
    """A way from sound to vibration. name: its column; limited: whether the limits are asked.

    render: gives as many frames as the sound has, without latency, at full scale +-1.
    whole: whether all of a sound is to be felt, so that films, pairs and deep tones have limits.
    parameters: of a profile.
    """

    name: str
    render: Render
    limited: bool = False
    whole: bool = True
    parameters: TransformParameters | None = None

    def vibration(
        self, sound: FloatArray, volume_db: float = 0.0, samplerate: int = SAMPLERATE
    ) -> FloatArray:
        """Return the vibration of a sound at a volume, in time with it, (frames,)."""
        return self.render(10.0 ** (volume_db / 20.0) * sound, samplerate)

    def must(self, relation: str, bound: float) -> Must | None:
        """Return the limit where limits are asked."""
        return Must(relation, bound) if self.limited else None  # type: ignore[arg-type]

    def must_of_whole(self, relation: str, bound: float) -> Must | None:
        """Return the limit where limits are asked and all of a sound is to be felt."""
        return self.must(relation, bound) if self.whole else None


def profile_methods(
    names: Iterable[str] = PROFILES, said: dict[str, Any] | None = None
) -> list[Method]:
    """Return profiles as `cushion render` applies them; said: parameters that override theirs."""
    return [_profile(name, parameters_of(name, said)) for name in names]


def _profile(name: str, parameters: TransformParameters) -> Method:
    settings = Settings(parameters=parameters)

    def render(sound: FloatArray, samplerate: int) -> FloatArray:
        return rendered(sound, samplerate, settings)

    return Method(name, render, name != UNLIMITED, name != PARTIAL, parameters)


def rendered(sound: FloatArray, samplerate: int, settings: Settings) -> FloatArray:
    """Return what `cushion render` writes for a file, (frames,) or (frames, channels)."""
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "sound.wav", Path(folder) / "vibration.wav"
        soundfile.write(source, sound.astype(np.float32), samplerate, "FLOAT", format="WAVEX")
        render_file(source, target, settings)
        vibration, _ = soundfile.read(target, dtype="float64", always_2d=True)
    return np.asarray(vibration[:, 0])


def other_methods() -> list[Method]:
    """Return the null models, then the peers; no limit is asked of them."""
    return [_streamed(subject) for subject in (*NULL_MODELS, *BASELINES)]


def _streamed(subject: Subject) -> Method:
    def render(sound: FloatArray, samplerate: int) -> FloatArray:
        frames = sound if sound.ndim == 2 else sound[:, None]
        stream = subject.start(samplerate, frames.shape[1])
        vibration = np.concatenate((stream.process(frames), stream.finish()))[:, 0]
        return vibration[-len(frames) :]

    return Method(subject.name, render)


def function_method(said: str) -> Method:
    """Return the method that MODULE:FUNCTION names, a function of mono sound at 48 kHz, (frames,).

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
