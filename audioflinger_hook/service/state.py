"""The daemon's state with its start and reason, and counts of recoveries by cause."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType

from audioflinger_hook.service.one_line import one_line


class DaemonState(Enum):
    """The daemon's states; users see the values."""

    STARTING = "starting"
    """Reading its config, taking its lock."""
    WAITING_FOR_SERVER = "waiting-for-server"
    """No sound server answers; connecting is retried."""
    WAITING_FOR_DEVICE = "waiting-for-device"
    """The configured device is not available."""
    WAITING_FOR_SOUND_SOURCE = "waiting-for-sound-source"
    """The tap is not available or not allowed; the reason says which and why."""
    RUNNING = "running"
    """Sound comes in and vibration goes out."""
    IDLE = "idle"
    """Everything is available, and nothing plays."""
    RECOVERING = "recovering"
    """A lost or changed stream or server is being reopened."""
    STOPPING = "stopping"
    """The last state."""


class Cause(Enum):
    """Causes of recoveries; users see the values."""

    SERVER_LOST = "server-lost"
    DEVICE_LOST = "device-lost"
    DEVICE_MOVED = "device-moved"
    TAP_LOST = "tap-lost"
    TAP_MOVED = "tap-moved"
    DEFAULT_CHANGED = "default-changed"
    FORMAT_CHANGED = "format-changed"
    ENGINE_LOST = "engine-lost"
    """The native engine ended or hung, and was started again."""
    STALL = "stall"
    RESYNC = "resync"
    RESUMED = "resumed"
    """The machine was suspended."""


READY = frozenset((DaemonState.RUNNING, DaemonState.IDLE))  # tap and device are there

NOTES_MAX = 32  # notes kept until they are read; older ones are dropped


@dataclass(frozen=True)
class Note:
    """One recovery: its cause, and one line of text."""

    cause: Cause
    text: str


@dataclass(frozen=True)
class StateReport:
    """A consistent report: the state, its reason and duration, and recoveries by cause."""

    state: DaemonState
    reason: str
    since_s: float
    recoveries: Mapping[Cause, int]


class StateKeeper:
    """The state of one daemon, which starts with STARTING at `now_s`.

    One thread changes it and takes the notes; any thread may call `report`. Times are seconds of
    one clock; a clock that runs backwards counts as standing still. The object's size is constant.
    ready_s: when it was first READY, None before.
    """

    def __init__(self, now_s: float) -> None:
        self.ready_s: float | None = None
        self._counts = dict.fromkeys(Cause, 0)
        self._notes: deque[Note] = deque(maxlen=NOTES_MAX)
        # State, reason and start are replaced as one object, so a reader sees a consistent report.
        self._current = (DaemonState.STARTING, "", now_s)

    @property
    def state(self) -> DaemonState:
        """The current state."""
        return self._current[0]

    def enter(self, state: DaemonState, now_s: float, reason: str = "") -> bool:
        """Enter a state, or change the current state's reason; return whether the state is new."""
        before, _, began_s = self._current
        is_new = state is not before
        self._current = (state, one_line(reason), now_s if is_new else began_s)
        if self.ready_s is None and state in READY:
            self.ready_s = now_s
        return is_new

    def recover(self, cause: Cause, now_s: float, reason: str = "") -> None:
        """Count a cause, and enter or keep RECOVERING if the daemon plays."""
        self.count(cause, reason)
        if self.state in READY or self.state is DaemonState.RECOVERING:
            self.enter(DaemonState.RECOVERING, now_s, reason or cause.value)

    def count(self, cause: Cause, text: str = "") -> None:
        """Count a recovery that is complete already; text: what happened."""
        self._counts[cause] += 1
        self._notes.append(Note(cause, one_line(text) or cause.value))

    def notes(self) -> list[Note]:
        """Return the recoveries since the last call, at most the latest NOTES_MAX."""
        notes, self._notes = self._notes, deque(maxlen=NOTES_MAX)
        return list(notes)

    def report(self, now_s: float) -> StateReport:
        """Return the report at `now_s`."""
        state, reason, began_s = self._current
        recoveries = MappingProxyType(self._counts.copy())
        return StateReport(state, reason, max(0.0, now_s - began_s), recoveries)
