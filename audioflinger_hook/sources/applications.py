"""A client for several independent sounds: one track per sound; one sound sets the pace."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.mixer import Mixer, PcmFormat, Track

# If the voice that sets the pace is silent for this long, another voice takes over.
PACE_LOST_S = 0.05
# Limit of a voice's waiting frames; older frames are dropped, else the delay would grow.
WAITING_S = 0.04

_Frames = NDArray[np.float32]


@dataclass(eq=False)
class Voice:
    """One sound, whose frames wait here until a cycle takes them. dropped: frames lost."""

    name: str
    track: Track
    waiting: deque[_Frames] = field(default_factory=deque)
    frames: int = 0
    dropped: int = 0

    def take(self, count: int) -> _Frames:
        """Return the next `count` frames; if there are fewer, silence precedes them."""
        out = np.zeros((count, self.track.channels), np.float32)
        at = count - min(count, self.frames)
        while at < count:
            first = self.waiting.popleft()
            part = first[: count - at]
            out[at : at + len(part)] = part
            at += len(part)
            if len(part) < len(first):
                self.waiting.appendleft(first[len(part) :])
        self.frames -= min(count, self.frames)
        return out


class VoicesClient:
    """Mixes sounds that arrive independently, such as applications; one sets the pace.

    The supervising thread calls `add` and `remove`. The thread on which all sounds arrive calls the
    other methods and steps the pipeline. samplerate, channels: of the mix and of every voice; Hz.
    pending_frames: for which cycles are due.
    """

    frames_expected = None

    def __init__(self, samplerate: int, channels: int) -> None:
        self.samplerate = samplerate
        self.channels = channels
        self._most_waiting = round(WAITING_S * samplerate)
        self._mixer: Mixer | None = None
        self._voices: tuple[Voice, ...] = ()
        self._pacer: Voice | None = None
        self._paced_s = 0.0
        self.pending_frames = 0

    def connect(self, mixer: Mixer) -> None:
        """Keep the mixer; voices can be added from now on."""
        self._mixer = mixer

    def add(self, name: str) -> Voice:
        """Return a new voice, with a track of this name."""
        assert self._mixer is not None
        track = self._mixer.create_track(
            name, PcmFormat.FLOAT, self.samplerate, self.channels, start_threshold=1
        )
        track.start()
        voice = Voice(name, track)
        self._voices = (*self._voices, voice)
        return voice

    def remove(self, voice: Voice) -> None:
        """Release a voice and its track; no more frames may be pushed to it."""
        assert self._mixer is not None
        self._voices = tuple(other for other in self._voices if other is not voice)
        if self._pacer is voice:
            self._pacer = None
        voice.track.stop()
        self._mixer.remove_track(voice.track)

    def push(self, voice: Voice, frames: _Frames, now_s: float) -> None:
        """Take frames of one voice, (frames, channels) float32, at now_s; they are not copied."""
        voice.waiting.append(frames)
        voice.frames += len(frames)
        if self._pacer is None or now_s - self._paced_s > PACE_LOST_S:
            self._pacer = voice
        if voice is self._pacer:
            self._paced_s = now_s
            self.pending_frames += len(frames)
            return
        while voice.frames - len(voice.waiting[0]) > self._most_waiting:
            dropped = voice.waiting.popleft()
            voice.frames -= len(dropped)
            voice.dropped += len(dropped)

    def play(self) -> int | None:
        """Write the frames that are due, at most one cycle, and return their number."""
        assert self._mixer is not None
        count = min(self.pending_frames, self._mixer.frames)
        if not count:
            return None
        self.pending_frames -= count
        for voice in self._voices:
            voice.track.write(voice.take(count))
        return count

    def close(self) -> None:
        """Drop all waiting frames."""
        self.pending_frames = 0
        for voice in self._voices:
            voice.waiting.clear()
            voice.frames = 0
