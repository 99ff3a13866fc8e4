"""Both engines of a run: the Python one, the native one, and the change between them.

One ends before the other begins. Streams that join or leave PipeWire's graph may cost others a
cycle, so none of them plays meanwhile.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from audioflinger_hook.core.compiled_core import library
from audioflinger_hook.daemon.capture_queue import undone_db
from audioflinger_hook.daemon.endpoints import Endpoints
from audioflinger_hook.daemon.engine import Clocks, Engine
from audioflinger_hook.daemon.engine_switch import EngineSwitch
from audioflinger_hook.daemon.inputs.base import AudioNode
from audioflinger_hook.daemon.live_memory import live_memory
from audioflinger_hook.daemon.outputs.base import StreamOutput
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.daemon.safety_keeper import SafetyKeeper
from audioflinger_hook.daemon.soft_fade import FADE_S
from audioflinger_hook.drive.driven_rig import DrivenRig
from audioflinger_hook.service.state import StateKeeper
from device.drive.safety import SafetyState
from device.server import PulseConnection, ServerSnapshot
from device.stream.callback_thread import priority_advice
from device.units import db_to_amplitude

CHANGE_TICK_S = 0.02
"""Time between ticks during a change of engine."""

PLAYED_S = FADE_S + 0.1
"""From the start of a fade until the device has played its end."""

NATIVE_TICK_S = 0.25
"""Time between ticks while the native engine plays; what it waits for wakes the daemon."""


BEGIN_S = 0.3
"""From the last look at what plays to a new chain's first block."""


class Engines:
    """The engines of one run; one of them plays. For the supervising thread alone.

    config: what to do. endpoints: of the Python engine. states: the daemon's state. folder:
    private, for files of the native engine and of a live page; None: only the Python engine, and no
    such file. on_change: called by another thread when PipeWire's graph changes.

    safety: what the driven rigs must not forget; None: nothing outlives the process.

    volume_db: the listener's volume that is undone, 0 dB for 100 %. python: what the audio threads
    run; None before the first sound, and while the native engine plays. switch: the choice, and the
    native engine.
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
        self._config = config
        self._safety = safety
        self._clocks = clocks
        self._endpoints = endpoints
        self._folder = folder
        self._fades_until_s = 0.0
        self._heard_before_s = 0.0
        self.volume_db = 0.0
        self.python: Engine | None = None
        self._device = ""
        self._ended: dict[tuple[int, int], SafetyState] = {}
        self.switch = EngineSwitch(config, folder, states, on_change, self._restore)

    @property
    def tick_s(self) -> float | None:
        """Longest time until the next tick, None for the usual one."""
        native, engine = self.switch.native, self.python
        if native and (self.switch.reason or native.is_designing):
            return CHANGE_TICK_S
        if engine and not engine.fade.audible:
            return CHANGE_TICK_S
        return NATIVE_TICK_S if native is not None and native.is_steady else None

    @property
    def playing(self) -> tuple[str, str]:
        """The engine that plays, "native", "python" or "", and why it is not the native one.

        "" as well where files alone leave no choice.
        """
        native = self.switch.native
        if not self._endpoints.needs_server:
            return "", ""
        if native is not None and native.audible:
            return "native", ""
        return ("python", self.switch.reason) if self.python else ("", "")

    @property
    def heard_s(self) -> float:
        """Seconds of sound that the Python engine has heard."""
        engine = self.python
        return self._heard_before_s + (engine.frames / engine.samplerate if engine else 0.0)

    @property
    def buffers(self) -> int:
        """A count that rises while sound is processed."""
        readings = self.switch.native and self.switch.native.readings()
        return readings.frames if readings else self.python.buffers if self.python else 0

    @property
    def frames(self) -> int:
        """Frames of sound that the present engine has heard."""
        readings = self.switch.native and self.switch.native.readings()
        return readings.frames if readings else self.python.frames if self.python else 0

    @property
    def limited_samples(self) -> int:
        """Samples of vibration that the present engine has limited at full scale."""
        readings = self.switch.native and self.switch.native.readings()
        if readings:
            return readings.limited_samples
        return self.python.framework.limited_samples if self.python else 0

    @property
    def warnings(self) -> Iterator[str]:
        """Return what the user should know of the native engine."""
        native = self.switch.native
        if native is None:
            return
        if native.monitor_reason:
            yield f"the sink's monitor is tapped, one cycle later: {native.monitor_reason}"
        if native.problem:
            yield native.problem
        if native.lacks_realtime:
            yield priority_advice()

    def record(self, now_s: float) -> None:
        """Record what must not be forgotten, if it is time."""
        for rig in filter(None, self.rigs):
            rig.keep()
        if self._safety is not None:
            self._safety.update(self.rigs, now_s)

    @property
    def rigs(self) -> Sequence[DrivenRig | None]:
        """What the engine that plays drives; () for nothing."""
        native = self.switch.native
        if self.python is None:
            return native.rigs if native is not None else ()
        return self.python.drive.processors

    def _restore(self, rigs: Sequence[DrivenRig | None], first: bool) -> None:
        """Let rigs of a new engine or chain continue where those that play, or on record, ended."""
        if first and self._safety is not None:
            self._safety.restore(rigs, self._device)
        known = _states_of(self.rigs)
        if not known and (self._safety is None or self._safety.warning):
            known = self._ended  # what is not on record has not cooled down for all we know
        for index, rig in enumerate(rigs):
            if rig is not None and known:
                bounds, states = rig.bounds(), list(rig.safety_states())
                for channel in range(rig.channels):
                    if (state := known.get((index, channel))) is not None:
                        states[channel] = bounds.after_unrecorded(state, BEGIN_S)
                rig.restore(states)

    def _note_device(self, device: AudioNode) -> None:
        if device.name != self._device:
            self._device = device.name
            if self._safety is not None:
                self._safety.note_device(device.name)

    @property
    def safety_warning(self) -> str:
        """What is wrong with the record of temperatures and dose, "" for nothing."""
        return self._safety.warning if self._safety else ""

    @property
    def dose_since(self) -> str:
        """Local time since when the dose counts; "" for the start."""
        return self._safety.since if self._safety else ""

    @property
    def _delay_s(self) -> float:
        return max(0.0, self._config.live.offset_s)

    def follow(self, config: RunConfig) -> None:
        """Use another config."""
        self._config = config
        if self.python is not None:
            self.python.mute.audible = not config.muted
        self.switch.follow(config)

    def drop(self) -> None:
        """Forget the Python engine, so that `prepare` makes another one."""
        if self.python is not None:
            self._close_safety()
        self._close_live()
        self._heard_before_s, self.python = self.heard_s, None

    def close(self) -> None:
        """End the native engine, record the end, and remove the file of the live page."""
        self._close_safety()
        self.switch.close()
        self._close_live()

    def _close_safety(self) -> None:
        self._ended = _states_of(self.rigs)
        if self._safety is not None:
            self._safety.close(self.rigs)

    def _close_live(self) -> None:
        if self.python is not None and self.python.live is not None:
            self.python.live.close()

    def native_plays(
        self,
        connection: PulseConnection | None,
        source: AudioNode,
        device: AudioNode,
        now_s: float,
    ) -> bool:
        """Keep the native engine, if it is chosen; return False while the Python engine plays."""
        switch, engine = self.switch, self.python
        seen = connection.latest if connection else None
        self._undo_volume(seen)
        if not switch.takes_native(source, seen) or connection is None:
            if engine is not None:
                engine.fade.audible = True
            return False
        if engine is not None:
            if engine.fade.audible:
                engine.fade.audible, self._fades_until_s = False, now_s + PLAYED_S
            if now_s < self._fades_until_s:
                return True
            self._endpoints.close()
            self.drop()
        self._note_device(device)
        assert isinstance(self._endpoints.output, StreamOutput)
        players = self._endpoints.input.players(connection.latest)
        volume = self._endpoints.output.volume
        switch.maintain(source, device, players, connection, volume, now_s)
        return not switch.reason

    def _undo_volume(self, snapshot: ServerSnapshot | None) -> None:
        """Undo the listener's volume where vibration follows loudness.

        The profile's promise is that a volume changes nothing. Elsewhere it counts as it is heard.
        """
        before_db, self.volume_db = self.volume_db, 0.0
        tap, streams_db, is_felt = self._endpoints.input, 0.0, True
        if snapshot is not None:
            is_felt = not tap.is_muted(snapshot)
            streams_db = tap.monitor_db(snapshot)
            if self._config.settings.parameters.loudness_db > 0.0:
                volume_db = tap.volume_db(snapshot)
                # nothing is heard at 0 %; the largest factor would make what follows a burst
                silent = volume_db == -math.inf
                self.volume_db = before_db if silent else undone_db(volume_db, snapshot.kind)
                streams_db = (
                    -undone_db(volume_db - streams_db, snapshot.kind) if not silent else 0.0
                )
        gain = db_to_amplitude(-self.volume_db) if is_felt else 0.0
        self._endpoints.feed.gain.wanted = self.switch.monitor_gain = gain
        self.switch.streams_gain = db_to_amplitude(streams_db) if is_felt else 0.0

    def native_has_ended(self, now_s: float) -> bool:
        """Let the native engine end softly, if it runs; return whether it has. Repeat it."""
        native = self.switch.native
        if native is None:
            return True
        if not native.fade_out(now_s):
            return False
        if native.rigs:  # none any more once it leaves
            self._close_safety()
        if not native.leave(now_s):
            return False
        self.switch.close()
        return True

    def prepare(self, source: AudioNode, device: AudioNode, now_s: float) -> None:
        """Make the engine for the first source; later sources are converted to the first format."""
        engine = self.python
        self._note_device(device)
        if engine is None:
            recording, feed = self._config.recording, self._endpoints.feed
            on_step, on_mix = None, None
            if recording:
                on_step, on_mix = recording.hooks(
                    source.samplerate, source.channels, of_mix=feed.records_mix
                )
            engine = Engine(
                feed.client(source.samplerate, source.channels),
                device.samplerate or source.samplerate,
                self._config.settings,
                clocks=self._clocks,
                offset_s=self._delay_s,
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
            feed.serve(engine)
            self._endpoints.output.set_format(engine.samplerate, engine.drive.outputs)
        elif not self._endpoints.output.is_open:
            engine.retarget(device.samplerate or engine.samplerate, self._config.live.block_frames)


def _states_of(rigs: Sequence[DrivenRig | None]) -> dict[tuple[int, int], SafetyState]:
    """Return what must not be forgotten, by number of the rig and of its channel."""
    return {
        (index, channel): state
        for index, rig in enumerate(rigs)
        if rig is not None
        for channel, state in enumerate(rig.safety_states())
    }
