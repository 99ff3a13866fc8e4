"""A tap as a client: its buffers on one track, one cycle a buffer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.mixer import Mixer, PcmFormat, Track
from audioflinger_hook.mixer.resampler import frames_out, tail_frames_out
from audioflinger_hook.sources.tap import Tap


class TapClient:
    """Plays every buffer of a tap as it comes; the mix has the tap's first format.

    At the mixer's rate each buffer is one cycle, or several if it is longer than a cycle. So
    nothing is delayed, and the sound passes bit for bit. When the tap's format changes, a track
    of the new format takes over, and the mix stays unchanged.

    Parameters
    ----------
    tap : Tap
        The source.

    Attributes
    ----------
    buffers, format_changes, discontinuities : int
        Numbers so far.
    """

    def __init__(self, tap: Tap) -> None:
        self.samplerate = tap.samplerate
        self.channels = tap.channels
        self.buffers = 0
        self.format_changes = 0
        self.discontinuities = 0
        self._tap = tap
        self._track: Track | None = None
        self._pending: NDArray[np.float32] = np.zeros((0, tap.channels), np.float32)
        self._tail = 0
        self._ended = False

    @property
    def frames_expected(self) -> int | None:
        """As the tap says."""
        return self._tap.frames_expected

    @property
    def pending_frames(self) -> int:
        """Frames of the buffer read last that are still to be played."""
        return len(self._pending)

    def connect(self, mixer: Mixer) -> None:
        """Make the track."""
        self._mixer = mixer
        self._begin(self._tap.samplerate, self._tap.channels)

    def play(self) -> int | None:
        """Write the next buffer, or what is left of one, and return the frames of its cycle.

        0 where a tap that is pushed to has no more yet.
        """
        while True:
            if not len(self._pending):
                if getattr(self._tap, "starved", False):
                    return 0
                if not self._next_buffer():
                    return self._play_tail()
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

    def _next_buffer(self) -> bool:
        """Take the tap's next buffer; False at the end."""
        buffer = None if self._ended else self._tap.read()
        if buffer is None:
            return False
        self.buffers += 1
        self.discontinuities += self._tap.discontinuity
        if self._tap.format_changed:
            self.format_changes += 1
            self._begin(self._tap.samplerate, self._tap.channels)
        self._pending = buffer
        return True

    def _begin(self, samplerate: int, channels: int) -> None:
        """Play on a new track; the one before drains."""
        if self._track is not None:
            self._stop()
            self._mixer.remove_track(self._track)
        mixer = self._mixer
        self._rate = samplerate
        self._written = self._mixed = 0
        # at most this many frames fit into one cycle
        self._most_at_once = max(1, (mixer.frames - 1) * samplerate // mixer.samplerate)
        if samplerate == mixer.samplerate:
            self._most_at_once = mixer.frames
        self._track = mixer.create_track(
            "tap", PcmFormat.FLOAT, samplerate, channels, start_threshold=1
        )
        self._track.start()

    def _stop(self) -> None:
        """Let the track drain, and note how long a resampler's rest of it sounds."""
        assert self._track is not None
        self._track.stop()
        self._tail = max(self._tail, tail_frames_out(self._rate, self._mixer.samplerate))

    def _play_tail(self) -> int | None:
        """Return the frames of one of the last cycles, for what resamplers still hold."""
        if not self._ended:
            self._ended = True
            self._stop()
        frames = min(self._tail, self._mixer.frames)
        self._tail -= frames
        return frames or None
