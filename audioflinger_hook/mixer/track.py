"""A track as its client holds it: a ring to write into and requests to the mixer."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.mixer.pcm import PcmData, PcmFormat, decode_rows, stored_frames
from device.errors import UsageError
from device.layouts import CHANNELS_MAX
from device.units import Float32Array


class TrackState(Enum):
    """State of a track. Only the mixer's thread changes it."""

    IDLE = "idle"  # made, never started
    ACTIVE = "active"  # playing, or filling up to the start threshold
    PAUSING = "pausing"  # the next buffer ramps down
    PAUSED = "paused"  # silent; the frames left in the ring stay
    RESUMING = "resuming"  # the next buffer ramps up
    STOPPING = "stopping"  # playing the frames written before the stop
    STOPPED = "stopped"  # played to the end
    FLUSHED = "flushed"  # the frames written before the flush are dropped


class Request(Enum):
    """What a client asks of its track."""

    START = "start"
    PAUSE = "pause"
    STOP = "stop"
    FLUSH = "flush"
    REMOVE = "remove"


# No set: every lookup in a set would run Enum's hash function, which is Python code.
PLAYING = (TrackState.ACTIVE, TrackState.PAUSING, TrackState.RESUMING, TrackState.STOPPING)
"""The states in which a track may be part of the mix."""

_S, _R = TrackState, Request
_TRANSITIONS = (
    ((_S.IDLE, _S.STOPPED, _S.FLUSHED, _S.STOPPING), _R.START, _S.ACTIVE),
    ((_S.PAUSED, _S.PAUSING), _R.START, _S.RESUMING),
    ((_S.ACTIVE, _S.RESUMING), _R.PAUSE, _S.PAUSING),
    ((_S.ACTIVE, _S.RESUMING), _R.STOP, _S.STOPPING),
    ((_S.PAUSING, _S.PAUSED), _R.STOP, _S.STOPPED),
    ((_S.IDLE, _S.PAUSING, _S.PAUSED, _S.STOPPING, _S.STOPPED), _R.FLUSH, _S.FLUSHED),
    ((_S.ACTIVE, _S.RESUMING), _R.REMOVE, _S.PAUSING),
)
_AFTER = {(old, request): new for states, request, new in _TRANSITIONS for old in states}


def after(state: TrackState, request: Request) -> TrackState:
    """Return the state after a request; it stays the same if the request has no effect in it.

    As in AudioFlinger: a playing track ignores a flush, a draining one ignores a pause. A stop from
    a pause drops the frames left.
    """
    return _AFTER.get((state, request), state)


class FrameRing:
    """A bounded ring of float32 frames: one thread writes, another reads, neither waits.

    `written` and `read` count frames. Each is raised by one thread only, after the frames
    themselves were stored or used. So the other thread never sees a part of a buffer.
    """

    def __init__(self, capacity_frames: int, channels: int) -> None:
        self._frames = np.zeros((capacity_frames, channels), np.float32)
        self.capacity_frames = capacity_frames
        self.written = 0
        self.read = 0

    @property
    def room(self) -> int:
        """Frames that can be written now. For the writing thread."""
        return self.capacity_frames - (self.written - self.read)

    def spans(self, position: int, count: int) -> tuple[Float32Array, Float32Array]:
        """Memory of `count` frames from `position` on, in two parts; the second may be empty.

        The writing thread takes up to `room` frames from `written`, the reading one from `read`.
        """
        first = position % self.capacity_frames
        wrapped = max(0, first + count - self.capacity_frames)
        return self._frames[first : first + count - wrapped], self._frames[:wrapped]


SAMPLERATES = 1_000, 768_000  # Hz, lowest and highest
PERIODS_IN_RING = 2  # mix periods that a ring holds by default


class Track:
    """One client's stream into the mix; `Mixer.create_track` makes it.

    One client thread calls `write`, `start`, `pause`, `stop`, `flush` and `set_volume`; none of
    them waits. The mixer carries requests out in order at the start of its next cycle. Any thread
    may read the properties.

    track_id: number, unique in its mixer.
    name: in the dump.
    session: the player session whose effect chain the track passes, 0 for none.
    pcm_format, samplerate, channels: of the client's samples; the rate in Hz.
    mix_samplerate, mix_frames: rate of the mix, Hz, and its frames in one cycle.
    ring_frames: capacity of the ring, at least one cycle; two by default.
    start_threshold: frames in the ring before the track first sounds; a full ring by default.
    UsageError: values are out of range; the message names all of them.
    """

    def __init__(
        self,
        track_id: int,
        name: str,
        session: int,
        pcm_format: PcmFormat,
        samplerate: int,
        channels: int,
        *,
        mix_samplerate: int,
        mix_frames: int,
        ring_frames: int | None = None,
        start_threshold: int | None = None,
    ) -> None:
        rate_wrong = out_of_range("samplerate", samplerate, *SAMPLERATES, " Hz")
        period = 1 if rate_wrong else period_frames(samplerate, mix_samplerate, mix_frames)
        ring_frames = PERIODS_IN_RING * period if ring_frames is None else ring_frames
        start_threshold = ring_frames if start_threshold is None else start_threshold
        ring_wrong = out_of_range("ring_frames", ring_frames, period, None, "")
        threshold_most = None if ring_wrong else ring_frames
        wrong = [
            *out_of_range("session", session, 0, None, ""),
            *rate_wrong,
            *out_of_range("channels", channels, 1, CHANNELS_MAX, ""),
            *ring_wrong,
            *out_of_range("start_threshold", start_threshold, 1, threshold_most, ""),
        ]
        if not isinstance(pcm_format, PcmFormat):
            known = ", ".join(known.value for known in PcmFormat)
            wrong.insert(0, f"format={pcm_format!r} is not one of PcmFormat: {known}")
        if wrong:
            raise UsageError(f"track {name!r} cannot be made: {'; '.join(wrong)}")
        self.id = track_id
        self.name = name
        self.session = session
        self.format = pcm_format
        self.samplerate = samplerate
        self.channels = channels
        self.mix_samplerate = mix_samplerate
        self.start_threshold = start_threshold
        self.ring = FrameRing(ring_frames, channels)
        self.volume: tuple[float, ...] = (1.0,)
        # each request with the count of frames written before it
        self.requests: deque[tuple[Request, int]] = deque()
        # the mixer's thread alone sets these
        self.mixed_state = TrackState.IDLE
        self.disabled = False
        self.underrun_frames = 0
        self.underruns = 0

    @property
    def state(self) -> TrackState:
        """The track's state once the mixer has carried out all requests made so far."""
        state = self.mixed_state
        for request, _ in tuple(self.requests):
            state = after(state, request)
        return state

    @property
    def is_active(self) -> bool:
        """Whether the track takes part in the mixer's next cycle."""
        return self.state in PLAYING and not self.disabled

    @property
    def frames_ready(self) -> int:
        """Frames in the ring that the mixer has not taken yet."""
        return self.ring.written - self.ring.read

    def write(self, samples: PcmData) -> int:
        """Store as many frames as there is room for and return their number; never waits.

        samples: whole frames of the track's format, as bytes or as an array of that type, flat or
            (frames, channels); copied. Offer the frames not stored again after a cycle.
        UsageError: the samples have another type or shape; nothing is stored then.
        """
        ring, rows = self.ring, self._rows(samples)
        taken = min(len(rows), ring.room)
        first, second = ring.spans(ring.written, taken)
        if self.format is PcmFormat.FLOAT:
            first[...], second[...] = rows[: len(first)], rows[len(first) : taken]
        else:
            decode_rows(rows[: len(first)], self.format, first)
            decode_rows(rows[len(first) : taken], self.format, second)
        ring.written += taken
        return taken

    def start(self) -> None:
        """Play: once the ring holds `start_threshold` frames; after a pause at once, ramping up."""
        self._ask(Request.START)

    def pause(self) -> None:
        """Ramp down over one buffer, then be silent; the frames in the ring stay."""
        self._ask(Request.PAUSE)

    def stop(self) -> None:
        """Play to the last frame written so far, then stop. In a pause: drop the frames left."""
        self._ask(Request.STOP)

    def flush(self) -> None:
        """Drop the frames written so far, after a ramp; a playing track ignores a flush."""
        self._ask(Request.FLUSH)

    def set_volume(self, volume: float | Sequence[float]) -> None:
        """Set the gain, 0 to 1, reached over the next buffer.

        volume: one gain for all channels, or (left, right), or one gain per channel of the mix.
            NaN, negative and subnormal gains are 0, gains above 1 are 1.
        UsageError: no gain is given, or more than 64.
        """
        gains = (float(volume),) if isinstance(volume, int | float) else tuple(map(float, volume))
        if not 1 <= len(gains) <= CHANNELS_MAX:
            raise UsageError(
                f"{len(gains)} gains given for track {self.name!r}; want one, a left and a right "
                f"one, or one for each channel of the mix, up to {CHANNELS_MAX}"
            )
        self.volume = gains

    def _rows(self, samples: PcmData) -> NDArray[Any]:
        """Return samples as `stored_frames`; those of a tap are such rows already."""
        if (
            self.format is PcmFormat.FLOAT
            and isinstance(samples, np.ndarray)
            and samples.dtype == np.float32
            and samples.shape[1:] == (self.channels,)
        ):
            return samples
        return stored_frames(samples, self.format, self.channels)

    def _ask(self, request: Request) -> None:
        self.requests.append((request, self.ring.written))


def period_frames(samplerate: int, mix_samplerate: int, mix_frames: int) -> int:
    """Return the most frames of a track that one mix period of `mix_frames` takes."""
    if samplerate == mix_samplerate:
        return mix_frames
    return -(-mix_frames * samplerate // mix_samplerate) + 1


def out_of_range(name: str, value: int, low: int, high: int | None, unit: str) -> list[str]:
    """Return [mistake] if a number is no int or out of its range, else []."""
    if isinstance(value, bool) or not isinstance(value, int):
        return [f"{name}={value!r} is not a whole number"]
    if value < low or (high is not None and value > high):
        allowed = f"at least {low}" if high is None else f"{low} to {high}"
        return [f"{name}={value}{unit}: want {allowed}{unit}"]
    return []
