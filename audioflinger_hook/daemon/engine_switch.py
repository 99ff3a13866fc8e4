"""Which engine computes the vibration, native or Python, and the change from one to the other."""

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
from audioflinger_hook.daemon.native.engine import NativeEngine
from audioflinger_hook.daemon.native.taps import why_not_applications
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


class EngineSwitch:
    """Chooses the engine, and runs the native one. For the supervising thread alone.

    config: what to do. folder: private, for files of the native engine; None: Python always.
    states: the daemon's state. on_change: called by another thread when the graph changes.
    reason: why the Python engine computes, "" while the native one does. sound_gain: the factor
    that undoes the listener's volume.
    """

    def __init__(
        self,
        config: RunConfig,
        folder: Path | None,
        states: StateKeeper,
        on_change: Callable[[], None],
    ) -> None:
        self._config = config
        self._folder = folder
        self._states = states
        self._on_change = on_change
        self._problem = ""
        self._failures = 0
        self._seen_s: float | None = None
        self._played_s = -QUIET_S
        self._refused: dict[str, str] = {}
        self._volume_of: tuple[PulseConnection, int] | None = None
        self.sound_gain = 1.0
        self.native: NativeEngine | None = None
        self.reason = "nothing has played yet"

    @property
    def is_required(self) -> bool:
        """Whether the config allows no other engine than the native one."""
        return self._config.live.engine == "native"

    def follow(self, config: RunConfig) -> None:
        """Use another config."""
        if config != self._config:
            self._problem, self._failures = "", 0
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
        if not reason and snapshot is not None and isinstance(source, Applications):
            reason = why_not_applications(source, snapshot)
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
        *,
        linked: bool,
    ) -> bool:
        """Keep the native engine running; return whether it plays, or can play once it is linked.

        Raises nothing: a lost engine starts again, and `auto` gives up after some failures.
        """
        assert isinstance(source, (Source, Applications))
        assert isinstance(device, Sink)
        try:
            native = self._opened()
            self._set_volume(device, connection, volume)
            native.set_sound_gain(self.sound_gain)
            plays = native.maintain(source, device, players, now_s, linked=linked)
        except CushionError as error:
            self._fail(error, now_s)
            return False
        if native.plan is not None:
            self._failures = 0
        if not linked:
            return plays
        if plays and players:
            native.mend_links(connection.latest.events, now_s)
        self._note_unseen(native, source, device, now_s)
        if players:
            self._played_s = now_s
        if plays and linked:
            quiet = now_s - self._played_s > QUIET_S
            state = DaemonState.IDLE if quiet else DaemonState.RUNNING
            reason = source.why_silent if isinstance(source, Applications) else NOTHING
            self._states.enter(state, now_s, reason if quiet else "")
        return plays

    def lose_links(self, cause: Cause, now_s: float, reason: str) -> None:
        """Note that the tap or the device has vanished."""
        if self.native is not None and self.native.lose_links(now_s):
            self._states.recover(cause, now_s, reason)

    def leave(self, now_s: float) -> bool:
        """Let the native engine leave the graph softly; return whether it has left.

        Repeat it until then. `close` ends it.
        """
        native = self.native
        return native is None or (native.fade_out(now_s) and native.leave(now_s))

    def close(self) -> None:
        """End the native engine until the next `maintain`. May be repeated; raises nothing."""
        if self.native is not None:
            self.native.close()
        self.native = None
        self._seen_s = None

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
            self.native = NativeEngine(self._config, self._folder, self._states, self._on_change)
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
        self._failures += 1
        if played:
            self._states.recover(Cause.ENGINE_LOST, now_s, str(error))
        if self.native is not None and self.native.is_lost:
            self.close()
        if not lost or self._failures >= FAILURES_MAX:
            self._problem = f"the native engine failed: {error}"
            self.close()
            if self.is_required:
                self._states.enter(DaemonState.RECOVERING, now_s, self._problem)

    def _note_unseen(
        self, native: NativeEngine, source: Source | Applications, device: Sink, now_s: float
    ) -> None:
        missing = native.unseen(source, device)
        if not missing or self._seen_s is None:
            self._seen_s = now_s
        elif now_s - self._seen_s > UNSEEN_S:
            self._problem = f"PipeWire's graph has no node {missing!r}: it is of another server"
            self.close()
