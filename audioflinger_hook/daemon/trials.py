"""Plays trials of `cushion fit` and `cushion study`: one stream, so one clock has both signals.

The stream plays to a null sink of ours. PipeWire's graph carries its sound to the heard sink, and
its vibration to the chain, which then has no transform and taps nothing else. Gain, delay, damping,
protection and exposure of the chain apply to it as to any vibration.

A client has the trials while it renews its lease by requests {"trial": {"who": ID}} of
`live_control`, with one of these entries or none:

    "play": "trial.npy"     play a file of the daemon's folder; see `trial_sound`
    "stop": true            end the trial that plays with a fade
    "end": true             end the lease as well

The answer has "why", why no trial can be played now, or "", and "played": what was played, or
{"lost": text}; null before the end of a trial. Without a renewal, a trial ends with a fade.
"""

import math
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from audioflinger_hook.daemon.alignment import Alignment
from audioflinger_hook.daemon.engines import Engines
from audioflinger_hook.daemon.inputs.base import AudioNode
from audioflinger_hook.daemon.latency import parts_of_native
from audioflinger_hook.daemon.native.chain import NAME
from audioflinger_hook.daemon.native.taps import TrialEnds
from audioflinger_hook.daemon.timing import Backoff
from audioflinger_hook.daemon.trial_sound import CHANNELS, RATE_HZ, TrialMeter, TrialSound
from audioflinger_hook.service.state import DaemonState, StateKeeper
from device.errors import LostError, NotFoundError, UsageError
from device.server import PulseConnection
from device.server.guard import StreamGuard
from device.server.snapshot import Source
from device.stream.pcms import Pcm, ServerDevice
from device.stream.streams import PlaybackStream
from device.units import Float32Array

LEASE_S = 1.0
BLOCK_FRAMES = 2_048
BEGINS_S = 2.0  # a trial that has not begun by then is lost
POLL_S = 0.01
LOST_S = 0.3  # from a loss to the answer; the sound fades out meanwhile
AFTER_S = 0.1  # from the last frame at the device to the answer, in which levels are read


class Trials:
    """Plays one trial at a time for the client that has the lease.

    `maintain` and `close` are for the main thread, `ask` for any thread. pcm: plays the stream.
    folder: has the files of trials. now_s: returns time.monotonic(). ring: wakes the main thread.
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
        self._lock, self._backoff = threading.Lock(), Backoff()
        self._who, self._until_s, self._problem = "", -math.inf, ""
        self._stream: PlaybackStream | None = None
        self._guard: StreamGuard | None = None
        self._playing: TrialSound | None = None
        self._played: dict[str, Any] | None = None

    def maintain(
        self,
        connection: PulseConnection | None,
        source: AudioNode | None,
        device: AudioNode | None,
        now_s: float,
        *,
        muted: bool,
    ) -> None:
        """Follow the lease: open or close the stream. muted: whether the user mutes vibration."""
        heard = source.monitor_of if isinstance(source, Source) else None
        heard = heard or (connection.latest.default_sink if connection else None) or ""
        self._problem = "the vibration is muted; switch it on in the live page" if muted else ""
        if reason := self._engines.reason:
            self._problem = f"trials need the native engine, which does not play: {reason}"
        elif heard in ("", device.name if device else ""):
            self._problem = f"the sound would go to {heard or 'no sink'}; choose another output"
        ends = TrialEnds(f"{NAME}-{id(self):x}-trials", heard)
        wants = self._playing is not None or (now_s < self._until_s and not self._problem)
        self._engines.native.set_trial(ends if wants and connection else None)
        if self._stream is not None and (not wants or self._stream.is_lost(now_s)):
            self.close()
        if not wants or connection is None or self._stream is not None or self._pcm is None:
            return
        if self._backoff.wait_s(now_s) > 0.0 or connection.latest.sink(ends.sink) is None:
            return
        self._pcm.target = ServerDevice(ends.sink)
        try:
            self._stream = PlaybackStream(
                self._pcm, RATE_HZ, CHANNELS, self._fill, block_frames=BLOCK_FRAMES
            )
            self._guard = StreamGuard(connection, self._stream, ends.sink)
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

    def ask(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        """Carry out a client's request; return the answer.

        UsageError: another client has the lease, or the file cannot be played.
        """
        with self._lock:
            now_s, who = self._now_s(), str(asked.get("who"))
            had_lease, ends = now_s < self._until_s, bool(asked.get("end"))
            if had_lease and who != self._who:
                raise UsageError("another program plays trials; end it first")
            self._played = self._played if who == self._who else None
            self._who, self._until_s = who, -math.inf if ends else now_s + LEASE_S
            if not had_lease or ends:
                self._ring()
            sound = self._playing
            if sound is not None and (ends or asked.get("stop")):
                sound.stops = True
            if name := asked.get("play"):
                self._played = {"lost": "the trial before still ends"} if sound else None
                if not sound:
                    self._begin(Path(str(name)).name)
            return {"why": self._why_not(), "played": self._played}

    def _why_not(self) -> str:
        """Return why no trial can be played now, or ""."""
        state, native, stream = self._states.report(0.0), self._engines.native.engine, self._stream
        if state.state not in (DaemonState.RUNNING, DaemonState.IDLE):
            return f"{state.state.value}: {state.reason}" if state.reason else state.state.value
        is_ready = native and native.plays_trials and stream and stream.audible
        return self._problem or ("" if is_ready else "the daemon prepares trials")

    def _begin(self, name: str) -> None:
        """Begin a file of the folder. UsageError: it cannot be played."""
        native, lost = self._engines.native.engine, self._why_not()
        chain = native.chain if native is not None else None
        if lost or native is None or chain is None or self._folder is None:
            self._played = {"lost": lost or "the native engine has ended"}
            return
        own_s = 1e-3 * sum(parts_of_native(native, chain).values())
        offset = self._alignment.offset
        transform_s = chain.plan.transform.latency_frames / chain.plan.samplerate
        lead_s = offset.lead_s(own_s, transform_s)
        path_s = own_s + offset.vibration_s + self._alignment.felt_s
        sound, meter = TrialSound(self._folder / name, lead_s), TrialMeter(chain)

        def why_lost() -> str:
            if native.chain is not chain:
                return "the native engine was replaced"
            if self._lost_blocks() != lost_blocks:
                return "a block came too late; close other programs"
            is_late = math.isinf(sound.began_s) and self._now_s() > asked_s + BEGINS_S
            return self._why_not() or "the stream of the trial stands still" * is_late

        def play() -> None:
            pause, until_s, lost = threading.Event().wait, math.inf, ""
            while (now_s := self._now_s()) < min(until_s, sound.ends_s + path_s + AFTER_S):
                sound.stops |= now_s > self._until_s
                if lost := lost or why_lost():
                    sound.stops, until_s = True, min(until_s, now_s + LOST_S)
                meter.look()
                pause(POLL_S)
            stopped, seconds = sound.stops, sound.played / RATE_HZ - abs(lead_s)
            began_s = sound.began_s + max(0.0, lead_s) + path_s
            result = {"began_s": began_s, "stopped": stopped, **meter.result(seconds)}
            self._playing, self._played = None, {"lost": lost} if lost else result

        asked_s, lost_blocks, self._playing = self._now_s(), self._lost_blocks(), sound
        threading.Thread(target=play, name="trial", daemon=True).start()

    def _lost_blocks(self) -> int:
        stream = self._stream
        return stream.xruns + stream.silenced + stream.errors.total() if stream else -1

    def _fill(self, out: Float32Array, now_s: float) -> None:
        sound, stream = self._playing, self._stream
        if sound is not None and stream is not None:
            sound.fill(out, now_s + stream.delay_s)
