"""What a scene is: named tracks, each with its own start, and their plain sum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MIXDOWN_CHANNELS = 2


# eq=False: comparing arrays with == gives arrays, so a generated __eq__ could only fail.
@dataclass(frozen=True, eq=False)
class SceneTrack:
    """One sound of a scene and the moment it starts.

    `frames` has the shape (frames, channels), full scale is 1; `start_s` counts from the start of
    the scene.
    """

    name: str
    samplerate: int
    frames: NDArray[np.float32]
    start_s: float

    def __post_init__(self) -> None:
        if self.samplerate <= 0:
            raise ValueError(f"track {self.name!r}: samplerate={self.samplerate} is not above 0 Hz")
        if self.frames.ndim != 2:
            raise ValueError(
                f"track {self.name!r}: frames has shape {self.frames.shape}, "
                "want (frames, channels); add a channel axis to mono sound"
            )
        if not self.start_s >= 0.0:
            raise ValueError(f"track {self.name!r}: start_s={self.start_s} lies before the scene")

    @property
    def duration_s(self) -> float:
        """The track's own length in seconds."""
        return len(self.frames) / self.samplerate

    @property
    def end_s(self) -> float:
        """The moment in the scene, in seconds, at which the track is over."""
        return self.start_s + self.duration_s


@dataclass(frozen=True, eq=False)
class Scene:
    """Tracks on a common time axis of `duration_s` seconds; `samplerate` is that of the mixdown."""

    name: str
    samplerate: int
    tracks: tuple[SceneTrack, ...]
    duration_s: float

    def __post_init__(self) -> None:
        for track in self.tracks:
            # Half a frame of slack: start_s need not lie on the frame grid.
            if track.end_s > self.duration_s + 0.5 / track.samplerate:
                raise ValueError(
                    f"track {track.name!r} ends at {track.end_s:.3f} s, after the scene's "
                    f"duration_s={self.duration_s}; make the scene longer or the track shorter"
                )

    @property
    def frame_count(self) -> int:
        """The number of frames of the mixdown."""
        return round(self.duration_s * self.samplerate)

    def mixdown(self) -> NDArray[np.float32]:
        """The plain sum of all tracks, float32 of shape (frames, 2): no gain, no limiter.

        Raises ValueError for a track that is not stereo at the scene's samplerate: to convert is
        the work of a mixer.
        """
        mix = np.zeros((self.frame_count, MIXDOWN_CHANNELS), dtype=np.float32)
        for track in self.tracks:
            channels = track.frames.shape[1]
            if track.samplerate != self.samplerate or channels != MIXDOWN_CHANNELS:
                raise ValueError(
                    f"track {track.name!r} has {channels} channel(s) at {track.samplerate} Hz; "
                    f"mixdown() sums only {MIXDOWN_CHANNELS} channels at {self.samplerate} Hz, "
                    "use a mixer for anything else"
                )
            start = round(track.start_s * self.samplerate)
            stop = min(start + track.frames.shape[0], mix.shape[0])
            mix[start:stop] += track.frames[: stop - start]
        return mix

    def events(self) -> list[tuple[float, float, str]]:
        """(start_s, end_s, name) of every track, in order of start: what to write above a plot."""
        return sorted((track.start_s, track.end_s, track.name) for track in self.tracks)
