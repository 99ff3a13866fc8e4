"""Both engines of a run: the Python one, the native one, and the change between them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path

from audioflinger_hook.daemon.capture_queue import undone_db
from audioflinger_hook.daemon.endpoints import Endpoints
from audioflinger_hook.daemon.engine import Clocks, Engine
from audioflinger_hook.daemon.engine_switch import EngineSwitch
from audioflinger_hook.daemon.handover import Dip, Handover
from audioflinger_hook.daemon.inputs.base import AudioNode
from audioflinger_hook.daemon.live_memory import live_memory
from audioflinger_hook.daemon.outputs.base import StreamOutput
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.service.state import StateKeeper
from device.server import PulseConnection, ServerSnapshot
from device.stream.callback_thread import priority_advice
from device.units import db_to_amplitude

HANDOVER_TICK_S = 0.02
"""Time between ticks during a change of engine."""

NATIVE_TICK_S = 0.25
"""Time between ticks while the native engine plays; what it waits for wakes the daemon."""


class Engines:
    """The engines of one run; one of them plays. For the supervising thread alone.

    config: what to do. endpoints: of the Python engine. states: the daemon's state. folder:
    private, for files of the native engine and of a live page; None: only the Python engine, and no
    such file. on_change: called by another thread when PipeWire's graph changes.

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
    ) -> None:
        self._config = config
        self._clocks = clocks
        self._endpoints = endpoints
        self._folder = folder
        self._handover = Handover()
        self._dip = Dip()
        self._heard_before_s = 0.0
        self.volume_db = 0.0
        self.python: Engine | None = None
        self.switch = EngineSwitch(config, folder, states, on_change)

    @property
    def tick_s(self) -> float | None:
        """Longest time until the next tick, None for the usual one."""
        if self._handover.is_under_way or self._dip.is_under_way:
            return HANDOVER_TICK_S
        native = self.switch.native
        return NATIVE_TICK_S if native is not None and native.is_steady else None

    @property
    def playing(self) -> tuple[str, str]:
        """The engine that plays, "native", "python" or "", and why it is not the native one.

        "" as well where files alone leave no choice.
        """
        native = self.switch.native
        if not self._endpoints.needs_server:
            return "", ""
        if native is not None and (native.audible or self._dip.is_under_way):
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
        if native.lacks_realtime:
            yield priority_advice()

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
        self._close_live()
        self._heard_before_s, self.python = self.heard_s, None
        self._handover.reset()
        self._dip.end()

    def close(self) -> None:
        """End the native engine, and remove the file of the live page."""
        self.switch.close()
        self._close_live()

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
        switch, handover, engine = self.switch, self._handover, self.python
        seen = connection.latest if connection else None
        self._undo_volume(seen)
        if not switch.takes_native(source, seen) or connection is None:
            return False
        self._dip.end()
        assert isinstance(self._endpoints.output, StreamOutput)
        ready = switch.maintain(
            source,
            device,
            self._endpoints.input.players(connection.latest),
            connection,
            self._endpoints.output.volume,
            now_s,
            linked=engine is None,
        )
        if engine is None:
            return not switch.reason
        if not ready:
            return False
        if handover.fade_out(engine.fade, now_s):
            self._endpoints.close()
            self.drop()
        return True

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

    def may_open(self, now_s: float) -> bool:
        """Return whether streams of the Python engine may open.

        Each stream that joins the graph may cost the native engine a cycle, so it must be silent.
        """
        native = self.switch.native
        if native is None or not (native.audible or self._dip.is_under_way):
            return True
        if self.python is None:
            self._dip.begin(now_s)
            return native.fade_out(now_s)
        if self._dip.is_over(now_s):
            self._dip.end()
            native.fade_in()
        return True

    def end_native(self, now_s: float) -> None:
        """End a native engine that is not chosen any more, once the Python engine plays evenly."""
        engine = self.python
        self._dip.note_open(now_s)
        if (
            not self.switch.reason
            or engine is None
            or not (self.switch.native or self._handover.is_under_way)
        ):
            return
        if engine.delay_line.status.delay_s <= 0.0 or not self._handover.has_settled(now_s):
            return
        if not self.switch.leave(now_s):
            return
        if self._handover.fade_in(engine.fade, now_s):
            self._handover.reset()
            self.switch.close()

    def prepare(self, source: AudioNode, device: AudioNode, now_s: float) -> None:
        """Make the engine for the first source; later sources are converted to the first format."""
        engine = self.python
        if engine is None:
            silent = self._dip.is_under_way
            if silent:
                self._handover.begin_silent(now_s)
            recording, feed = self._config.recording, self._endpoints.feed
            on_step, on_mix = None, None
            if recording:
                on_step, on_mix = recording.hooks(
                    source.samplerate, source.channels, of_mix=feed.records_mix
                )
            engine = self.python = Engine(
                feed.client(source.samplerate, source.channels),
                device.samplerate or source.samplerate,
                self._config.settings,
                clocks=self._clocks,
                offset_s=self._delay_s,
                block_frames=self._config.live.block_frames,
                now_s=now_s,
                bypass_late=self._endpoints.input.needs_server,
                silent=silent,
                on_step=on_step,
                on_mix=on_mix,
            )
            actuators = len(engine.driven_meters)
            engine.live = live_memory(self._folder, engine.samplerate, engine.channels, actuators)
            engine.mute.audible = not self._config.muted
            feed.serve(engine)
            self._endpoints.output.set_format(engine.samplerate, engine.drive.outputs)
        elif not self._endpoints.output.is_open:
            engine.retarget(device.samplerate or engine.samplerate, self._config.live.block_frames)
