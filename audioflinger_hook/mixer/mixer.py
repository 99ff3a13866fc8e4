"""The mixer: tracks, one mix, effect chains and sinks; each call of `cycle` does one cycle."""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Callable, Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np

from audioflinger_hook.mixer.mix_buffer import (
    DEVICE,
    OUTPUT_MIX,
    OUTPUT_STAGE,
    EffectsPort,
    MixBuffer,
    Sink,
    normal_buffer_frames,
)
from audioflinger_hook.mixer.pcm import PcmFormat
from audioflinger_hook.mixer.track import SAMPLERATES, Request, Track, out_of_range
from audioflinger_hook.mixer.track_mixer import Lane, Readiness
from device.errors import UsageError
from device.layouts import CHANNELS_MAX
from device.units import Float32Array

STANDBY_DELAY_S = 3.0  # time from the last mix with a track in it to standby, if no track is active
TAIL_S = 1.0  # seconds of zeros that a chain gets after its last track: its effects decay
HAL_FRAMES_MAX = 1 << 16


class MixerState(Enum):
    """State of the mixer in a cycle."""

    STANDBY = "standby"  # nothing was written
    IDLE = "idle"  # no active track; silence was written
    ENABLED = "enabled"  # no active track had a whole period of frames; silence was written
    READY = "ready"  # at least one track was mixed


class CycleReport(NamedTuple):
    """Report of one cycle.

    state, frames_written, tracks_mixed: of the cycle; no frames are written in standby.
    underruns: active tracks that had less than a whole period of frames.
    buffer: as written, silence in standby; the next cycle reuses it.
    """

    state: MixerState
    frames_written: int
    tracks_mixed: int
    underruns: int
    buffer: MixBuffer


class Mixer:
    """Mixes tracks to one stream, through effects, into sinks.

    The caller of `cycle` sets the pace. One thread calls `cycle`; each client's thread makes and
    uses its own tracks; any thread may call `post` and read attributes. Nothing waits.

    samplerate: Hz of the mix.
    channels, haptic_channels: of the mix; the haptic channels follow the audio.
    hal_frames: frames that the output takes at once; `frames`, those of a whole cycle, follow.
    sinks, effects: what takes every buffer that is written; the effect chains, None for none.
    standby_delay_s: seconds without an active track until standby. With inf, silence is written
        instead.
    on_mix: called in each cycle with the mix before the effects of session 0, (frames, channels);
        the mixer reuses the array.
    UsageError: numbers are out of range; the message names all of them.
    """

    def __init__(
        self,
        samplerate: int,
        channels: int,
        *,
        hal_frames: int = 240,
        haptic_channels: int = 0,
        sinks: Sequence[Sink] = (),
        effects: EffectsPort | None = None,
        standby_delay_s: float = STANDBY_DELAY_S,
    ) -> None:
        wrong = [
            *out_of_range("hal_frames", hal_frames, 1, HAL_FRAMES_MAX, ""),
            *out_of_range("samplerate", samplerate, *SAMPLERATES, " Hz"),
            *out_of_range("channels", channels, 1, CHANNELS_MAX, ""),
            *out_of_range("haptic_channels", haptic_channels, 0, CHANNELS_MAX, ""),
        ]
        if wrong:
            raise UsageError(f"the mix cannot have {'; '.join(wrong)}")
        self.samplerate, self.channels = samplerate, channels
        self.haptic_channels = haptic_channels
        self.hal_frames = hal_frames
        self.frames = normal_buffer_frames(samplerate, hal_frames)
        self.buffer = MixBuffer(self.frames, channels, haptic_channels)
        self.sinks = tuple(sinks)
        self.effects: EffectsPort = effects or EffectsPort()
        self.on_mix: Callable[[Float32Array], None] | None = None
        self._events: deque[Callable[[], None]] = deque()
        self._lanes: tuple[Lane, ...] = ()
        self._sessions: dict[int, SessionMix] = {}
        self._chains: frozenset[int] = frozenset()
        self._empty = True
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
        """The tracks that the mixer holds, in the order in which they were made."""
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
        """Make a track, mixed from the next cycle on. From any client's thread. See `Track`."""
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
        # made here, so that the audio thread does not have to design a filter
        lane = Lane(track, self.samplerate, self.channels, self.frames)

        def add() -> None:
            self._lanes = (*self._lanes, lane)

        self.post(add)
        return track

    def remove_track(self, track: Track) -> None:
        """Remove a track from the mix: it ramps down first, or plays to its end if it was stopped.

        Called by the track's client, which stops using it. A second call changes nothing.
        """
        track.requests.append((Request.REMOVE, track.ring.written))

    def post(self, event: Callable[[], None]) -> None:
        """Have `event` called by the mixer's thread in the next cycle; the dump shows failures."""
        self._events.append(event)

    def cycle(self, now_s: float, frames: int | None = None) -> CycleReport:
        """Do one cycle and report it.

        now_s: seconds of any clock that does not run backwards. frames: length of the cycle, 1 to
        `self.frames` (the default). As long as a tap's buffer, it adds no delay.
        """
        self.cycles += 1
        self._take_events()
        active = self._active_lanes()
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

    def _take_events(self) -> None:
        # only events posted before: an event may post another event
        for _ in range(len(self._events)):
            event = self._events.popleft()
            try:
                event()
            except Exception as failure:  # the sound goes on whatever fails
                self.failed_events += 1
                self.last_failure = f"{type(failure).__name__}: {failure}"

    def _active_lanes(self) -> list[Lane]:
        """Carry out the clients' requests and return the tracks that take part in this cycle."""
        for lane in self._lanes:
            lane.update()
        if any(lane.gone for lane in self._lanes):
            self._lanes = tuple(lane for lane in self._lanes if not lane.gone)
        return [lane for lane in self._lanes if lane.is_active]

    def _stands_by(self, any_active: bool, now_s: float) -> bool:
        """Enter or leave standby and return whether the mixer is in it."""
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
        """Mix each track into the mix or its session's mix; count those mixed and those missed."""
        self._follow_sessions()
        if self.buffer.frames != frames:
            self.buffer.hold(frames)
        scratch = self._scratch[:frames]
        for of_player in self._sessions.values():
            of_player.buffer.hold(frames)
        self.buffer.haptic[...] = 0.0
        self._empty = True
        mixed = underruns = 0
        for lane in active:
            readiness = lane.prepare(frames)
            if readiness is not Readiness.READY:
                underruns += readiness is Readiness.UNDERRUN
                continue
            mixed += 1
            session_mix = self._sessions.get(lane.track.session)
            if session_mix is not None:
                session_mix.add(lane, scratch)
            else:
                lane.mix(self.buffer.audio, scratch, first=self._empty)
                self._empty = False
        return mixed, underruns

    def _follow_sessions(self) -> None:
        """Keep one mix for each player session that has a chain now."""
        self._chains = frozenset(self.effects.sessions())
        players = {session for session in self._chains if session > OUTPUT_MIX}
        if players != self._sessions.keys():
            self._sessions = {
                session: self._sessions.get(session)
                or SessionMix(self.samplerate, self.frames, self.channels, self.haptic_channels)
                for session in sorted(players, reverse=True)
            }

    def _process(self, now_s: float) -> None:
        """Run the players' chains, highest session first, add each to the mix; then the mix's."""
        buffer = self.buffer
        for session, session_mix in self._sessions.items():
            if not session_mix.begin():
                continue
            self.effects.process(session, session_mix.buffer, now_s)
            if self._empty:
                buffer.samples[...] = session_mix.buffer.samples
                self._empty = False
            else:
                buffer.samples += session_mix.buffer.samples
        if self._empty:
            buffer.audio[...] = 0.0
        if self.on_mix is not None:
            self.on_mix(buffer.audio)
        for session in (OUTPUT_MIX, OUTPUT_STAGE, DEVICE):
            if session in self._chains:
                self.effects.process(session, buffer, now_s)


class SessionMix:
    """The mix of one player session, which passes its effects and then joins the whole mix."""

    def __init__(self, samplerate: int, frames: int, channels: int, haptic_channels: int) -> None:
        self.buffer = MixBuffer(frames, channels, haptic_channels)
        self._tail_whole = round(TAIL_S * samplerate)
        self._tail_left = 0
        self._empty = True

    def add(self, lane: Lane, scratch: Float32Array) -> None:
        """Add a track that is ready."""
        lane.mix(self.buffer.audio, scratch, first=self._empty)
        self._empty = False

    def begin(self) -> bool:
        """Prepare the buffer for the effects; return False if their tail is over."""
        self.buffer.haptic[...] = 0.0
        if not self._empty:
            self._empty = True
            self._tail_left = self._tail_whole
            return True
        self.buffer.audio[...] = 0.0
        if self._tail_left <= 0:
            return False
        self._tail_left -= self.buffer.frames
        return True

    def clear(self) -> None:
        """Forget the session's sound and its tail, for standby."""
        self.buffer.clear()
        self._empty = True
        self._tail_left = 0
