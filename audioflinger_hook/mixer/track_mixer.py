"""The mixer's side of a track: executes requests, converts frames and adds frames to the mix."""

from collections.abc import Sequence
from enum import Enum

import numpy as np

from audioflinger_hook.mixer.layouts import ChannelMap
from audioflinger_hook.mixer.resampler import Resampler
from audioflinger_hook.mixer.track import PLAYING, Request, Track, TrackState, after, period_frames
from device.layouts import sides
from device.units import Float32Array

SMALLEST_NORMAL = float(np.finfo(np.float32).tiny)
RETRIES = 50  # a track is disabled when it has missed this many full cycles in a row, about 1 s

Gains = tuple[float, ...]


def usable_gain(gain: float) -> float:
    """Return the gain limited to 0 to 1; 0 for NaN and subnormal gains."""
    # max(0, gain) would not change NaN to 0.
    return min(gain, 1.0) if gain >= SMALLEST_NORMAL else 0.0


def gains_of(volume: Sequence[float], channels: int) -> Gains:
    """Return one valid gain per channel of the mix, rounded to float32.

    volume: one gain for all channels, or a (left, right) pair, or one gain per channel. Centre
    channels use the mean of a pair. Channels without a gain use the last gain.
    """
    usable = [float(np.float32(usable_gain(gain))) for gain in volume]
    if len(usable) == 2:
        left, right = usable
        of_side = {"L": left, "R": right, "C": usable_gain(float(np.float32((left + right) * 0.5)))}
        return tuple(of_side[side] for side in sides(channels))
    return tuple(usable[min(channel, len(usable) - 1)] for channel in range(channels))


class VolumeRamp:
    """Gains of one track, which change by a linear ramp over one buffer.

    Frame i of n has gain old + (new - old) i/n. A track's first buffer has no ramp. gains: current
    gain per channel, or None before the first buffer.
    """

    def __init__(self, channels: int, frames: int) -> None:
        self._rise = _rise(frames)
        self._silent: Gains = (0.0,) * channels
        self._unity: Gains = (1.0,) * channels
        self.gains: Gains | None = None
        self._row = np.zeros(channels, np.float32)

    def mute(self) -> None:
        """Set the gains to 0, so that the next buffer fades in."""
        self.gains = self._silent

    def mix(
        self,
        source: Float32Array,
        target: Float32Array,
        goal: Gains | None,
        scratch: Float32Array,
        *,
        first: bool,
    ) -> None:
        """Add `source` times the gains to `target`; if `first`, overwrite `target`.

        source: (frames, channels) or (frames, 1). scratch: working memory, (frames, channels).
        goal: gains at the end of the buffer, or None for silence.
        """
        goal = self._silent if goal is None else goal
        now = goal if self.gains is None else self.gains
        self.gains = goal
        if now == goal == self._unity:
            if first:
                target[...] = source
            else:
                target += source
            return
        product = target if first else scratch
        if now == goal:
            self._row[:] = goal
            np.multiply(source, self._row, out=product)
        else:
            frames = len(source)
            rise = self._rise if frames == len(self._rise) else _rise(frames)
            self._row[:] = [new - old for new, old in zip(goal, now, strict=True)]
            np.multiply(rise, self._row, out=scratch)
            self._row[:] = now
            scratch += self._row
            np.multiply(scratch, source, out=product)
        if not first:
            target += product


def _rise(frames: int) -> Float32Array:
    """Return i/n for each frame i of n, (frames, 1)."""
    return (np.arange(frames, dtype=np.float64) / frames).astype(np.float32)[:, None]


class Readiness(Enum):
    """Whether a cycle can mix a track."""

    READY = "ready"
    WAITING = "waiting"  # the track waits for `start_threshold` frames or has just been paused
    UNDERRUN = "underrun"  # too few frames; the cycle omits the track


class Lane:
    """Channel mapping, resampling and gain of one track, in the mixer's thread.

    samplerate, channels: format of the mix. frames: length of the longest cycle.
    """

    def __init__(self, track: Track, samplerate: int, channels: int, frames: int) -> None:
        self.track = track
        self.gone = False
        self._filling, self._leaving = True, False
        self._missed_frames = self._written_when_disabled = self._stop_at = self._tail_frames = 0
        self._channels, self._frames = channels, frames
        self._map = ChannelMap(track.channels, channels)
        self._resampler: Resampler | None = None
        if track.samplerate != samplerate:
            resampled = min(track.channels, channels)
            self._resampler = Resampler(track.samplerate, samplerate, resampled, frames)
            self._at_rate = np.zeros((frames, resampled), np.float32)
        most = period_frames(track.samplerate, samplerate, frames)
        self._joined = np.zeros((most, track.channels), np.float32)
        mapped_frames = most if self._map.folds else frames
        self._mapped = np.zeros((mapped_frames, channels), np.float32)
        self._spare = np.zeros(mapped_frames, np.float32)
        self._ramp = VolumeRamp(channels, frames)
        self._gains: Gains = ()
        self._volume: tuple[float, ...] | None = None
        self._take = self._needed = self._cycle_frames = 0

    @property
    def is_active(self) -> bool:
        """Whether the track takes part in this cycle."""
        return self.track.mixed_state in PLAYING and not self.track.disabled

    def update(self) -> None:
        """Execute the client's requests. During a fade-out, all requests except START wait."""
        requests = self.track.requests
        self._settle()
        while requests:
            request, written = requests[0]
            if self.track.mixed_state is TrackState.PAUSING and request is not Request.START:
                break  # fade out first
            if request is Request.FLUSH and self.track.mixed_state is TrackState.STOPPING:
                self.track.mixed_state = TrackState.PAUSING
                break  # the track still plays: fade out first, then flush
            requests.popleft()
            self._carry_out(request, written)
            self._settle()

    def prepare(self, frames: int) -> Readiness:
        """Return whether a cycle of `frames` frames can mix the track. Call once per cycle."""
        resampler = self._resampler
        self._cycle_frames = frames
        self._needed = resampler.frames_needed(frames) if resampler else frames
        self._take = min(self._ready(), self._needed)
        if self.track.mixed_state is TrackState.STOPPING:
            return Readiness.READY
        self._filling = self._filling and self._ready() < self.track.start_threshold
        if not self._filling and self._take == self._needed:
            self._missed_frames = 0
            return Readiness.READY
        return self._miss()

    def mix(self, target: Float32Array, scratch: Float32Array, *, first: bool) -> None:
        """Add a cycle of a READY track to `target`, (frames, channels); if `first`, replace it."""
        sound = self._taken()
        if self._map.folds:
            sound = self._map.apply(sound, self._mapped, self._spare)
        if self._resampler is not None:
            self._resampler.feed(sound)
            sound = self._at_rate[: self._cycle_frames]
            self._resampler.produce(sound)
        if self._map.spreads:
            sound = self._map.apply(sound, self._mapped, self._spare)
        if (volume := self.track.volume) is not self._volume:
            self._volume, self._gains = volume, gains_of(volume, self._channels)
        goal = None if self.track.mixed_state is TrackState.PAUSING else self._gains
        self._ramp.mix(sound, target, goal, scratch, first=first)
        # The client may now overwrite the frames in the ring.
        self.track.ring.read += self._take
        if self.track.mixed_state is TrackState.PAUSING:
            self.track.mixed_state = TrackState.PAUSED
        elif self.track.mixed_state is TrackState.RESUMING:
            self.track.mixed_state = TrackState.ACTIVE
        elif self.track.mixed_state is TrackState.STOPPING:
            self._tail_frames -= self._needed - self._take
            self._settle()

    def _taken(self) -> Float32Array:
        """Return the frames for this cycle, (needed, channels), padded with zeros at the end."""
        ring = self.track.ring
        first, second = ring.spans(ring.read, self._take)
        if len(first) == self._needed:
            return first
        joined = self._joined[: self._needed]
        joined[: len(first)] = first
        joined[len(first) : self._take] = second
        joined[self._take :] = 0.0
        return joined

    def _miss(self) -> Readiness:
        track = self.track
        if self.track.mixed_state is TrackState.PAUSING:
            self._ramp.mute()
            self.track.mixed_state = TrackState.PAUSED
            return Readiness.WAITING
        self._missed_frames += self._cycle_frames
        if self._missed_frames >= RETRIES * self._frames:
            self._written_when_disabled = track.ring.written
            track.disabled = True
        if self._filling:
            return Readiness.WAITING
        # As in AudioFlinger, count all frames of the cycle.
        track.underruns += 1
        track.underrun_frames += self._needed
        return Readiness.UNDERRUN

    def _ready(self) -> int:
        """Return the number of frames in the ring; frames written after a stop do not count."""
        ring = self.track.ring
        if self.track.mixed_state is TrackState.STOPPING:
            return max(0, self._stop_at - ring.read)
        return ring.written - ring.read

    def _carry_out(self, request: Request, written: int) -> None:
        track, before = self.track, self.track.mixed_state
        state = track.mixed_state = after(before, request)
        if request is Request.REMOVE:
            self._leaving = True
        if before is state:
            return
        if request is Request.START:
            self._missed_frames = 0
            track.disabled = False
        elif state is TrackState.STOPPING:
            self._stop_at = written
            self._filling = False
            track.disabled = False
            self._tail_frames = self._resampler.tail_frames if self._resampler else 0
        elif state in (TrackState.FLUSHED, TrackState.STOPPED):
            track.ring.read = max(track.ring.read, written)
            self._rewind()

    def _settle(self) -> None:
        track = self.track
        if track.disabled and track.ring.written != self._written_when_disabled:
            track.disabled = False
            self._missed_frames = 0
            self._filling = True
        heard = self._ramp.gains is not None
        if self.track.mixed_state is TrackState.PAUSING and (track.disabled or not heard):
            if heard:
                self._ramp.mute()
            self.track.mixed_state = TrackState.PAUSED
        drained = self._ready() == 0 and (self._tail_frames <= 0 or not heard)
        if self.track.mixed_state is TrackState.STOPPING and drained:
            self.track.mixed_state = TrackState.STOPPED
            self._rewind()
        self.gone = self._leaving and not self.is_active

    def _rewind(self) -> None:
        self._filling = True
        self._missed_frames = 0
        self._ramp.gains = None
        if self._resampler is not None:
            self._resampler.reset()
