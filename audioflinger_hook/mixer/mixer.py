"""The mixer: each call of `cycle` mixes tracks, applies effect chains and writes to sinks."""

import itertools
import math
from collections import deque
from collections.abc import Callable, Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np

from audioflinger_hook.mixer import mix_buffer
from audioflinger_hook.mixer.pcm import PcmFormat
from audioflinger_hook.mixer.track import SAMPLERATES, Request, Track, out_of_range
from audioflinger_hook.mixer.track_mixer import Lane, Readiness
from device.errors import UsageError
from device.layouts import CHANNELS_MAX
from device.units import Float32Array

TAIL_S = 1.0  # a player's effects process silence for this time after its last track


class MixerState(Enum):
    """State of the mixer after a cycle."""

    STANDBY = "standby"  # nothing was written
    IDLE = "idle"  # no track is active
    ENABLED = "enabled"  # no active track had enough frames
    READY = "ready"  # at least one track was mixed


class CycleReport(NamedTuple):
    """Report of one cycle.

    state: state of the mixer after the cycle. frames_written: 0 in standby. tracks_mixed: number of
    mixed tracks. underruns: number of playing tracks that had too few frames. buffer: the written
    samples, or silence in standby; the next cycle overwrites the buffer.
    """

    state: MixerState
    frames_written: int
    tracks_mixed: int
    underruns: int
    buffer: mix_buffer.MixBuffer


class Mixer:
    """Mixes tracks to one stream, applies effects and writes the result to sinks.

    One thread calls `cycle`. The thread of each client creates and uses its own tracks. Any thread
    may call `post` and read attributes. Only `cycle` may wait, for a sink or an effect.

    samplerate, channels, haptic_channels: format of the mix; samplerate in Hz.
    hal_frames: frames per buffer of the hardware. See `normal_buffer_frames`.
    sinks: receive each buffer after the effects. effects: None for no effects.
    standby_delay_s: seconds without an active track until standby; inf for no standby.
    on_mix: called in each cycle except in standby, with the mix before the effects of session 0,
        (frames, channels); the mixer reuses the array.
    UsageError: numbers are out of range; the message names all of them.
    """

    def __init__(
        self,
        samplerate: int,
        channels: int,
        *,
        hal_frames: int = 240,
        haptic_channels: int = 0,
        sinks: Sequence[mix_buffer.Sink] = (),
        effects: mix_buffer.EffectsPort | None = None,
        standby_delay_s: float = 3.0,
    ) -> None:
        wrong = [
            *out_of_range("hal_frames", hal_frames, 1, 1 << 16, ""),
            *out_of_range("samplerate", samplerate, *SAMPLERATES, " Hz"),
            *out_of_range("channels", channels, 1, CHANNELS_MAX, ""),
            *out_of_range("haptic_channels", haptic_channels, 0, CHANNELS_MAX, ""),
        ]
        if wrong:
            raise UsageError(f"the mix cannot have {'; '.join(wrong)}")
        self.samplerate, self.channels = samplerate, channels
        self.haptic_channels, self.hal_frames = haptic_channels, hal_frames
        self.frames = mix_buffer.normal_buffer_frames(samplerate, hal_frames)
        self.buffer = mix_buffer.MixBuffer(self.frames, channels, haptic_channels)
        self.sinks = tuple(sinks)
        self.effects: mix_buffer.EffectsPort = effects or mix_buffer.EffectsPort()
        self.on_mix: Callable[[Float32Array], None] | None = None
        self._events: deque[Callable[[], None]] = deque()
        self._lanes: tuple[Lane, ...] = ()
        self._sessions: dict[int, SessionMix] = {}
        self._chains: frozenset[int] = frozenset()
        self.empty = True
        self._track_ids = itertools.count(1)
        self._last_ready_s = 0.0
        self._standby_delay_s = standby_delay_s
        self.state = MixerState.STANDBY if standby_delay_s < math.inf else MixerState.IDLE
        self.cycles = self.cycles_written = self.frames_written = self.failed_events = 0
        self.last_failure = ""
        self._scratch = np.zeros((self.frames, channels), np.float32)
        self.effects.set_format(samplerate, channels, haptic_channels, self.frames)

    @property
    def tracks(self) -> tuple[Track, ...]:
        """Tracks in the mixer, in order of creation."""
        return tuple(lane.track for lane in self._lanes)

    def create_track(
        self,
        name: str,
        pcm_format: PcmFormat,
        samplerate: int,
        channels: int,
        *,
        session: int = 0,
        ring_frames: int | None = None,
        start_threshold: int | None = None,
    ) -> Track:
        """Create a track, which joins the mix at the next cycle. Any thread may call this."""
        track = Track(
            next(self._track_ids),
            name,
            session,
            pcm_format,
            samplerate,
            channels,
            mix_samplerate=self.samplerate,
            mix_frames=self.frames,
            ring_frames=ring_frames,
            start_threshold=start_threshold,
        )
        # The filter design in Lane takes time, so it runs in the client's thread.
        lane = Lane(track, self.samplerate, self.channels, self.frames)

        def add() -> None:
            self._lanes = (*self._lanes, lane)

        self.post(add)
        return track

    def remove_track(self, track: Track) -> None:
        """Remove a track: an active one after a fade-out, a stopping one after its last frames."""
        track.requests.append((Request.REMOVE, track.ring.written))

    def post(self, event: Callable[[], None]) -> None:
        """Let the mixer's thread call `event` in the next cycle. The dump counts failed events."""
        self._events.append(event)

    def cycle(self, now_s: float, frames: int | None = None) -> CycleReport:
        """Execute one cycle.

        now_s: time in s of a monotonic clock. frames: length of the cycle, 1 to `self.frames` (the
        default). With cycles as long as the buffers of the source, mixing adds no delay.
        """
        self.cycles += 1
        # An event can post another event, which then waits for the next cycle.
        for _ in range(len(self._events)):
            event = self._events.popleft()
            try:
                event()
            except Exception as failure:  # a failing event must not interrupt the sound
                self.failed_events += 1
                self.last_failure = f"{type(failure).__name__}: {failure}"
        for lane in self._lanes:
            lane.update()  # carries out the client's requests
        if any(lane.gone for lane in self._lanes):
            self._lanes = tuple(lane for lane in self._lanes if not lane.gone)
        active = [lane for lane in self._lanes if lane.is_active]
        if self._stands_by(bool(active), now_s):
            return CycleReport(MixerState.STANDBY, 0, 0, 0, self.buffer)
        frames = self.frames if frames is None else max(1, min(frames, self.frames))
        mixed, underruns = self._mix(active, frames)
        if mixed:
            self.state, self._last_ready_s = MixerState.READY, now_s
        else:
            self.state = MixerState.ENABLED if active else MixerState.IDLE
        self._process(now_s)
        for sink in self.sinks:
            sink.write(self.buffer)
        self.effects.end_of_cycle(now_s)
        self.cycles_written += 1
        self.frames_written += frames
        return CycleReport(self.state, frames, mixed, underruns, self.buffer)

    def _stands_by(self, any_active: bool, now_s: float) -> bool:
        """Enter standby if no track was mixed for `standby_delay_s`. Return True in standby."""
        asleep = self.state is MixerState.STANDBY
        if any_active:
            if asleep:
                self._last_ready_s = now_s
            return False
        if not asleep and now_s - self._last_ready_s >= self._standby_delay_s:
            self.state = MixerState.STANDBY
            self.buffer.clear()
            for session_mix in self._sessions.values():
                session_mix.clear()
            for sink in self.sinks:
                sink.standby()
        return self.state is MixerState.STANDBY

    def _mix(self, active: list[Lane], frames: int) -> tuple[int, int]:
        """Mix the tracks. Return the numbers of mixed tracks and of tracks with too few frames."""
        # Each player session with an effect chain has its own mix.
        self._chains = frozenset(self.effects.sessions())
        players = {session for session in self._chains if session > mix_buffer.OUTPUT_MIX}
        if players != self._sessions.keys():
            self._sessions = {
                session: self._sessions.get(session)
                or SessionMix(self.samplerate, self.frames, self.channels, self.haptic_channels)
                for session in sorted(players, reverse=True)
            }
        if self.buffer.frames != frames:
            self.buffer.hold(frames)
        scratch = self._scratch[:frames]
        for of_player in self._sessions.values():
            of_player.buffer.hold(frames)
        self.buffer.haptic[...] = 0.0
        self.empty = True
        mixed = underruns = 0
        for lane in active:
            if (readiness := lane.prepare(frames)) is not Readiness.READY:
                underruns += readiness is Readiness.UNDERRUN
                continue
            mixed += 1
            mix: Mixer | SessionMix = self._sessions.get(lane.track.session, self)
            lane.mix(mix.buffer.audio, scratch, first=mix.empty)
            mix.empty = False
        return mixed, underruns

    def _process(self, now_s: float) -> None:
        """Apply the players' chains, add their outputs to the mix, then apply the mix's chains."""
        buffer = self.buffer
        for session, session_mix in self._sessions.items():
            if not session_mix.begin():
                continue
            self.effects.process(session, session_mix.buffer, now_s)
            if self.empty:
                buffer.samples[...] = session_mix.buffer.samples
                self.empty = False
            else:
                buffer.samples += session_mix.buffer.samples
        if self.empty:
            buffer.audio[...] = 0.0
        if self.on_mix is not None:
            self.on_mix(buffer.audio)
        for session in (mix_buffer.OUTPUT_MIX, mix_buffer.OUTPUT_STAGE, mix_buffer.DEVICE):
            if session in self._chains:
                self.effects.process(session, buffer, now_s)


class SessionMix:
    """Mix of the tracks of one player session, for the session's own effects."""

    def __init__(self, samplerate: int, frames: int, channels: int, haptic_channels: int) -> None:
        self.buffer = mix_buffer.MixBuffer(frames, channels, haptic_channels)
        self._tail_whole = round(TAIL_S * samplerate)
        self._tail_left, self.empty = 0, True  # empty: whether no track was added

    def begin(self) -> bool:
        """Prepare the buffer for effects; return False if no track was added for `TAIL_S`."""
        self.buffer.haptic[...] = 0.0
        if not self.empty:
            self.empty = True
            self._tail_left = self._tail_whole
            return True
        self.buffer.audio[...] = 0.0
        if self._tail_left <= 0:
            return False
        self._tail_left -= self.buffer.frames
        return True

    def clear(self) -> None:
        """Set the samples to 0, for standby."""
        self.buffer.clear()
        self.empty = True
        self._tail_left = 0
