"""Plays trials of `cushion fit` and `cushion study`: one stream, so one clock has both signals.

The stream plays to a null sink of ours. PipeWire's graph carries its sound to the heard sink, and
its vibration to the chain, which then has no transform and taps nothing else. Gain, delay, damping,
protection and exposure of the chain apply to it as to any vibration.
"""

import math
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from audioflinger_hook.daemon.alignment import Alignment
from audioflinger_hook.daemon.engines import Engines
from audioflinger_hook.daemon.latency import parts_of_native
from audioflinger_hook.daemon.native.chain import NAME
from audioflinger_hook.daemon.native.taps import TrialEnds
from audioflinger_hook.daemon.timing import Backoff
from audioflinger_hook.daemon.trial_sound import CHANNELS, RATE_HZ, TrialMeter, TrialSound
from audioflinger_hook.service.state import DaemonState, StateKeeper
from device.errors import LostError, NotFoundError
from device.server import PulseConnection
from device.server.guard import StreamGuard
from device.stream.pcms import Pcm, ServerDevice
from device.stream.streams import PlaybackStream
from device.units import Float32Array

BLOCK_FRAMES = 2_048
BEGINS_S = 2.0  # a trial that has not begun by then is lost
POLL_S = 0.01
LOST_S = 0.3  # from a loss to the answer; the sound fades out meanwhile
AFTER_S = 0.1  # from the last frame at the device to the answer, in which levels are read

Ends = Callable[[float], bool]  # waits up to the given seconds; whether the asker ends the trial


class Trials:
    """Plays one trial at a time while a client has a session open.

    `maintain` and `close` are for the main thread, the other methods for the client's thread.
    pcm: plays the stream. folder: has the files of trials. now_s: returns time.monotonic().
    ring: wakes the main thread.
    """

    def __init__(
        self,
        pcm: Pcm | None,
        folder: Path | None,
        engines: Engines,
        alignment: Alignment,
        states: StateKeeper,
        now_s: Callable[[], float],
        ring: Callable[[], None],
    ) -> None:
        self._pcm, self._folder = pcm, folder
        self._engines, self._alignment = engines, alignment
        self._states, self._now_s, self._ring = states, now_s, ring
        self._session = threading.Lock()
        self._backoff = Backoff()
        self._stream: PlaybackStream | None = None
        self._guard: StreamGuard | None = None
        self._playing: TrialSound | None = None
        self._problem = ""

    def maintain(
        self, connection: PulseConnection | None, heard: str, felt: str, now_s: float
    ) -> None:
        """Follow the session: open or close the stream. heard, felt: names of both sinks."""
        self._problem = self._engines.reason and (
            f"trials need the native engine, which does not play: {self._engines.reason}"
        )
        if not self._problem and heard in ("", felt):
            self._problem = f"the sound would go to {heard or 'no sink'}; choose another output"
        wants = self._session.locked() and connection is not None and not self._problem
        ends = TrialEnds(f"{NAME}-{id(self):x}-trials", heard)
        self._engines.native.set_trial(ends if wants else None)
        if self._stream is not None and (not wants or self._stream.is_lost(now_s)):
            self.close()
        if wants and self._stream is None and self._backoff.wait_s(now_s) <= 0.0:
            assert connection is not None
            self._open(connection, ends.sink, now_s)

    def _open(self, connection: PulseConnection, sink: str, now_s: float) -> None:
        if self._pcm is None or connection.latest.sink(sink) is None:
            return
        self._pcm.target = ServerDevice(sink)
        try:
            self._stream = PlaybackStream(
                self._pcm, RATE_HZ, CHANNELS, self._fill, block_frames=BLOCK_FRAMES
            )
            self._guard = StreamGuard(connection, self._stream, sink)
            self._backoff.succeeded()
        except (LostError, NotFoundError) as error:
            self._problem = str(error)
            self._backoff.failed(now_s)

    def close(self) -> None:
        """Close the stream, if it is open."""
        stream, guard, self._stream, self._guard = self._stream, self._guard, None, None
        if guard is not None:
            guard.release()
        if stream is not None:
            stream.close()

    def begin(self) -> bool:
        """Open a session, in which the tap is not felt; return whether no other client has one."""
        begins = self._session.acquire(blocking=False)
        self._ring()
        return begins

    def end(self) -> None:
        """End the session. The tap is felt again."""
        self._session.release()
        self._ring()

    def why_not(self) -> str:
        """Return why no trial can be played now, or ""."""
        state, native, stream = self._states.report(0.0), self._engines.native.engine, self._stream
        if state.state not in (DaemonState.RUNNING, DaemonState.IDLE):
            return f"{state.state.value}: {state.reason}" if state.reason else state.state.value
        if self._problem or self._engines.muted:
            return self._problem or "the vibration is muted; switch it on in the live page"
        if native is None or stream is None or not (native.plays_trials and stream.audible):
            return "the daemon prepares trials"
        return ""

    def play(self, name: str, ends: Ends) -> dict[str, Any]:
        """Play a file of the folder; return the answer for the client.

        UsageError: the file cannot be played.
        """
        if self._folder is None:
            return {"lost": "the daemon has no folder of its own"}
        frames, native = TrialSound.read(self._folder / name), self._engines.native.engine
        chain = native.chain if native is not None else None
        lost = self.why_not()
        if lost or native is None or chain is None:
            return {"lost": lost or "the native engine has ended"}
        own_s = 1e-3 * sum(parts_of_native(native, chain).values())
        transform_s = chain.plan.transform.latency_frames / chain.plan.samplerate
        lead_s = self._alignment.offset.lead_s(own_s, transform_s)
        path_s = own_s + self._alignment.offset.vibration_s + self._alignment.felt_s
        meter, stopped = TrialMeter(chain), False
        pause = threading.Event()
        sound = self._playing = TrialSound(frames, lead_s)
        asked_s, lost_blocks = self._now_s(), self._lost_blocks()
        until_s = math.inf
        while not sound.is_over((now_s := self._now_s()) - path_s - AFTER_S) and now_s < until_s:
            if sound.stops:
                pause.wait(POLL_S)
            elif ends(POLL_S):
                stopped = sound.stops = True
            lost = lost or self.why_not()
            if native.chain is not chain:
                lost = lost or "the native engine was replaced"
            if self._lost_blocks() != lost_blocks:
                lost = lost or "a block came too late; close other programs"
            if sound.began_s is None and now_s > asked_s + BEGINS_S:
                lost = lost or "the stream of the trial stands still"
            if lost and until_s == math.inf:
                sound.stops, until_s = True, now_s + LOST_S
            meter.look()
        self._playing = None
        if lost or sound.began_s is None:
            return {"lost": lost}
        return {
            "began_s": sound.began_s + max(0.0, lead_s) + path_s,
            "stopped": stopped,
            **meter.result(sound.played / RATE_HZ - abs(lead_s)),
        }

    def _lost_blocks(self) -> int:
        stream = self._stream
        return stream.xruns + stream.silenced + stream.errors.total() if stream else -1

    def _fill(self, out: Float32Array, now_s: float) -> None:
        sound, stream = self._playing, self._stream
        if sound is not None and stream is not None:
            sound.fill(out, now_s + stream.delay_s)
