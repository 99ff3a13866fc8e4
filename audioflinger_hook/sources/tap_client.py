"""A client that plays a tap on one track, and a tap that receives buffers by `push`."""

import numpy as np

from audioflinger_hook.mixer import Mixer, PcmFormat, Track
from audioflinger_hook.mixer.resampler import frames_out, tail_frames_out
from audioflinger_hook.sources.tap import Tap
from device.units import Float32Array


class PushTap:
    """A `Tap` of the buffers from `push`. One thread uses it, but any thread may call `interrupt`.

    samplerate, channels: format of the first buffer; samplerate in Hz.
    """

    frames_expected = None

    def __init__(self, samplerate: int, channels: int) -> None:
        self.samplerate = samplerate
        self.channels = channels
        self.format_changed = self.discontinuity = False
        self._buffer: Float32Array | None = None
        self._format = (samplerate, channels)
        self._begun = self._broken = self._ended = False
        # `interrupt` replaces this object, and `push` detects the change.
        self._interruption = self._seen = object()

    @property
    def waiting(self) -> bool:
        """Whether a pushed buffer has not been read yet."""
        return self._buffer is not None

    @property
    def starved(self) -> bool:
        """Whether the next buffer has not been pushed yet, and the sound has not ended."""
        return self._buffer is None and not self._ended

    def change(self, samplerate: int, channels: int) -> bool:
        """Set the format of the next buffers; samplerate in Hz. Return whether it has changed."""
        changed = (samplerate, channels) != (self.samplerate, self.channels)
        self.samplerate, self.channels = samplerate, channels
        return changed

    def interrupt(self) -> None:
        """Mark the next buffer as a discontinuity, unless it is the first buffer."""
        self._interruption = object()

    def push(self, frames: Float32Array) -> bool:
        """Store a buffer; drop an unread one. Return whether frames are missing before `frames`."""
        interruption = self._interruption
        self._broken = self.waiting or (self._begun and interruption is not self._seen)
        self._seen, self._begun = interruption, True
        self._buffer = frames
        return self._broken

    def read(self) -> Float32Array | None:
        """Return and remove the stored buffer; return None if there is none."""
        buffer, self._buffer = self._buffer, None
        if buffer is not None:
            before, self._format = self._format, (self.samplerate, self.channels)
            self.format_changed = before != self._format
            self.discontinuity = self._broken
        return buffer

    def end(self) -> None:
        """Declare that no more buffers follow."""
        self._ended = True

    def close(self) -> None:
        """Drop the stored buffer."""
        self._buffer = None


class TapClient:
    """Plays each buffer of a tap as soon as the tap delivers it. tap: source of the buffers.

    If tap and mixer have the same samplerate and number of channels, the mix equals the sound,
    without delay. After a change of the tap's format, a new track plays the sound.
    buffers, format_changes, discontinuities: counts since the start.
    """

    def __init__(self, tap: Tap) -> None:
        self.samplerate = tap.samplerate
        self.channels = tap.channels
        self.frames_expected = tap.frames_expected
        self.buffers = self.format_changes = self.discontinuities = 0
        self._tap = tap
        self._track: Track | None = None
        self._pending: Float32Array = np.zeros((0, tap.channels), np.float32)
        self._tail = 0
        self._ended = False

    @property
    def pending_frames(self) -> int:
        """Number of frames of the last buffer that have not been played yet."""
        return len(self._pending)

    def connect(self, mixer: Mixer) -> None:
        """Create the track."""
        self._mixer = mixer
        self._begin(self._tap.samplerate, self._tap.channels)

    def play(self) -> int | None:
        """Write part of a buffer. Return the number of mix frames; 0: no buffer yet; None: end."""
        while True:
            if not len(self._pending):
                if getattr(self._tap, "starved", False):
                    return 0
                buffer = None if self._ended else self._tap.read()
                if buffer is None:  # the resamplers' last output
                    if not self._ended:
                        self._ended = True
                        self._stop()
                    frames = min(self._tail, self._mixer.frames)
                    self._tail -= frames
                    return frames or None
                self.buffers += 1
                self.discontinuities += self._tap.discontinuity
                if self._tap.format_changed:
                    self.format_changes += 1
                    self._begin(self._tap.samplerate, self._tap.channels)
                self._pending = buffer
            part = self._pending[: self._most_at_once]
            self._pending = self._pending[len(part) :]
            assert self._track is not None
            self._written += self._track.write(part)
            due = frames_out(self._written, self._rate, self._mixer.samplerate) - self._mixed
            if due:
                self._mixed += due
                self._tail = max(0, self._tail - due)
                return due

    def close(self) -> None:
        """Close the tap."""
        self._tap.close()

    def _begin(self, samplerate: int, channels: int) -> None:
        """Create a track for the following buffers. A previous track plays its remaining frames."""
        if self._track is not None:
            self._stop()
            self._mixer.remove_track(self._track)
        mixer = self._mixer
        self._rate = samplerate
        self._written = self._mixed = 0
        most = max(1, (mixer.frames - 1) * samplerate // mixer.samplerate)
        self._most_at_once = mixer.frames if samplerate == mixer.samplerate else most
        self._track = mixer.create_track(
            "tap", PcmFormat.FLOAT, samplerate, channels, start_threshold=1
        )
        self._track.start()

    def _stop(self) -> None:
        assert self._track is not None
        self._track.stop()
        self._tail = max(self._tail, tail_frames_out(self._rate, self._mixer.samplerate))
