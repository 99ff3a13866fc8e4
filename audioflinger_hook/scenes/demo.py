"""The bundled demo scene: 15 s made by code, the same on every call.

    0         2         4         6         8         10        12        14   s
      engine ------------->
                        footsteps ->
                                   speech --->
                                               (silence)
                                                     explosion ------>
                                                              chord ------------>

Each sound has some time to itself, so that it can be seen and felt alone; neighbours overlap a
little, so that a mixer has something to mix. A second of digital silence stands before the
explosion.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.scenes.chord import chord
from audioflinger_hook.scenes.engine import engine
from audioflinger_hook.scenes.impacts import explosion, footsteps
from audioflinger_hook.scenes.shaping import MIN_SAMPLERATE
from audioflinger_hook.scenes.speech import speech
from audioflinger_hook.scenes.tracks import Scene, SceneTrack
from device.errors import UsageError

DEMO_DURATION_S = 15.0
MAX_SAMPLERATE = 192_000

Voice = Callable[[int, np.random.Generator, float], NDArray[np.float32]]

# (name, voice, start in s, peak of the track). Only the explosion comes near full scale.
DEMO_TRACKS: tuple[tuple[str, Voice, float, float], ...] = (
    ("engine", engine, 0.30, 0.62),
    ("footsteps", footsteps, 4.40, 0.60),
    ("speech", speech, 6.70, 0.42),
    ("explosion", explosion, 9.85, 0.86),
    ("chord", chord, 11.70, 0.60),
)

_SEED = 2718


def demo_scene(samplerate: int = 48_000) -> Scene:
    """The demo scene at `samplerate` (16 000 to 192 000 Hz): five stereo tracks, float32.

    Deterministic, no I/O, under a second of work at 48 kHz. The arrays are read-only. Raises
    UsageError for a samplerate outside the range.
    """
    if not MIN_SAMPLERATE <= samplerate <= MAX_SAMPLERATE:
        raise UsageError(
            f"samplerate={samplerate} is outside {MIN_SAMPLERATE} to {MAX_SAMPLERATE} Hz, where "
            "the demo scene keeps its character; make it at 48000 Hz and resample"
        )
    tracks = []
    for index, (name, voice, start_s, peak) in enumerate(DEMO_TRACKS):
        # A generator of its own: a change to one voice leaves the others as they were.
        frames = voice(samplerate, np.random.default_rng([_SEED, index]), peak)
        frames.setflags(write=False)
        tracks.append(SceneTrack(name, samplerate, frames, start_s))
    return Scene("demo", samplerate, tuple(tracks), DEMO_DURATION_S)
