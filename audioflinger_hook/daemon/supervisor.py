"""The main thread of the daemon: opens streams, watches them, and closes them while idle."""

import random
from contextlib import closing
from pathlib import Path

from audioflinger_hook.daemon import applications as apps
from audioflinger_hook.daemon.alignment import Alignment
from audioflinger_hook.daemon.endpoints import Endpoints
from audioflinger_hook.daemon.engine import Clocks
from audioflinger_hook.daemon.engines import Engines
from audioflinger_hook.daemon.inputs.base import AudioNode, Input
from audioflinger_hook.daemon.limit_advice import LimitAdvice
from audioflinger_hook.daemon.native.abilities import check_engine
from audioflinger_hook.daemon.offset_store import OffsetStore
from audioflinger_hook.daemon.outputs.base import Output
from audioflinger_hook.daemon.run_config import Change, RunConfig, changes_between
from audioflinger_hook.daemon.safety_keeper import SafetyKeeper
from audioflinger_hook.daemon.server_link import DropInControl, ServerLink
from audioflinger_hook.daemon.timing import IdlePolicy, StallDetector, Wake
from audioflinger_hook.service.state import Cause, DaemonState, StateKeeper
from audioflinger_hook.service.status import Application
from device.errors import CushionError, LostError, NotFoundError, UsageError
from device.server import PulseConnection, ServerSnapshot
from device.server.snapshot import Source, tap_latency_s
from device.stream import AudioPriority

# Longest time between ticks while streams are open: another one each time, as queries of a sink's
# latency must not keep step with its buffer.
TICKS_S = (0.075, 0.11)
RESTING_TICK_S = 1.0  # longest time between ticks while idle


class Supervisor:
    """One daemon: a tap, an engine and a device.

    One thread calls `tick` when `wake` rings, and at least every `rest_s` seconds. The daemon waits
    until a lost server or device is available again. If a file cannot be read or written, the
    daemon ends.

    clocks: `now_s` is time.monotonic() or a replacement. wake: other threads ring it.
    folder: private, for the native engine and the live page's shared memory; None disables both.
    safety: stores the coil temperatures and vibration doses for the next process.
    offsets: stores the delays that users have measured; None forgets them at the end.
    config, user_config: with and without the [[application]] rule that acts.
    alignment: finds the offset. config_error: why the latest config was not applied, or "".
    UsageError, NotFoundError: a file to play or to write cannot be used.
    """

    def __init__(
        self,
        config: RunConfig,
        clocks: Clocks,
        wake: Wake,
        folder: Path | None = None,
        safety: SafetyKeeper | None = None,
        offsets: OffsetStore | None = None,
    ) -> None:
        now_s = clocks.now_s()
        self.states = StateKeeper(now_s)
        self.config, self.config_error, self._rule_error = config, "", ""
        self.user_config, self._acting = config, apps.ActingRule()
        self._folder = folder
        self.priority = AudioPriority(config.live.realtime)
        self._endpoints = Endpoints(config, clocks, self.states, self.priority, wake.ring)
        self._drop_in = DropInControl(config)
        self._link = ServerLink(wake.ring)
        self._found: tuple[AudioNode | None, AudioNode | None] = (None, None)
        self.engines = Engines(
            config, clocks, self._endpoints, self.states, folder, wake.ring, safety
        )
        self._idle = IdlePolicy(now_s)
        self.alignment = Alignment(
            config, self.engines, self._drop_in, offsets or OffsetStore(), wake.ring
        )
        self._stalls = StallDetector(self.states, clocks.slept_s)
        self._limits = LimitAdvice()

    @property
    def input(self) -> Input:
        """The source of the sound."""
        return self._endpoints.input

    @property
    def output(self) -> Output:
        """The destination of the vibration."""
        return self._endpoints.output

    @property
    def rest_s(self) -> float:
        """Longest time until the next tick in seconds, unless `wake` rings."""
        if self.states.state is DaemonState.IDLE:
            return RESTING_TICK_S
        return self.engines.tick_s or random.uniform(*TICKS_S)

    def played_s(self, now_s: float) -> float:
        """Return the length of the run in seconds.

        If neither tap nor device is live, this is the duration of the processed sound. Otherwise,
        it is the time since tap and device were first available.
        """
        if not (self.config.tap_is_live or self.config.device_is_live):
            return self.engines.heard_s
        return 0.0 if self.states.ready_s is None else now_s - self.states.ready_s

    @property
    def endpoints(self) -> tuple[tuple[str, str | None], tuple[str, str | None]]:
        """Address and name of tap and device; a name is None while its node is unavailable."""
        source, sink = self._found
        return (
            (str(self.input), source.name if source else None),
            (str(self.output), sink.name if sink else None),
        )

    @property
    def server(self) -> str:
        """Name and version of the sound server, "" without a server."""
        seen = self._link.latest
        return f"{seen.kind} {seen.version}" if seen else ""

    @property
    def applications(self) -> tuple[Application, ...]:
        """The applications that have a stream. Any thread may read this."""
        source, device = self._found
        haptic = device.name if device and self.output.needs_server else None
        seen, acting = self._link.latest, self._acting.rule
        return apps.applications_in(
            seen, self.config, source, haptic, acting, is_mixed=self.is_mixed
        )

    @property
    def is_mixed(self) -> bool:
        """Whether the mixed sound is tapped, so that no stream can be left out. For any thread."""
        native = self.engines.native.engine
        if native is not None and native.audible:
            return bool(native.monitor_reason)
        return self.engines.playing[0] == "python" and self.config.rules is None

    @property
    def rule(self) -> str:
        """The pattern of the [[application]] rule that acts, "" without one."""
        acting = self._acting.rule
        return acting.match if acting else ""

    @property
    def latencies_s(self) -> tuple[float, float]:
        """Latencies of tap and output with the Python engine, in seconds."""
        (source, device), seen, tap_s = self._found, self._link.latest, 0.0
        if source is None or device is None:
            return 0.0, 0.0
        if seen and self.input.needs_server:
            tap_s = tap_latency_s(seen, self.config.live.block_frames, source.samplerate)
        return tap_s, self.output.delay_s(seen)

    @property
    def warnings(self) -> list[str]:
        """Problems to show the user, one line each."""
        engine, recording = self.engines.python, self.config.recording
        warnings = list(engine.framework.warnings) if engine else []
        for part in (self._drop_in, self.input, self.output):
            warnings += part.warnings
        if recording:
            warnings += recording.warnings
            if engine and engine.framework.bypassed():
                warnings.append("an effect was bypassed, so a replay will differ from it")
        warnings += self.alignment.warnings
        others = [self._link.warning, self.priority.warning, self.config_error, self._rule_error]
        others += [self.engines.safety.warning, *self.engines.warnings]
        others.append(apps.not_left_out(self.applications))
        others.append(self._limits.advice(self.config.settings))
        return [*warnings, *filter(None, others)]

    def look(self) -> None:
        """Check tap, device and engine, and set the device's volume.

        LostError, NotFoundError: a check failed, or the volume cannot be set.
        """
        if not self.output.needs_server:
            self.output.locate(None)
            self.output.set_volume(None)
        if not self._endpoints.needs_server:
            return
        with closing(PulseConnection()) as connection:
            self._locate_tap(connection.latest, self.output.locate(connection.latest))
            check_engine(self.config, connection.latest if self._folder else None)
            if self.output.needs_server:
                self.output.set_volume(connection)

    def tick(self, now_s: float) -> None:
        """Connect to the server, locate tap and device, and open, check or close their streams."""
        self._notice_pauses(now_s)
        self.engines.record(now_s)
        self._limits.update(*self.engines.counts, now_s)
        connection = None
        try:
            if self._endpoints.needs_server:
                connection = self._connected(now_s)
                if connection is None:
                    return
            snapshot = connection.latest if connection else None
            device = self._locate_device(snapshot, now_s)
            if device is None:
                return
            haptic = device.name if self.output.needs_server else None
            self._found = (None, device)
            source = self._locate_tap(snapshot, device)
            self._found = (source, device)
            tapped = source.monitor_of if isinstance(source, Source) else None
            if self._acting.update(snapshot, self.user_config, haptic, tapped):
                self._use_rule(now_s)
            if connection:
                self._drop_in.maintain(connection, haptic, now_s)
            runs = self.states.state is DaemonState.RUNNING
            self.alignment.maintain(connection, source, device, self.latencies_s, now_s, runs=runs)
        except LostError as error:
            self._lose_server(now_s, str(error))
            return
        except NotFoundError as error:
            self.input.close()
            self.priority.restore()
            self.engines.native.lose_links(Cause.TAP_LOST, now_s, str(error))
            self._idle.wake(now_s)
            self.states.enter(DaemonState.WAITING_FOR_SOUND_SOURCE, now_s, str(error))
            return
        if self.engines.maintain(connection, source, device, now_s):
            return
        if self._rests(connection, snapshot, now_s):
            return
        try:
            self.engines.prepare(source, device, now_s)
            # The input opens first, so that no sound is lost while the output opens.
            self.input.maintain(connection, now_s)
            assert self.engines.python is not None
            self.output.maintain(connection, self.engines.python.fill, now_s)
        except (LostError, NotFoundError) as error:
            if connection and connection.lost:
                self._lose_server(now_s, str(error))
            elif self.states.state is not DaemonState.RUNNING:
                # Report why no stream opens; the next snapshot shows a missing device or tap.
                self.states.enter(self.states.state, now_s, str(error))
            return
        if self.input.name and self.output.name:
            self.states.enter(DaemonState.RUNNING, now_s)

    def follow(self, config: RunConfig, now_s: float) -> set[Change]:
        """Apply another config; return what differs. After a UsageError, nothing has changed."""
        self._apply(self._with_rule(config), now_s)
        changes = changes_between(self.user_config, config)
        self.user_config = config
        return changes

    def _use_rule(self, now_s: float) -> None:
        try:
            self._apply(self._with_rule(self.user_config), now_s)
        except UsageError as error:  # the sound goes on as before
            self._note_rule(error)

    def _with_rule(self, config: RunConfig) -> RunConfig:
        """Return the config with the rule that acts, without it if it contradicts the config."""
        self._rule_error = ""
        try:
            return apps.with_rule(config, self._acting.rule)
        except UsageError as error:
            self._note_rule(error)
            return config

    def _note_rule(self, error: UsageError) -> None:
        self._rule_error = f"the rule {self.rule!r} of [[application]] cannot act: {error}"

    def _apply(self, config: RunConfig, now_s: float) -> None:
        """Apply another config with the rule that acts; see `follow`."""
        changes = changes_between(self.config, config)
        self._endpoints.check_change(self.config, config)
        config.settings.transform_parameters  # noqa: B018 - reads the rig's file, once
        self.engines.follow(config, changes)
        self.config = config
        self.input.configure(config)
        self.output.configure(config)
        if Change.PRIORITY in changes:
            self.priority.set_wanted(config.live.realtime)
        restarts = Change.ENGINE in changes
        if Change.TAP in changes:
            restarts |= self._endpoints.retarget_input(config)
        if Change.DEVICE in changes:
            self._endpoints.retarget_output(config)
            if engine := self.engines.python:
                self.output.set_format(engine.samplerate, engine.drive.outputs)
        self._drop_in.follow(config)
        self.alignment.follow(config)
        if restarts or Change.BLOCKS in changes:
            self._endpoints.close()
        if restarts:
            if config.recording:
                config.recording.end("another tap needs a new mix, which a replay cannot repeat")
            self.engines.drop()
        if changes:
            self._idle.wake(now_s)

    def close(self, now_s: float, *, keep: bool = True) -> None:
        """Stop the daemon. keep: whether to keep an output file. WriteError: writing it failed."""
        self.states.enter(DaemonState.STOPPING, now_s)
        self.engines.close()
        self._endpoints.close()
        self.alignment.close()
        self._drop_in.close()
        self._link.close()
        self._endpoints.end(keep=keep)

    def _notice_pauses(self, now_s: float) -> None:
        if self._stalls.woke(now_s, self.rest_s):
            # After a suspend, devices may be missing at first. `tick` reopens the streams later.
            self._endpoints.close()
            self.engines.native.close()
            self._idle.wake(now_s)
        if self.engines.python:
            self._stalls.count_resyncs(self.engines.python.delay_line.status.resyncs)
            if self.input.needs_server:  # while a file plays, effects may be slow
                self.engines.python.framework.look_for_blocked(now_s)

    def _rests(
        self, connection: PulseConnection | None, snapshot: ServerSnapshot | None, now_s: float
    ) -> bool:
        """Close the Python engine's streams if nothing plays; return whether the daemon is idle."""
        tap, engine = self.input, self.engines.python
        if not (tap.may_rest and self.output.may_rest):
            self._idle.wake(now_s)
            return False
        heard = self._idle.resting and tap.listen(connection, now_s)
        players = tap.players(snapshot)
        # Without players, buffers may stop arriving, and `engine.faded` might never become true.
        over = engine is not None and (engine.faded or not players)
        last_sound_s = engine.last_sound_s if engine and over else now_s
        if not self._idle.update(now_s, players, last_sound_s, heard=heard):
            return False
        if self.states.enter(DaemonState.IDLE, now_s, tap.why_silent):
            self._endpoints.close()
            if engine:
                engine.rest()
        return True

    def _connected(self, now_s: float) -> PulseConnection | None:
        if lost := self._link.lost:
            self._lose_server(now_s, lost)
        try:
            if self._link.open(now_s):
                self._idle.wake(now_s)
        except CushionError as error:
            self.states.enter(DaemonState.WAITING_FOR_SERVER, now_s, str(error))
            return None
        return self._link.connection

    def _lose_server(self, now_s: float, reason: str) -> None:
        if self._link.connection:
            self.states.count(Cause.SERVER_LOST, reason)
            self.input.close()
            if self.output.needs_server:  # other outputs continue with silence
                self.output.close()
            self.alignment.close()
            self._drop_in.close()
            self.engines.native.close()
            self._link.close()
        self._found = (None, None)
        self.states.enter(DaemonState.WAITING_FOR_SERVER, now_s, reason)

    def _locate_tap(self, snapshot: ServerSnapshot | None, device: AudioNode) -> AudioNode:
        return self.input.locate(snapshot, device.name if self.output.needs_server else None)

    def _locate_device(self, snapshot: ServerSnapshot | None, now_s: float) -> AudioNode | None:
        """Return the device; without a device, enter WAITING_FOR_DEVICE and return None."""
        try:
            return self.output.locate(snapshot)
        except NotFoundError as error:
            if self.output.is_open:
                self.states.recover(Cause.DEVICE_LOST, now_s, str(error))
            self._endpoints.close()  # vibration that is not felt heats no coil, and is no dose
            if self.engines.python:
                self.engines.python.rest()
            self.priority.restore()
            self.engines.native.lose_links(Cause.DEVICE_LOST, now_s, str(error))
            self._found = (None, None)
            self._idle.wake(now_s)
            self.states.enter(DaemonState.WAITING_FOR_DEVICE, now_s, str(error))
            return None
