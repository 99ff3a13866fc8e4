"""Chooses the native or the Python engine, at the start and after a change of config or server.

One engine ends before the other begins.
"""

import math
from collections.abc import Callable, Iterator, Sequence, Set
from pathlib import Path

from audioflinger_hook.core.compiled_core import library
from audioflinger_hook.daemon.capture_queue import undone_db
from audioflinger_hook.daemon.endpoints import Endpoints
from audioflinger_hook.daemon.engine import Clocks, Engine
from audioflinger_hook.daemon.inputs.base import AudioNode
from audioflinger_hook.daemon.live_memory import live_memory
from audioflinger_hook.daemon.native.abilities import why_not_tap, why_python
from audioflinger_hook.daemon.native.run import NativeRun
from audioflinger_hook.daemon.outputs.base import StreamOutput
from audioflinger_hook.daemon.run_config import SLIGHT, Change, RunConfig
from audioflinger_hook.daemon.safety_keeper import SafetyKeeper
from audioflinger_hook.drive.drive import DrivenRig
from audioflinger_hook.pipeline.framework import Framework, drive_of
from audioflinger_hook.service.state import StateKeeper
from device.server import PulseConnection, ServerSnapshot
from device.stream.callback_thread import priority_advice
from device.units import db_to_amplitude

CHANGE_TICK_S = 0.02  # longest time between ticks during a change of engine
PLAYED_S = 0.1  # wait after a fade, in which the device plays the end of the fade
FADE_MAX_S = 0.5  # longest wait for a fade
NATIVE_TICK_S = 0.25  # longest time between ticks while the native engine plays


class Engines:
    """The engines of one run. At most one engine plays.

    folder: private, for the native engine and the live page's shared memory; None disables both.
    safety: stores the coil temperatures and vibration doses for the next process.
    volume_db: volume that the engine compensates, in dB relative to 100 %.
    python: the Python engine, or None. reason: why the Python engine is chosen, or "".
    """

    def __init__(
        self,
        config: RunConfig,
        clocks: Clocks,
        endpoints: Endpoints,
        states: StateKeeper,
        folder: Path | None,
        on_change: Callable[[], None],
        safety: SafetyKeeper | None,
    ) -> None:
        library()
        self._config, self._folder = config, folder
        self._clocks, self._endpoints = clocks, endpoints
        self.safety = safety or SafetyKeeper()
        self._ends_s: float | None = None
        self._follows_native = False
        self._chosen_for: tuple[object, ...] = ()
        self._streams_gain, self._offset_s = 1.0, 0.0
        self._played_s = self._heard_before_s = self.volume_db = 0.0
        self.python: Engine | None = None
        self.native = NativeRun(config, folder, states, on_change, self._restore)
        self.reason = "nothing has played yet"

    @property
    def tick_s(self) -> float | None:
        """Longest time until the next tick in seconds, None for the supervisor's default."""
        native = self.native.engine
        if self._ends_s is not None or (native and (self.reason or native.designs.is_busy)):
            return CHANGE_TICK_S
        return NATIVE_TICK_S if native is not None and native.is_steady else None

    @property
    def playing(self) -> tuple[str, str]:
        """Name of the engine that plays ("native", "python" or ""), and why it is not "native"."""
        native = self.native.engine
        if not self._endpoints.needs_server:
            return "", ""
        if native is not None and native.audible:
            return "native", ""
        return ("python", self.reason) if self.python and self.reason else ("", "")

    @property
    def heard_s(self) -> float:
        """Seconds of sound that all Python engines of the run have processed."""
        engine = self.python
        return self._heard_before_s + (engine.frames / engine.samplerate if engine else 0.0)

    @property
    def counts(self) -> tuple[int, int]:
        """Numbers of samples limited and of frames processed by the present engine."""
        native, python = self.native.engine, self.python
        if native is not None and native.chain is not None:
            return native.chain.page.readings.limited, native.chain.page.frames
        return (python.framework.limited_samples, python.frames) if python else (0, 0)

    @property
    def warnings(self) -> Iterator[str]:
        """Messages for the user about the native engine."""
        native = self.native.engine
        if native is None:
            return
        if native.monitor_reason:
            yield f"the sink's monitor is tapped, one cycle later: {native.monitor_reason}"
        if native.chains.problem:
            yield native.chains.problem
        current = native.chains.current
        if current and current.has_realtime is False and self._config.live.realtime:
            yield priority_advice()

    def record(self, now_s: float) -> None:
        """Record coil temperatures and vibration doses, at most once per `safety_keeper.SAVE_S`."""
        for rig in filter(None, self.rigs):
            rig.keep(now_s, self._clocks.slept_s())
        self.safety.update(self.rigs, now_s)

    @property
    def rigs(self) -> Sequence[DrivenRig | None]:
        """The rigs that the present engine drives; () without an engine."""
        native = self.native.engine
        if self.python is not None:
            return self.python.drive.processors
        return native.chain.design.rigs if native is not None and native.chain is not None else ()

    def _restore(self, rigs: Sequence[DrivenRig | None], first: bool) -> None:
        """Give new rigs the recorded states (only if `first`), then the playing rigs' states."""
        if first:
            self.safety.restore(rigs)
        self.safety.carry_over(self.rigs, rigs)

    def follow(self, config: RunConfig, changes: Set[Change]) -> None:
        """Apply a config with these `changes`. After a UsageError, nothing has changed."""
        settings, engine = config.settings, self.python
        if engine and Change.ENGINE in changes:  # raises if the new engine is impossible
            framework = Framework(engine.samplerate, engine.channels, settings)
            drive_of(settings, engine.samplerate, framework.haptic_channels)
        elif engine:
            engine.follow(settings)
        self._config = config
        if changes - SLIGHT:
            self._chosen_for = ()
        if self.python is not None and self._ends_s is None:
            self.python.mute.audible = not config.muted
        self.native.follow(config)

    def set_offset(self, offset_s: float) -> None:
        """Set the delay of the vibration in seconds, for the present engine and later ones."""
        self._offset_s = offset_s
        if self.python is not None:
            self.python.delay_line.offset_s = offset_s
        self.native.set_offset(offset_s)

    def drop(self) -> None:
        """Record the rigs' state and remove the Python engine; `prepare` creates a new engine."""
        if self.python is not None:
            self.safety.close(self.rigs)
        self._close_live()
        self._heard_before_s, self.python = self.heard_s, None

    def close(self) -> None:
        """Record the rigs' state, end the native engine, and remove the live page's file."""
        self.safety.close(self.rigs)
        self.native.close()
        self._close_live()

    def _close_live(self) -> None:
        if self.python is not None and self.python.live is not None:
            self.python.live.close()

    def maintain(
        self, connection: PulseConnection | None, source: AudioNode, device: AudioNode, now_s: float
    ) -> bool:
        """Choose an engine and end the other; return whether the Python engine must not play."""
        self._undo_volume(connection.latest if connection else None)
        self._choose(connection, source)
        if not self._other_has_ended(now_s):
            return True
        if self.reason or connection is None:
            return False
        self.safety.note_device(device.name)
        output = self._endpoints.output
        assert isinstance(output, StreamOutput)
        players = self._endpoints.input.players(connection.latest)
        gains = self._streams_gain, self._endpoints.feed.gain.wanted
        self.native.maintain(source, device, players, connection, output.volume, gains, now_s)
        self.reason = self.native.problem
        return True

    def _choose(self, connection: PulseConnection | None, source: AudioNode) -> None:
        too_many = why_not_tap(source.channels)
        if self._chosen_for == (connection, too_many):
            return
        self._chosen_for = connection, too_many
        self.native.begin()
        seen = connection.latest if connection and self._folder else None
        self.reason = why_python(self._config, seen) or too_many
        if self.python is not None:
            self._ends_s, self.python.mute.audible = None, not self._config.muted

    def _other_has_ended(self, now_s: float) -> bool:
        """Fade out and end the engine that is not chosen; return whether it has ended."""
        native = self.native.engine
        if self.python is not None and not self.reason:
            if self._ends_s is None:
                self.python.mute.audible, self._ends_s = False, now_s + FADE_MAX_S
            fades = self.python.mute.position > 0.0 and self._endpoints.output.is_open
            if fades and now_s < self._ends_s:
                self._played_s = now_s + PLAYED_S
            if now_s < self._played_s:
                return False
            self._endpoints.close()
            self.drop()
        elif native is not None and self.reason:
            if not native.fade_out(now_s):
                return False
            if native.chain is not None:  # `leave` removes the chain
                self.safety.close(self.rigs)
            if not native.leave(now_s):
                return False
            self.native.close()
            self._follows_native = True
        self._ends_s = None
        return True

    def _undo_volume(self, snapshot: ServerSnapshot | None) -> None:
        """Mute vibration of muted sound. With loudness control, compensate the sound's volume."""
        before_db, self.volume_db = self.volume_db, 0.0
        tap, streams_db, is_felt = self._endpoints.input, 0.0, True
        if snapshot is not None:
            is_felt = not tap.is_muted(snapshot)
            streams_db = tap.monitor_db(snapshot)
            if self._config.settings.parameters.loudness_db > 0.0:
                native = self.native.engine
                taps_streams = native is not None and not native.monitor_reason
                left_out = self._config.left_out if taps_streams else None
                volume_db = tap.volume_db(snapshot, left_out)
                # At 0 %, keep the gain. The largest gain would turn the next sound into a burst.
                silent = volume_db == -math.inf
                self.volume_db = before_db if silent else undone_db(volume_db, snapshot.kind)
                streams_db = 0.0 if silent else -undone_db(volume_db - streams_db, snapshot.kind)
        self._endpoints.feed.gain.wanted = db_to_amplitude(-self.volume_db) if is_felt else 0.0
        self._streams_gain = db_to_amplitude(streams_db) if is_felt else 0.0

    def prepare(self, source: AudioNode, device: AudioNode, now_s: float) -> None:
        """Create the Python engine, or adapt it to the device's rate before the output opens."""
        engine = self.python
        self.safety.note_device(device.name)
        if engine is None:
            recording, feed = self._config.recording, self._endpoints.feed
            form, on_step, on_mix = (source.samplerate, source.channels), None, None
            if recording:
                on_step, on_mix = recording.hooks(*form, of_mix=feed.records_mix)
            engine = Engine(
                feed.client(*form),
                device.samplerate or source.samplerate,
                self._config.settings,
                clocks=self._clocks,
                offset_s=self._offset_s,
                block_frames=self._config.live.block_frames,
                now_s=now_s,
                bypass_late=self._endpoints.input.needs_server,
                on_step=on_step,
                on_mix=on_mix,
            )
            self._restore(engine.drive.processors, True)
            self.python = engine
            actuators = len(engine.driven_meters)
            engine.live = live_memory(self._folder, engine.samplerate, engine.channels, actuators)
            engine.mute.audible = not self._config.muted
            if self._follows_native:  # the sound already plays, so a fade-in avoids a click
                engine.mute.position, self._follows_native = 0.0, False
            feed.serve(engine)
            self._endpoints.output.set_format(engine.samplerate, engine.drive.outputs)
        elif not self._endpoints.output.is_open:
            engine.retarget(device.samplerate or engine.samplerate, self._config.live.block_frames)
