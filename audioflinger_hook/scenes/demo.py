"""Scenes, and the demo scene: 15 s of synthesised sound, the same on every call.

    0         2         4         6         8         10        12        14   s
      engine ----  pause  ---->
                        footsteps ->
                                   speech --->
                                               (silence)
                                                     explosion ------>
                                                              chord ------------>

The sounds have different samplerates and sample formats, as sounds of separate applications can.
"""

from __future__ import annotations  # numpy.random takes memory

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from audioflinger_hook.mixer import PcmFormat
from audioflinger_hook.scenes.sounds import chord, engine, explosion, footsteps
from audioflinger_hook.scenes.speech import speech
from device.units import Float32Array

DEMO_DURATION_S = 15.0
SAMPLERATE = 48_000  # samplerate of the mix, Hz
_SEED = 2718

# The annotation is a string, so that this module does not import numpy.random.
Voice: TypeAlias = "Callable[[int, np.random.Generator, float], Float32Array]"


# eq=False: a generated __eq__ would fail, since arrays have no single truth value.
@dataclass(frozen=True, eq=False)
class SceneTrack:
    """One sound of a scene.

    name: name of the sound. samplerate: Hz. frames: (frames, channels), full scale 1. start_s:
    seconds from the start of the scene. pcm_format: sample format of the track. pause_s: start and
    end of a pause in seconds from the start of the scene, or None.
    """

    name: str
    samplerate: int
    frames: Float32Array
    start_s: float
    pcm_format: PcmFormat = PcmFormat.FLOAT
    pause_s: tuple[float, float] | None = None

    @property
    def end_s(self) -> float:
        """End of the sound in seconds from the start of the scene."""
        paused_s = self.pause_s[1] - self.pause_s[0] if self.pause_s else 0.0
        return self.start_s + len(self.frames) / self.samplerate + paused_s


@dataclass(frozen=True, eq=False)
class Scene:
    """Sounds on a common time axis.

    name: name of the scene. tracks: the sounds. duration_s: duration of the scene in seconds.
    samplerate, channels: format of the mix; samplerate in Hz.
    """

    name: str
    samplerate: int
    tracks: tuple[SceneTrack, ...]
    duration_s: float
    channels: int = 2

    @property
    def frame_count(self) -> int:
        """Number of frames of the mix."""
        return round(self.duration_s * self.samplerate)

    def events(self) -> list[tuple[float, float, str]]:
        """Return (start_s, end_s, name) of each interval with sound, in order of time."""
        stretches = []
        for track in self.tracks:
            pause_s, resume_s = track.pause_s or (track.end_s, track.end_s)
            stretches.append((track.start_s, pause_s, track.name))
            if resume_s < track.end_s:
                stretches.append((resume_s, track.end_s, track.name))
        return sorted(stretches)


@dataclass(frozen=True)
class DemoTrack:
    """One sound of the demo scene, made by `voice`. peak: largest absolute sample."""

    name: str
    voice: Voice
    start_s: float
    peak: float
    samplerate: int
    pcm_format: PcmFormat
    channels: int = 2
    pause_s: tuple[float, float] | None = None


# The explosion has the highest peak.
DEMO_TRACKS = (
    DemoTrack("engine", engine, 0.30, 0.62, 44_100, PcmFormat.I16, pause_s=(2.70, 3.20)),
    DemoTrack("footsteps", footsteps, 4.40, 0.60, 32_000, PcmFormat.I24),
    DemoTrack("speech", speech, 6.70, 0.42, 16_000, PcmFormat.I16, channels=1),
    DemoTrack("explosion", explosion, 9.85, 0.86, 48_000, PcmFormat.FLOAT),
    DemoTrack("chord", chord, 11.70, 0.60, 96_000, PcmFormat.I32),
)


def demo_sound(index: int, samplerate: int) -> Float32Array:
    """Return a sound of `DEMO_TRACKS`, (frames, 2). samplerate: Hz."""
    demo = DEMO_TRACKS[index]
    # With its own random generator, each sound stays identical if another sound is changed.
    return demo.voice(samplerate, np.random.default_rng([_SEED, index]), demo.peak)


def demo_scene() -> Scene:
    """Return the demo scene with read-only arrays, for a stereo mix at 48 kHz."""
    tracks = []
    for index, demo in enumerate(DEMO_TRACKS):
        frames = demo_sound(index, demo.samplerate)
        if demo.channels == 1:
            frames = frames.mean(axis=1, keepdims=True, dtype=np.float32)
        frames.setflags(write=False)
        place = (demo.start_s, demo.pcm_format, demo.pause_s)
        tracks.append(SceneTrack(demo.name, demo.samplerate, frames, *place))
    return Scene("demo", SAMPLERATE, tuple(tracks), DEMO_DURATION_S)
