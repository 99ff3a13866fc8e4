"""Restarts a lost native engine; gives up after FAILURES_MAX losses in a row or any other error."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from audioflinger_hook.daemon.inputs.applications import Applications
from audioflinger_hook.daemon.inputs.base import NOTHING, AudioNode
from audioflinger_hook.daemon.native.chains import Restore
from audioflinger_hook.daemon.native.engine import NativeEngine
from audioflinger_hook.daemon.native.plan import DriveDesigns
from audioflinger_hook.daemon.native.taps import tap_of
from audioflinger_hook.daemon.outputs.base import DeviceVolume
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.daemon.timing import QUIET_S
from audioflinger_hook.service.state import Cause, DaemonState, StateKeeper
from device.errors import CushionError, LostError
from device.server import PulseConnection
from device.server.snapshot import Sink, Source

FAILURES_MAX = 3  # failures in a row, after which the native engine gives up
UNSEEN_S = 2.0  # longest absence of tap or device in the graph before the engine gives up
START_S = 5.0  # longest start before the monitor is tapped, and then before the engine gives up
PROVEN_S = 5.0  # if the engine plays this long after the latest failure, failures are forgotten


class NativeRun:
    """Runs the native engine while it is chosen.

    folder: private, for files. on_change: another thread calls it when the graph changes. restore:
    sets the initial state of a new chain's rigs. problem: why the engine cannot be used, or "".
    """

    def __init__(
        self,
        config: RunConfig,
        folder: Path | None,
        states: StateKeeper,
        on_change: Callable[[], None],
        restore: Restore,
    ) -> None:
        self._config, self._folder, self._states = config, folder, states
        self._on_change, self._restore = on_change, restore
        self._designs = DriveDesigns()
        self._played_s, self._offset_s = -QUIET_S, 0.0
        self._volume_of: tuple[PulseConnection, int] | None = None
        self._has_monitor = True
        self.engine: NativeEngine | None = None
        self.begin()

    def begin(self) -> None:
        """Forget earlier failures."""
        self.problem = self._monitor_reason = ""
        if self.engine is not None:
            self.engine.use_monitor("")
        self._failures, self._failed_s = 0, 0.0
        self._seen_s: float | None = None
        self._began_s: float | None = None

    def follow(self, config: RunConfig) -> None:
        """Apply another config."""
        self._config = config
        if self.engine is not None:
            self.engine.follow(config)

    def set_offset(self, offset_s: float) -> None:
        """Set the delay of the vibration in seconds."""
        self._offset_s = offset_s
        if self.engine is not None:
            self.engine.chains.set_offset(offset_s)

    def maintain(
        self,
        source: AudioNode,
        device: AudioNode,
        players: frozenset[int],
        connection: PulseConnection,
        volume: DeviceVolume,
        sound_gains: tuple[float, float],
        now_s: float,
    ) -> None:
        """Keep the engine running; raise nothing. sound_gains: for streams, for a monitor."""
        assert isinstance(source, (Source, Applications))
        assert isinstance(device, Sink)
        self._has_monitor = isinstance(source, Source)
        try:
            engine = self._opened()
            self._set_volume(device, connection, volume)
            gain = 1.0 if engine.plays_trials else sound_gains[bool(engine.monitor_reason)]
            engine.chains.set_sound_gain(gain)
            plays = engine.maintain(source, device, now_s)
        except CushionError as error:
            self._fail(error, now_s)
            return
        if engine.waits_for:
            self._began_s = None
            self._states.enter(DaemonState.WAITING_FOR_SERVER, now_s, engine.waits_for)
            return
        problem = engine.unseen(tap_of(source, self._config.rules, self._config.left_out), device)
        if not problem or self._seen_s is None:
            self._seen_s = now_s
        elif now_s - self._seen_s > UNSEEN_S:
            self._give_up(problem, now_s)
        self._note_start(engine, plays, now_s)
        if engine.is_fed or (players and engine.monitor_reason):  # others may be left out
            self._played_s = now_s
        if plays:
            quiet = now_s - self._played_s > QUIET_S
            state = DaemonState.IDLE if quiet else DaemonState.RUNNING
            reason = source.why_silent if isinstance(source, Applications) else NOTHING
            self._states.enter(state, now_s, reason if quiet else "")

    def lose_links(self, cause: Cause, now_s: float, reason: str) -> None:
        """Remove the links because tap or device is missing."""
        if self.engine is not None and self.engine.lose_links(now_s):
            self._states.recover(cause, now_s, reason)

    def close(self) -> None:
        """End the engine until the next `maintain`. Repeated calls do nothing."""
        if self.engine is not None:
            self.engine.close()
        self._designs.end()
        self.engine = None
        self._seen_s = self._began_s = None

    def _opened(self) -> NativeEngine:
        if self.engine is None:
            assert self._folder is not None
            self.engine = NativeEngine(
                self._config,
                self._folder,
                self._states,
                self._on_change,
                self._restore,
                self._designs,
                monitor_reason=self._monitor_reason,
            )
            self.engine.chains.set_offset(self._offset_s)
        return self.engine

    def _set_volume(self, device: Sink, connection: PulseConnection, volume: DeviceVolume) -> None:
        set_volume = partial(connection.set_sink_volume_db, device.name)
        opened = connection, device.index  # another server may use the same index
        if self._volume_of != opened:
            volume.set(set_volume)
            self._volume_of = opened
        else:
            volume.update(set_volume)

    def _fail(self, error: CushionError, now_s: float) -> None:
        lost = isinstance(error, LostError)
        if self.engine is not None and self._failures == 0 and lost:
            self._states.recover(Cause.ENGINE_LOST, now_s, str(error))
        self._failures, self._failed_s = self._failures + 1, now_s
        self._began_s = None  # the next attempt has START_S of its own before the monitor is tapped
        if self.engine is not None and self.engine.watch.lost:
            self.close()
        if not lost or self._failures >= FAILURES_MAX:
            self._give_up(f"the native engine failed: {error}", now_s)
        elif self._failures == FAILURES_MAX - 1:
            self._use_monitor(f"the native engine failed: {error}", now_s)

    def _give_up(self, problem: str, now_s: float) -> None:
        """Switch to the Python engine, or try again if only the native engine is allowed."""
        self.close()
        if self._config.live.engine == "native":
            self._failures = 0
            self._states.enter(DaemonState.RECOVERING, now_s, problem)
        else:
            self.problem = problem

    def _use_monitor(self, reason: str, now_s: float) -> None:
        """Tap the monitor; give up if applications are chosen, which a monitor cannot do."""
        if not self._has_monitor:
            self._give_up(reason, now_s)
            return
        self._monitor_reason = reason
        if self.engine is not None:
            self.engine.use_monitor(reason)

    def _note_start(self, engine: NativeEngine, plays: bool, now_s: float) -> None:
        """Tap the monitor or give up after a long start; forget failures older than PROVEN_S."""
        if self._began_s is None or plays or engine.designs.is_busy:
            self._began_s = now_s
        if plays:
            if now_s - self._failed_s > PROVEN_S:
                self._failures = 0
        elif now_s - self._began_s > START_S:
            self._began_s = now_s
            problem = f"the native engine did not start within {START_S:g} s"
            if engine.monitor_reason:
                self._give_up(problem, now_s)
            else:
                self._use_monitor(problem, now_s)
                self._states.enter(self._states.state, now_s, f"{problem}; trying the monitor")
