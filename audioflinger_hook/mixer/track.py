"""The client's side of a track: a ring buffer for frames, and requests to the mixer."""

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

SAMPLERATES = 1_000, 768_000  # lowest and highest, Hz


class TrackState(Enum):
    """State of a track."""

    IDLE = "idle"  # not started yet
    ACTIVE = "active"  # playing, or waiting for `start_threshold` frames
    PAUSING = "pausing"  # fades out in the next buffer
    PAUSED = "paused"  # silent; the ring keeps its frames
    RESUMING = "resuming"  # fades in during the next buffer
    STOPPING = "stopping"  # plays the frames written before the stop
    STOPPED = "stopped"  # has played or dropped the frames written before the stop
    FLUSHED = "flushed"  # the frames written before the flush are dropped


# a request from the client of a track to the mixer
Request = Enum("Request", "START PAUSE STOP FLUSH REMOVE")


# A tuple is faster than a set, because Enum's hash function is Python code.
PLAYING = (TrackState.ACTIVE, TrackState.PAUSING, TrackState.RESUMING, TrackState.STOPPING)
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
    """Return the state after a request; it is `state` if the request has no effect.

    As in AudioFlinger, an ACTIVE track ignores FLUSH and a STOPPING track ignores PAUSE.
    """
    return _AFTER.get((state, request), state)


class FrameRing:
    """Lock-free ring buffer of float32 frames for one writing and one reading thread.

    written, read: number of frames written and read since the start. The writing thread increases
    `written` after storing frames. The reading thread increases `read` after using frames.
    """

    def __init__(self, capacity_frames: int, channels: int) -> None:
        self._frames = np.zeros((capacity_frames, channels), np.float32)
        self.capacity_frames = capacity_frames
        self.written = self.read = 0

    @property
    def room(self) -> int:
        """Number of frames that the writing thread can store now."""
        return self.capacity_frames - (self.written - self.read)

    def spans(self, position: int, count: int) -> tuple[Float32Array, Float32Array]:
        """Return `count` frames, from `position` on, as two views. The second may be empty."""
        first = position % self.capacity_frames
        wrapped = max(0, first + count - self.capacity_frames)
        return self._frames[first : first + count - wrapped], self._frames[:wrapped]


class Track:
    """A client's stream into the mix. `Mixer.create_track` creates tracks.

    Only one client thread may call methods, and no method waits. The mixer executes requests in
    order at the start of its cycles. Any thread may read attributes.

    track_id: number, unique in its mixer. name: text for the dump.
    session: player session whose effect chain processes the track, 0 for none.
    pcm_format, channels: format of the client's samples.
    samplerate, mix_samplerate: rates of the client's samples and of the mix, in Hz.
    mix_frames: frames of the mix per cycle.
    ring_frames: frames that the ring can hold: at least one cycle, by default two cycles.
    start_threshold: frames in the ring at which a started track begins to play; by default a full
        ring.
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
        ring_frames = 2 * period if ring_frames is None else ring_frames
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
        self.id, self.name, self.session = track_id, name, session
        self.format, self.samplerate, self.channels = pcm_format, samplerate, channels
        self.mix_samplerate = mix_samplerate
        self.start_threshold = start_threshold
        self.ring = FrameRing(ring_frames, channels)
        self.volume: tuple[float, ...] = (1.0,)
        # Each request, and the number of frames written before the request.
        self.requests: deque[tuple[Request, int]] = deque()
        # Only the mixer's thread sets the following attributes.
        self.mixed_state = TrackState.IDLE
        self.disabled = False
        self.underruns = self.underrun_frames = 0

    @property
    def state(self) -> TrackState:
        """State after all requests, including requests that the mixer has not executed yet."""
        state = self.mixed_state
        for request, _ in tuple(self.requests):
            state = after(state, request)
        return state

    @property
    def is_active(self) -> bool:
        """Whether the track takes part in the next cycle."""
        return self.state in PLAYING and not self.disabled

    @property
    def frames_ready(self) -> int:
        """Number of frames in the ring."""
        return self.ring.written - self.ring.read

    def write(self, samples: PcmData) -> int:
        """Copy frames into the ring until the ring is full; return the number of copied frames.

        samples: as for `stored_frames`. After the next cycle, write the frames that did not fit.
        UsageError: the samples have a wrong type or shape; no frame is stored.
        """
        ring, rows = self.ring, self._rows(samples)
        taken = min(len(rows), ring.room)
        first, second = ring.spans(ring.written, taken)
        decode_rows(rows[: len(first)], self.format, first)
        decode_rows(rows[len(first) : taken], self.format, second)
        ring.written += taken
        return taken

    def start(self) -> None:
        """Begin to play when `start_threshold` frames are in the ring; after a pause, fade in."""
        self.requests.append((Request.START, self.ring.written))

    def pause(self) -> None:
        """Fade out over one buffer. The frames in the ring remain."""
        self.requests.append((Request.PAUSE, self.ring.written))

    def stop(self) -> None:
        """Play the frames written before this call, then stop. A paused track drops its frames."""
        self.requests.append((Request.STOP, self.ring.written))

    def flush(self) -> None:
        """Drop the frames written before this call. ACTIVE and RESUMING tracks ignore this."""
        self.requests.append((Request.FLUSH, self.ring.written))

    def set_volume(self, volume: float | Sequence[float]) -> None:
        """Set the gain, 0 to 1, with a ramp over the next buffer.

        volume: one gain for all channels, or a (left, right) pair, or one gain per channel of the
            mix. Gains outside of 0 to 1 are clipped; NaN becomes 0.
        UsageError: no gain, or more than 64 gains.
        """
        gains = (float(volume),) if isinstance(volume, int | float) else tuple(map(float, volume))
        if not 1 <= len(gains) <= CHANNELS_MAX:
            raise UsageError(
                f"{len(gains)} gains given for track {self.name!r}; want one, a left and a right "
                f"one, or one for each channel of the mix, up to {CHANNELS_MAX}"
            )
        self.volume = gains

    def _rows(self, samples: PcmData) -> NDArray[Any]:
        """Return `stored_frames`; a float32 array of the right shape is not copied."""
        if (
            self.format is PcmFormat.FLOAT
            and isinstance(samples, np.ndarray)
            and samples.dtype == np.float32
            and samples.shape[1:] == (self.channels,)
        ):
            return samples
        return stored_frames(samples, self.format, self.channels)


def period_frames(samplerate: int, mix_samplerate: int, mix_frames: int) -> int:
    """Return the largest number of track frames that a cycle of `mix_frames` mix frames reads."""
    if samplerate == mix_samplerate:
        return mix_frames
    return -(-mix_frames * samplerate // mix_samplerate) + 1


def out_of_range(name: str, value: int, low: int, high: int | None, unit: str) -> list[str]:
    """Return a list with an error text if the value is not an int from low to high, else []."""
    if isinstance(value, bool) or not isinstance(value, int):
        return [f"{name}={value!r} is not a whole number"]
    if value < low or (high is not None and value > high):
        allowed = f"at least {low}" if high is None else f"{low} to {high}"
        return [f"{name}={value}{unit}: want {allowed}{unit}"]
    return []
