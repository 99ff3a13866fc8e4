"""A client that plays several independent sounds, such as those of applications."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.mixer import Mixer, PcmFormat, Track

PACE_LOST_S = 0.05  # if the pacing voice has no new frames for this time, another sets the pace
WAITING_S = 0.04  # longest queue of a voice; the oldest frames beyond it are dropped

_Frames = NDArray[np.float32]


@dataclass(eq=False)
class Voice:
    """One sound with a queue of frames. frames, dropped: number of queued and of dropped frames."""

    name: str
    track: Track
    waiting: deque[_Frames] = field(default_factory=deque)
    frames: int = 0
    dropped: int = 0

    def take(self, count: int) -> _Frames:
        """Remove and return `count` frames. A shorter queue is padded with silence at the start."""
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
    """Plays sounds (voices) that arrive independently.

    One voice sets the pace: when its frames arrive, as many frames of each voice are played. One
    thread calls `add` and `remove`. Another thread calls `push` and `play`.

    samplerate, channels: format of the mix and of all voices; samplerate in Hz.
    pending_frames: number of frames that `play` has not written yet.
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
        """Set the mixer. Call this before the first `add`."""
        self._mixer = mixer

    def add(self, name: str) -> Voice:
        """Create a voice with a track of this name."""
        assert self._mixer is not None
        track = self._mixer.create_track(
            name, PcmFormat.FLOAT, self.samplerate, self.channels, start_threshold=1
        )
        track.start()
        voice = Voice(name, track)
        self._voices = (*self._voices, voice)
        return voice

    def remove(self, voice: Voice) -> None:
        """Remove a voice and its track. The caller must not push more frames for this voice."""
        assert self._mixer is not None
        self._voices = tuple(other for other in self._voices if other is not voice)
        if self._pacer is voice:
            self._pacer = None
        voice.track.stop()
        self._mixer.remove_track(voice.track)

    def push(self, voice: Voice, frames: _Frames, now_s: float) -> None:
        """Queue frames of a voice, (frames, channels), without a copy. now_s: present time in s."""
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
        """Write pending frames, at most one cycle. Return the number of frames; None for 0."""
        assert self._mixer is not None
        count = min(self.pending_frames, self._mixer.frames)
        if not count:
            return None
        self.pending_frames -= count
        for voice in self._voices:
            voice.track.write(voice.take(count))
        return count

    def close(self) -> None:
        """Drop all queued frames."""
        self.pending_frames = 0
        for voice in self._voices:
            voice.waiting.clear()
            voice.frames = 0
