"""Which engine computes the vibration, native or Python."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from audioflinger_hook.daemon.inputs.applications import Applications
from audioflinger_hook.daemon.inputs.base import NOTHING, AudioNode
from audioflinger_hook.daemon.native.abilities import (
    missing_parts,
    why_not_config,
    why_not_server,
    why_not_tap,
)
from audioflinger_hook.daemon.native.chains import Restore
from audioflinger_hook.daemon.native.designs import DriveDesigns
from audioflinger_hook.daemon.native.engine import NativeEngine
from audioflinger_hook.daemon.native.taps import Tap, tap_of
from audioflinger_hook.daemon.outputs.base import DeviceVolume
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.daemon.timing import QUIET_S
from audioflinger_hook.service.state import Cause, DaemonState, StateKeeper
from device.errors import CushionError, LostError, NotFoundError
from device.server import PulseConnection, ServerSnapshot
from device.server.snapshot import Sink, Source
from device.stream.pulse_plugin import missing_plugin

FAILURES_MAX = 3
"""Starts of the native engine that may fail in a row until `auto` takes the Python engine."""

UNSEEN_S = 2.0
"""How long tap or device may be missing in PipeWire's graph until `auto` gives up."""

START_S = 5.0
"""How long a start may take until another way is taken: the monitor's tap, then Python."""

PROVEN_S = 5.0
"""How long the native engine must play until earlier failures no longer count."""


class EngineSwitch:
    """Chooses the engine, and runs the native one. For the supervising thread alone.

    config: what to do. folder: private, for files of the native engine; None: Python always.
    states: the daemon's state. on_change: called by another thread when the graph changes.
    restore: sets what the rigs of a new chain begin with.
    reason: why the Python engine computes, "" while the native one does. monitor_gain,
    streams_gain: factors on the sound of a monitor, or of the streams themselves, by which the
    listener's volumes count as they should.
    """

    def __init__(
        self,
        config: RunConfig,
        folder: Path | None,
        states: StateKeeper,
        on_change: Callable[[], None],
        restore: Restore,
    ) -> None:
        self._restore = restore
        self._designs = DriveDesigns()
        self._config = config
        self._folder = folder
        self._states = states
        self._on_change = on_change
        self._problem = ""
        self._failures = 0
        self._failed_s = 0.0
        self._monitor_reason = ""
        self._seen_s: float | None = None
        self._began_s: float | None = None
        self._played_s = -QUIET_S
        self._refused: dict[str, str] = {}
        self._volume_of: tuple[PulseConnection, int] | None = None
        self.monitor_gain = self.streams_gain = 1.0
        self.native: NativeEngine | None = None
        self.reason = "nothing has played yet"

    @property
    def is_required(self) -> bool:
        """Whether the config allows no other engine than the native one."""
        return self._config.live.engine == "native"

    def follow(self, config: RunConfig) -> None:
        """Use another config."""
        if config != self._config:
            self._problem, self._failures, self._monitor_reason = "", 0, ""
            self._refused.clear()
        self._config = config
        if self.native is not None:
            self.native.follow(config)

    def check(self, snapshot: ServerSnapshot | None) -> None:
        """Raise NotFoundError if the engine is impossible on this machine."""
        reason = self._why_python(snapshot)
        if reason and self.is_required:
            raise NotFoundError(
                f"engine = 'native' is impossible: {reason}; allowed then: auto, python"
            )
        if reason and self._config.needs_plugin and (missing := missing_plugin()):
            raise NotFoundError(f"the Python engine ({reason}) cannot play: {missing}")

    def takes_native(self, source: AudioNode, snapshot: ServerSnapshot | None) -> bool:
        """Return whether the native engine is to compute; sets `reason`."""
        reason = self._why_python(snapshot) or why_not_tap(source.channels)
        self.reason = reason or ("" if self.is_required else self._problem)
        return not self.reason

    def maintain(
        self,
        source: AudioNode,
        device: AudioNode,
        players: frozenset[int],
        connection: PulseConnection,
        volume: DeviceVolume,
        now_s: float,
    ) -> None:
        """Keep the native engine running.

        Raises nothing: a lost engine starts again, and `auto` gives up after some failures.
        """
        assert isinstance(source, (Source, Applications))
        assert isinstance(device, Sink)
        try:
            native = self._opened()
            self._set_volume(device, connection, volume)
            native.set_sound_gains(streams=self.streams_gain, monitor=self.monitor_gain)
            plays = native.maintain(source, device, now_s)
        except CushionError as error:
            self._fail(error, now_s)
            return
        if native.waits_for:
            self._began_s = None
            self._states.enter(DaemonState.WAITING_FOR_SERVER, now_s, native.waits_for)
            return
        self._note_unseen(native, tap_of(source, self._config.rules), device, now_s)
        self._note_start(native, plays, now_s)
        if players or native.is_fed:
            self._played_s = now_s
        if plays:
            quiet = now_s - self._played_s > QUIET_S
            state = DaemonState.IDLE if quiet else DaemonState.RUNNING
            reason = source.why_silent if isinstance(source, Applications) else NOTHING
            self._states.enter(state, now_s, reason if quiet else "")

    def lose_links(self, cause: Cause, now_s: float, reason: str) -> None:
        """Note that the tap or the device has vanished."""
        if self.native is not None and self.native.lose_links(now_s):
            self._states.recover(cause, now_s, reason)

    def close(self) -> None:
        """End the native engine until the next `maintain`. May be repeated; raises nothing."""
        if self.native is not None:
            self.native.close()
        self._designs.end()
        self.native = None
        self._seen_s = self._began_s = None

    def _why_python(self, snapshot: ServerSnapshot | None) -> str:
        if self._config.live.engine == "python":
            return "engine = 'python'"
        if self._folder is None or snapshot is None:
            return why_not_config(self._config) or "there is no sound server"
        if "config" not in self._refused:
            self._refused["config"] = why_not_config(self._config) or missing_parts()
        return self._refused["config"] or why_not_server(snapshot)

    def _opened(self) -> NativeEngine:
        if self.native is None:
            assert self._folder is not None
            self.native = NativeEngine(
                self._config,
                self._folder,
                self._states,
                self._on_change,
                self._restore,
                self._designs,
                monitor_reason=self._monitor_reason,
            )
        return self.native

    def _set_volume(self, device: Sink, connection: PulseConnection, volume: DeviceVolume) -> None:
        set_volume = partial(connection.set_sink_volume_db, device.name)
        opened = connection, device.index  # another server may give the same index
        if self._volume_of != opened:
            volume.set(set_volume)
            self._volume_of = opened
        else:
            volume.update(set_volume)

    def _fail(self, error: CushionError, now_s: float) -> None:
        lost = isinstance(error, LostError)
        played = self.native is not None and self._failures == 0 and lost
        self._failures, self._failed_s = self._failures + 1, now_s
        if played:
            self._states.recover(Cause.ENGINE_LOST, now_s, str(error))
        if self.native is not None and self.native.is_lost:
            self.close()
        if not lost or self._failures >= FAILURES_MAX:
            self._give_up(f"the native engine failed: {error}", now_s)
        elif self._failures == FAILURES_MAX - 1:
            self._monitor_reason = f"the native engine failed: {error}"
            if self.native is not None:
                self.native.use_monitor(self._monitor_reason)

    def _give_up(self, problem: str, now_s: float) -> None:
        """Leave the rest to the Python engine, or try on where the config allows no other."""
        self._problem = problem
        self.close()
        if self.is_required:
            self._failures = 0
            self._states.enter(DaemonState.RECOVERING, now_s, problem)

    def _note_unseen(self, native: NativeEngine, tap: Tap, device: Sink, now_s: float) -> None:
        problem = native.unseen(tap, device)
        if not problem or self._seen_s is None:
            self._seen_s = now_s
        elif now_s - self._seen_s > UNSEEN_S:
            self._give_up(problem, now_s)

    def _note_start(self, native: NativeEngine, plays: bool, now_s: float) -> None:
        """Take another way if a start takes too long, and forget failures once it has played."""
        if self._began_s is None or plays or native.is_designing:
            self._began_s = now_s
        if plays:
            if now_s - self._failed_s > PROVEN_S:
                self._failures = 0
        elif now_s - self._began_s > START_S:
            self._began_s = now_s
            problem = f"the native engine did not start within {START_S:g} s"
            if native.monitor_reason:
                self._give_up(problem, now_s)
            else:
                self._monitor_reason = problem
                native.use_monitor(problem)
                self._states.enter(self._states.state, now_s, f"{problem}; trying the monitor")
