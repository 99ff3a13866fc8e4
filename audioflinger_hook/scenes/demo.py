"""Scenes, and the bundled demo scene: 15 s made by code, the same on every call.

    0         2         4         6         8         10        12        14   s
      engine ----  pause  ---->
                        footsteps ->
                                   speech --->
                                               (silence)
                                                     explosion ------>
                                                              chord ------------>

Each sound has its own rate and sample format, as an application would. Neighbours overlap a
little. A second of digital silence precedes the explosion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from audioflinger_hook.mixer import PcmFormat
from audioflinger_hook.scenes.chord import chord
from audioflinger_hook.scenes.engine import engine
from audioflinger_hook.scenes.impacts import explosion, footsteps
from audioflinger_hook.scenes.speech import speech
from device.units import Float32Array

DEMO_DURATION_S = 15.0
SAMPLERATE = 48_000  # of the mix, Hz

# A string, so that importing this does not import numpy.random.
Voice: TypeAlias = "Callable[[int, np.random.Generator, float], Float32Array]"


# eq=False: comparing arrays with == gives arrays, so a generated __eq__ could only fail.
@dataclass(frozen=True, eq=False)
class SceneTrack:
    """One sound of a scene and its start.

    name: of the track. samplerate: Hz. frames: (frames, channels) float32, full scale 1. start_s:
    seconds from the start of the scene. pcm_format: sample format in which the sound is stored.
    pause_s: start and end of a pause, in seconds of the scene; None: no pause.
    """

    name: str
    samplerate: int
    frames: Float32Array
    start_s: float
    pcm_format: PcmFormat = PcmFormat.FLOAT
    pause_s: tuple[float, float] | None = None

    @property
    def end_s(self) -> float:
        """End of the sound, in seconds of the scene."""
        paused_s = self.pause_s[1] - self.pause_s[0] if self.pause_s else 0.0
        return self.start_s + len(self.frames) / self.samplerate + paused_s


@dataclass(frozen=True, eq=False)
class Scene:
    """Tracks on a common time axis.

    name, duration_s: of the scene. samplerate, channels: of the mix; Hz. tracks: the sounds.
    """

    name: str
    samplerate: int
    tracks: tuple[SceneTrack, ...]
    duration_s: float
    channels: int = 2

    @property
    def frame_count(self) -> int:
        """Frames of the mix."""
        return round(self.duration_s * self.samplerate)

    def events(self) -> list[tuple[float, float, str]]:
        """Return (start_s, end_s, name) of every stretch that sounds, in order of time."""
        stretches = []
        for track in self.tracks:
            pause_s, resume_s = track.pause_s or (track.end_s, track.end_s)
            stretches.append((track.start_s, pause_s, track.name))
            if resume_s < track.end_s:
                stretches.append((resume_s, track.end_s, track.name))
        return sorted(stretches)


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


def demo_scene() -> Scene:
    """Return the demo scene: five tracks, to be mixed in stereo at 48 kHz.

    Deterministic, without I/O, in under a second. The arrays are read-only.
    """
    tracks = []
    for index, demo in enumerate(DEMO_TRACKS):
        # Each voice has its generator, so a change to one leaves the others unchanged.
        frames = demo.voice(demo.samplerate, np.random.default_rng([_SEED, index]), demo.peak)
        if demo.channels == 1:
            frames = frames.mean(axis=1, keepdims=True, dtype=np.float32)
        frames.setflags(write=False)
        place = (demo.start_s, demo.pcm_format, demo.pause_s)
        tracks.append(SceneTrack(demo.name, demo.samplerate, frames, *place))
    return Scene("demo", SAMPLERATE, tuple(tracks), DEMO_DURATION_S)
