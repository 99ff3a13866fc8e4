"""The daemon's state, and the number of recoveries for each cause."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType

from audioflinger_hook.service.one_line import one_line


class DaemonState(Enum):
    """States of the daemon. Their values appear in the status."""

    STARTING = "starting"  # before the first check of server, device and tap
    WAITING_FOR_SERVER = "waiting-for-server"  # retries the connection to a sound server
    WAITING_FOR_DEVICE = "waiting-for-device"  # the configured device is not available
    WAITING_FOR_SOUND_SOURCE = "waiting-for-sound-source"  # the tap is missing or not allowed
    RUNNING = "running"  # an engine plays from the tap to the device
    IDLE = "idle"  # tap and device are available, and no sound plays
    RECOVERING = "recovering"  # reopens what was lost or moved
    STOPPING = "stopping"  # last state


class Cause(Enum):
    """Causes of recoveries. Their values appear in the status."""

    SERVER_LOST = "server-lost"
    DEVICE_LOST = "device-lost"
    DEVICE_MOVED = "device-moved"
    TAP_LOST = "tap-lost"
    TAP_MOVED = "tap-moved"
    DEFAULT_CHANGED = "default-changed"
    FORMAT_CHANGED = "format-changed"
    ENGINE_LOST = "engine-lost"  # the native engine ended or hung and was restarted
    STALL = "stall"
    RESYNC = "resync"
    RESUMED = "resumed"  # the machine was suspended


READY = frozenset((DaemonState.RUNNING, DaemonState.IDLE))  # tap and device are available

NOTES_MAX = 32  # largest number of unread notes; a further note replaces the oldest note


@dataclass(frozen=True)
class Note:
    """A recovery. text: description in one line."""

    cause: Cause
    text: str


@dataclass(frozen=True)
class StateReport:
    """State at one time. since_s: duration of the state. recoveries: number for each cause."""

    state: DaemonState
    reason: str
    since_s: float
    recoveries: Mapping[Cause, int]


class StateKeeper:
    """State of one daemon, initially STARTING. All times are in seconds, from the same clock.

    Only one thread may change the state and read notes. Any thread may read `state` and call
    `report`. ready_s: time of the first state that is in READY, or None.
    """

    def __init__(self, now_s: float) -> None:
        self.ready_s: float | None = None
        self._counts = dict.fromkeys(Cause, 0)
        self._notes: deque[Note] = deque(maxlen=NOTES_MAX)
        # State, reason and start time are one object, so other threads read consistent values.
        self._current = (DaemonState.STARTING, "", now_s)

    @property
    def state(self) -> DaemonState:
        """Current state."""
        return self._current[0]

    def enter(self, state: DaemonState, now_s: float, reason: str = "") -> bool:
        """Enter a state, or change the reason. Return whether the state has changed."""
        before, _, began_s = self._current
        is_new = state is not before
        self._current = (state, one_line(reason), now_s if is_new else began_s)
        if self.ready_s is None and state in READY:
            self.ready_s = now_s
        return is_new

    def recover(self, cause: Cause, now_s: float, reason: str = "") -> None:
        """Count a recovery. From a state in READY, change to RECOVERING."""
        self.count(cause, reason)
        if self.state in READY or self.state is DaemonState.RECOVERING:
            self.enter(DaemonState.RECOVERING, now_s, reason or cause.value)

    def count(self, cause: Cause, text: str = "") -> None:
        """Count a recovery without a change of state. text: description of the recovery."""
        self._counts[cause] += 1
        self._notes.append(Note(cause, one_line(text) or cause.value))

    def notes(self) -> list[Note]:
        """Return the recoveries since the last call, at most the latest NOTES_MAX."""
        notes, self._notes = self._notes, deque(maxlen=NOTES_MAX)
        return list(notes)

    def report(self, now_s: float) -> StateReport:
        """Return the state at `now_s`."""
        state, reason, began_s = self._current
        recoveries = MappingProxyType(self._counts.copy())
        return StateReport(state, reason, max(0.0, now_s - began_s), recoveries)
