"""What a scene is: named tracks, each with its own format, start and pause."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.mixer import PcmFormat


# eq=False: comparing arrays with == gives arrays, so a generated __eq__ could only fail.
@dataclass(frozen=True, eq=False)
class SceneTrack:
    """One sound of a scene and the moment it starts.

    Attributes
    ----------
    name : str
        Name of the track.
    samplerate : int
        Hz.
    frames : array of float32
        (frames, channels), full scale 1.
    start_s : float
        Start of the sound, seconds from the start of the scene.
    pcm_format : PcmFormat
        Sample format in which the sound is stored.
    pause_s : (float, float) or None
        Start and end of a pause, seconds from the start of the scene.
    """

    name: str
    samplerate: int
    frames: NDArray[np.float32]
    start_s: float
    pcm_format: PcmFormat = PcmFormat.FLOAT
    pause_s: tuple[float, float] | None = None

    @property
    def duration_s(self) -> float:
        """The track's own length in seconds."""
        return len(self.frames) / self.samplerate

    @property
    def end_s(self) -> float:
        """The moment in the scene, in seconds, at which the track is over."""
        paused_s = self.pause_s[1] - self.pause_s[0] if self.pause_s else 0.0
        return self.start_s + self.duration_s + paused_s


@dataclass(frozen=True, eq=False)
class Scene:
    """Tracks on a common time axis.

    Attributes
    ----------
    name : str
        Name of the scene.
    samplerate : int
        Rate of the mix, Hz.
    tracks : tuple of SceneTrack
        The sounds.
    duration_s : float
        Length of the scene, seconds.
    channels : int
        Channels of the mix.
    """

    name: str
    samplerate: int
    tracks: tuple[SceneTrack, ...]
    duration_s: float
    channels: int = 2

    @property
    def frame_count(self) -> int:
        """The number of frames of the mix."""
        return round(self.duration_s * self.samplerate)

    def events(self) -> list[tuple[float, float, str]]:
        """(start_s, end_s, name) of every stretch that sounds, in order: to write above a plot."""
        stretches = []
        for track in self.tracks:
            pause_s, resume_s = track.pause_s or (track.end_s, track.end_s)
            stretches.append((track.start_s, pause_s, track.name))
            if resume_s < track.end_s:
                stretches.append((resume_s, track.end_s, track.name))
        return sorted(stretches)
