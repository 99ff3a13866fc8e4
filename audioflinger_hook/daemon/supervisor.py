"""The main thread of the daemon: opens what is needed, watches it, and lets it rest."""

from __future__ import annotations

import numpy as np

from audioflinger_hook.daemon.drop_in_control import DropInControl
from audioflinger_hook.daemon.endpoints import Endpoints
from audioflinger_hook.daemon.engine import Clocks, Engine
from audioflinger_hook.daemon.idle_policy import IdlePolicy
from audioflinger_hook.daemon.run_config import ConfigDiff, RunConfig
from audioflinger_hook.daemon.sides import InputSide, OutputSide, Place
from audioflinger_hook.daemon.stall_detector import StallDetector
from audioflinger_hook.daemon.wake import Nudge, Wake
from audioflinger_hook.pipeline.drive_factory import drive_of
from audioflinger_hook.pipeline.framework import Framework
from audioflinger_hook.service.backoff import Backoff
from audioflinger_hook.service.state import Cause, DaemonState, StateKeeper
from device.errors import CushionError, LostError, NotFoundError
from device.server import FallbackSink, PulseConnection, ServerSnapshot
from device.server.snapshot import tap_latency_s
from device.stream import AudioPriority
from device.units import Float32Array

TICK_S = 0.1
"""How often streams are looked after while they run; events come sooner."""

RESTING_TICK_S = 1.0
"""The same while they rest."""

LONGEST_WAIT_S = 0.5
"""Between attempts to reach the server: asking costs it and us next to nothing."""


class Supervisor:
    """One daemon: from a tap to a device, each the sound server's or paced by us.

    `tick` is called by the thread that made it whenever `wake` rings, and `rest_s` after the last
    time anyway; times are seconds of time.monotonic(). Nothing that a server or device does makes
    it raise: it waits, recovers and says so in `states`. A file that cannot be read or written any
    more ends it: the error is raised. `engine` is what runs at present, None before the first
    sound. priority: of the audio threads. trouble: what is wrong with the config that should have
    been taken, "" for nothing.

    Raises
    ------
    UsageError, NotFoundError
        A file to play, or to write, cannot be used.
    """

    def __init__(self, order: RunConfig, clocks: Clocks, wake: Wake) -> None:
        now_s = clocks.now_s()
        self.states = StateKeeper(now_s)
        self.engine: Engine | None = None
        self._order = order
        self._clocks = clocks
        self._wake = wake
        self.priority = AudioPriority(order.live.realtime)
        self.trouble = ""
        self._sides = Endpoints(order, clocks, self.states, self.priority, wake.ring)
        self._stand_in = _stand_in_of(order)
        self._connection: PulseConnection | None = None
        self._refuge: FallbackSink | None = None
        self._server_backoff = Backoff(longest_s=LONGEST_WAIT_S)
        self._rest = IdlePolicy(now_s)
        self._found: tuple[Place | None, Place | None] = (None, None)
        self._pauses = StallDetector(self.states, clocks.slept_s)
        self._heard_before_s = 0.0

    @property
    def _input(self) -> InputSide:
        return self._sides.input

    @property
    def _output(self) -> OutputSide:
        return self._sides.output

    @property
    def rest_s(self) -> float:
        """For how long nothing has to be done, unless `wake` rings."""
        return RESTING_TICK_S if self.states.state is DaemonState.IDLE else TICK_S

    @property
    def heard_s(self) -> float:
        """Seconds of sound that came in since the first buffer."""
        engine = self.engine
        return self._heard_before_s + (engine.frames / engine.samplerate if engine else 0.0)

    @property
    def heard_buffers(self) -> int:
        """Buffers that came in since the first one."""
        return self.engine.buffers if self.engine else 0

    @property
    def ended(self) -> bool:
        """Whether the sound has come to its end, and its vibration has run out."""
        return self._input.ended

    @property
    def summary(self) -> str:
        """What the device has to say of all that it got, one line; mostly empty."""
        return self._output.summary

    @property
    def endpoints(self) -> tuple[tuple[str, str | None], tuple[str, str | None]]:
        """Tap and device: the address asked for, and the name of what is there."""
        source, sink = self._found
        return (
            (str(self._input), source.name if source else None),
            (str(self._output), sink.name if sink else None),
        )

    @property
    def xruns(self) -> tuple[int, int]:
        """How often the streams of tap and output were late, as far as PortAudio tells."""
        return self._input.xruns, self._output.xruns

    @property
    def offset_s(self) -> float:
        """What the user's offset adds to the delay of the vibration, less that of the sound."""
        line_s = self.engine.delay_line.offset_s if self.engine else 0.0
        return line_s - (self._stand_in.delay_s if self._stand_in else 0.0)

    @property
    def latencies_s(self) -> tuple[float, float]:
        """What tap and output add to the delay, in seconds."""
        (source, device), connection = self._found, self._connection
        if source is None or device is None:
            return 0.0, 0.0
        seen = connection.latest if connection else None
        tap_s = 0.0
        if seen and self._input.needs_server:
            tap_s = tap_latency_s(seen, self._order.live.block_frames, source.samplerate)
        return tap_s, self._output.delay_s(seen)

    @property
    def warnings(self) -> list[str]:
        """What a user should know, a line each."""
        recording = self._order.recording
        warnings = list(self.engine.framework.warnings) if self.engine else []
        warnings += self._stand_in.warnings if self._stand_in else []
        warnings += [*self._input.warnings, *self._output.warnings]
        if recording:
            warnings += recording.warnings
            if self.engine and self.engine.framework.bypassed():
                warnings.append("an effect was bypassed: a replay will not be what was recorded")
        refuge, connection = self._refuge, self._connection
        if refuge and connection and not refuge.active and connection.latest.kind != "PipeWire":
            warnings.append(refuge.reason)
        return [*warnings, *filter(None, (self.priority.warning, self.trouble))]

    def look(self) -> None:
        """See once whether server, device and tap are there, as far as they are needed.

        Raises
        ------
        LostError, NotFoundError
            The first that is not, with what would help.
        """
        if not self._output.needs_server:
            self._output.locate(None)
        if not self._sides.needs_server:
            return
        connection = PulseConnection()
        try:
            self._locate_tap(connection.latest, self._output.locate(connection.latest))
        finally:
            connection.close()

    def tick(self, now_s: float) -> None:
        """Bring everything nearer to where it should be."""
        self._notice_pauses(now_s)
        connection = None
        try:
            if self._sides.needs_server:
                connection = self._connected(now_s)
                if connection is None:
                    return
            snapshot = connection.latest if connection else None
            device = self._there(snapshot, now_s)
            if device is None:
                return
            self._found = (None, device)
            source = self._locate_tap(snapshot, device)
            self._found = (source, device)
            if self._stand_in and connection:
                haptic = device.name if self._output.needs_server else None
                self._stand_in.keep(connection, haptic, now_s)
        except LostError as error:
            self._lose_server(now_s, str(error))
            return
        except NotFoundError as error:
            self._input.close()
            self._rest.awake(now_s)
            self.states.enter(DaemonState.WAITING_FOR_SOUND_SOURCE, now_s, str(error))
            return
        if self._rests(connection, snapshot, now_s):
            return
        try:
            self._prepare_engine(source, device, now_s)
            # Sound first: what comes while the output opens is not lost.
            self._input.keep(connection, now_s)
            self._output.keep(connection, self._fill, now_s)
        except LostError as error:
            if connection and connection.lost:
                self._lose_server(now_s, str(error))
            return
        except NotFoundError:
            return  # it went while we looked; the next snapshot says what to do
        if self._input.name and self._output.name:
            self.states.enter(DaemonState.RUNNING, now_s)

    def follow(self, order: RunConfig, now_s: float) -> ConfigDiff:
        """Do as another order says from now on; return what that changes.

        Only what it concerns is closed, for the next `tick` to open; sound goes on meanwhile
        where it can, see `ConfigDiff`.

        Raises
        ------
        UsageError
            What plays cannot be treated so; nothing has changed then.
        """
        changes, engine = ConfigDiff.between(self._order, order), self.engine
        self._sides.refuse(self._order, order)
        offset_s = max(0.0, order.live.offset_s)
        if engine and changes.engine:
            # Whether all of it can be made.
            framework = Framework(engine.samplerate, engine.channels, order.settings)
            drive_of(order.settings, engine.samplerate, framework.haptic_channels)
        elif engine:
            engine.follow(order.settings, offset_s)
        self._order = order
        self._sides.take(order)
        if changes.priority:
            self.priority.set_wanted(order.live.realtime)
        begins_anew = changes.engine
        if changes.tap:
            begins_anew |= self._sides.lead_input(order)
        if changes.device:
            self._sides.lead_output(order)
            if engine:
                self._output.suit(engine.samplerate, engine.drive.outputs)
        if changes.drop_in:
            if self._stand_in:
                self._stand_in.close()
            self._stand_in = _stand_in_of(order)
        elif changes.offset and self._stand_in:
            self._stand_in.lead(max(0.0, -order.live.offset_s))
        if begins_anew or changes.blocks:
            self._sides.close()
        if begins_anew and order.recording:
            order.recording.end("what is tapped now is mixed anew, which no replay does")
        if begins_anew:
            self._heard_before_s, self.engine = self.heard_s, None
        if changes.any:
            self._rest.awake(now_s)
        return changes

    def close(self, now_s: float, *, keep: bool = True) -> None:
        """Fall silent and let go of everything; keep: a file that was written stays.

        WriteError: it cannot be kept; all else is done by then.
        """
        self.states.enter(DaemonState.STOPPING, now_s)
        self._sides.close()
        if self._stand_in:
            self._stand_in.close()
        if self._refuge:
            self._refuge.close()
        if self._connection:
            self._connection.close()
        self._sides.end(keep=keep)

    def _notice_pauses(self, now_s: float) -> None:
        if self._pauses.woke(now_s, self.rest_s):
            # Devices and servers come back in their own time: begin with what is there then.
            self._sides.close()
            self._rest.awake(now_s)
        if self.engine:
            self._pauses.count_resyncs(self.engine.delay_line.status.resyncs)

    def _connected(self, now_s: float) -> PulseConnection | None:
        connection = self._connection
        if connection is not None and connection.lost is None:
            return connection
        if connection is not None:
            self._lose_server(now_s, str(connection.lost))
        if self._server_backoff.wait_s(now_s) > 0.0:
            return None
        try:
            self._connection = connection = PulseConnection(Nudge(self._wake))
            self._refuge = FallbackSink(connection)
        except CushionError as error:
            self._server_backoff.failed(now_s)
            self.states.enter(DaemonState.WAITING_FOR_SERVER, now_s, str(error))
            return None
        self._server_backoff.succeeded()
        self._rest.awake(now_s)
        return connection

    def _lose_server(self, now_s: float, reason: str) -> None:
        if self._connection is not None:
            self.states.count(Cause.SERVER_LOST, reason)
            self._input.close()
            if self._output.needs_server:  # a card or a file goes on, with silence
                self._output.close()
            if self._stand_in:
                self._stand_in.close()
            self._connection.close()
            self._connection = self._refuge = None
        self._found = (None, None)
        self.states.enter(DaemonState.WAITING_FOR_SERVER, now_s, reason)

    def _locate_tap(self, snapshot: ServerSnapshot | None, device: Place) -> Place:
        return self._input.locate(snapshot, device.name if self._output.needs_server else None)

    def _there(self, snapshot: ServerSnapshot | None, now_s: float) -> Place | None:
        """Return the device, or None after saying that it is awaited."""
        try:
            return self._output.locate(snapshot)
        except NotFoundError as error:
            if self._output.is_open:
                self.states.recover(Cause.DEVICE_LOST, now_s, str(error))
            self._output.close()
            if not self._input.needs_server:  # a file waits for the device
                self._input.close()
            self._found = (None, None)
            self._rest.awake(now_s)
            self.states.enter(DaemonState.WAITING_FOR_DEVICE, now_s, str(error))
            return None

    def _rests(
        self, connection: PulseConnection | None, snapshot: ServerSnapshot | None, now_s: float
    ) -> bool:
        """IdlePolicy if nothing plays; whether so."""
        if not (self._input.may_rest and self._output.may_rest):
            self._rest.awake(now_s)
            return False
        engine = self.engine
        heard = self._rest.resting and self._input.listen(connection, now_s)
        players = self._input.players(snapshot)
        # Where nobody plays, nothing may come any more that would let the vibration fade.
        over = engine is not None and (engine.faded or not players)
        last_sound_s = engine.last_sound_s if engine and over else now_s
        if not self._rest.update(now_s, players, last_sound_s, heard=heard):
            return False
        if self.states.enter(DaemonState.IDLE, now_s, "nothing plays"):
            self._sides.close()
            if engine:
                engine.rest()
        return True

    def _prepare_engine(self, source: Place, device: Place, now_s: float) -> None:
        """Have an engine, made for the first source: later ones are mixed into its format."""
        engine = self.engine
        if engine is None:
            recording, feed = self._order.recording, self._sides.feed
            on_step, on_mix = None, None
            if recording:
                on_step, on_mix = recording.hooks(source.samplerate, of_mix=feed.records_mix)
            engine = self.engine = Engine(
                feed.client(source.samplerate, source.channels),
                device.samplerate or source.samplerate,
                self._order.settings,
                clocks=self._clocks,
                offset_s=max(0.0, self._order.live.offset_s),
                block_frames=self._order.live.block_frames,
                now_s=now_s,
                bypass_late=self._input.needs_server,
                on_step=on_step,
                on_mix=on_mix,
            )
            feed.serve(engine)
            self._output.suit(engine.samplerate, engine.drive.outputs)
        elif not self._output.is_open:
            engine.lead_to(device.samplerate or engine.samplerate, self._order.live.block_frames)

    def _fill(self, out: Float32Array, now_s: float) -> None:
        engine = self.engine
        if engine is None:
            out[:] = np.float32(0.0)
        else:
            engine.fill(out, now_s)


def _stand_in_of(order: RunConfig) -> DropInControl | None:
    """Return what stands in between, if that is asked for."""
    if not order.live.drop_in:
        return None
    return DropInControl(max(0.0, -order.live.offset_s))
