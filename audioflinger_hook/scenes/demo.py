"""The bundled demo scene: 15 s made by code, the same on every call.

    0         2         4         6         8         10        12        14   s
      engine ----  pause  ---->
                        footsteps ->
                                   speech --->
                                               (silence)
                                                     explosion ------>
                                                              chord ------------>

Each sound has its own rate and sample format, as an application would. The engine is paused and
resumed. Each sound plays alone for some time, and neighbours overlap a little. A second of digital
silence precedes the explosion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.mixer import PcmFormat
from audioflinger_hook.scenes.chord import chord
from audioflinger_hook.scenes.engine import engine
from audioflinger_hook.scenes.impacts import explosion, footsteps
from audioflinger_hook.scenes.shaping import MIN_SAMPLERATE
from audioflinger_hook.scenes.speech import speech
from audioflinger_hook.scenes.tracks import Scene, SceneTrack
from device.errors import UsageError

DEMO_DURATION_S = 15.0
MAX_SAMPLERATE = 192_000

Voice = Callable[[int, "np.random.Generator", float], NDArray[np.float32]]


@dataclass(frozen=True)
class DemoTrack:
    """One sound of the demo: what makes it, when it plays, how it is stored. Peak in full scale."""

    name: str
    voice: Voice
    start_s: float
    peak: float
    samplerate: int
    pcm_format: PcmFormat
    channels: int = 2
    pause_s: tuple[float, float] | None = None


# Only the explosion comes near full scale.
DEMO_TRACKS = (
    DemoTrack("engine", engine, 0.30, 0.62, 44_100, PcmFormat.I16, pause_s=(2.70, 3.20)),
    DemoTrack("footsteps", footsteps, 4.40, 0.60, 32_000, PcmFormat.I24),
    DemoTrack("speech", speech, 6.70, 0.42, 16_000, PcmFormat.I16, channels=1),
    DemoTrack("explosion", explosion, 9.85, 0.86, 48_000, PcmFormat.FLOAT),
    DemoTrack("chord", chord, 11.70, 0.60, 96_000, PcmFormat.I32),
)

_SEED = 2718


def demo_scene(samplerate: int = 48_000) -> Scene:
    """Return the demo scene: five tracks, to be mixed in stereo.

    Deterministic, without I/O, in under a second. The arrays are read-only.

    Parameters
    ----------
    samplerate : int
        Rate of the mix, 16 000 to 192 000 Hz.

    Raises
    ------
    UsageError
        The rate is out of range.
    """
    if not MIN_SAMPLERATE <= samplerate <= MAX_SAMPLERATE:
        raise UsageError(
            f"samplerate={samplerate} is outside {MIN_SAMPLERATE} to {MAX_SAMPLERATE} Hz, where "
            "the demo scene keeps its character; make it at 48000 Hz and resample"
        )
    tracks = []
    for index, demo in enumerate(DEMO_TRACKS):
        # A generator of its own: a change to one voice leaves the others as they were.
        frames = demo.voice(demo.samplerate, np.random.default_rng([_SEED, index]), demo.peak)
        if demo.channels == 1:
            frames = frames.mean(axis=1, keepdims=True, dtype=np.float32)
        frames.setflags(write=False)
        tracks.append(
            SceneTrack(
                demo.name, demo.samplerate, frames, demo.start_s, demo.pcm_format, demo.pause_s
            )
        )
    return Scene("demo", samplerate, tuple(tracks), DEMO_DURATION_S)
