"""The daemon's state, its start and reason, and counts of recoveries by cause."""

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
    """Something was lost or has changed, and is being reopened."""
    STOPPING = "stopping"
    """The last state."""

    @property
    def sound_must_flow(self) -> bool:
        """Whether the daemon hangs if it gets no buffer for seconds."""
        return self is DaemonState.RUNNING


class Cause(Enum):
    """Causes of recoveries; users see the values."""

    SERVER_LOST = "server-lost"
    DEVICE_LOST = "device-lost"
    DEVICE_MOVED = "device-moved"
    TAP_LOST = "tap-lost"
    TAP_MOVED = "tap-moved"
    DEFAULT_CHANGED = "default-changed"
    FORMAT_CHANGED = "format-changed"
    STALL = "stall"
    RESYNC = "resync"
    RESUMED = "resumed"
    """The machine was suspended."""


WAITING = frozenset(
    (
        DaemonState.WAITING_FOR_SERVER,
        DaemonState.WAITING_FOR_DEVICE,
        DaemonState.WAITING_FOR_SOUND_SOURCE,
    )
)
PLAYING = frozenset((DaemonState.RUNNING, DaemonState.IDLE))

ALLOWED: Mapping[DaemonState, frozenset[DaemonState]] = MappingProxyType(
    {
        DaemonState.STARTING: WAITING | PLAYING | {DaemonState.STOPPING},
        **dict.fromkeys(WAITING, WAITING | PLAYING | {DaemonState.STOPPING}),
        **dict.fromkeys(
            PLAYING, WAITING | PLAYING | {DaemonState.RECOVERING, DaemonState.STOPPING}
        ),
        DaemonState.RECOVERING: WAITING | PLAYING | {DaemonState.RECOVERING, DaemonState.STOPPING},
        DaemonState.STOPPING: frozenset({DaemonState.STOPPING}),
    }
)
"""The states that may follow each state. Only a daemon that played can recover."""


NOTES_MAX = 32
"""Notes kept until they are read; older ones are dropped."""


@dataclass(frozen=True)
class Note:
    """One recovery: its cause, and one line of text."""

    cause: Cause
    text: str


@dataclass(frozen=True)
class StateReport:
    """One consistent picture: the state, why and for how long, and recoveries by cause."""

    state: DaemonState
    reason: str
    since_s: float
    recoveries: Mapping[Cause, int]


class StateKeeper:
    """The state of one daemon, which starts with STARTING at `now_s`.

    One thread changes it and takes the notes; any thread may call `report`. Times are seconds of
    one clock; if that runs backwards, it counts as standing still. Its size is constant.
    """

    def __init__(self, now_s: float) -> None:
        self._counts = dict.fromkeys(Cause, 0)
        self._notes: deque[Note] = deque(maxlen=NOTES_MAX)
        # State, reason and start are replaced as one object, so a reader sees one picture.
        self._current = (DaemonState.STARTING, "", now_s)

    @property
    def state(self) -> DaemonState:
        """The current state."""
        return self._current[0]

    def enter(self, state: DaemonState, now_s: float, reason: str = "") -> bool:
        """Enter a state, or change the reason of the current one; return whether it is new.

        Raises
        ------
        ValueError
            The state may not follow the current one, or lacks its reason.
        """
        if state is DaemonState.RECOVERING:
            raise ValueError("to recover takes a cause; call recover()")
        return self._enter(state, now_s, reason)

    def recover(self, cause: Cause, now_s: float, reason: str = "") -> bool:
        """Count a cause and enter or keep RECOVERING; return whether that is new.

        A daemon that does not play yet, or is stopping, only counts.
        """
        self.count(cause, reason)
        if self.state not in PLAYING | {DaemonState.RECOVERING}:
            return False
        return self._enter(DaemonState.RECOVERING, now_s, reason or cause.value)

    def count(self, cause: Cause, text: str = "") -> None:
        """Count a recovery that is complete already; text: what happened."""
        self._counts[cause] += 1
        self._notes.append(Note(cause, one_line(text) or cause.value))

    def notes(self) -> list[Note]:
        """Return what was counted since the last call, the latest NOTES_MAX of it."""
        notes = list(self._notes)
        self._notes.clear()
        return notes

    def report(self, now_s: float) -> StateReport:
        """Return the picture at `now_s`."""
        state, reason, began_s = self._current
        recoveries = MappingProxyType(self._counts.copy())
        return StateReport(state, reason, max(0.0, now_s - began_s), recoveries)

    def _enter(self, state: DaemonState, now_s: float, reason: str) -> bool:
        before, _, began_s = self._current
        if state is not before and state not in ALLOWED[before]:
            raise ValueError(f"{state.value} may not follow {before.value}")
        if state is DaemonState.WAITING_FOR_SOUND_SOURCE and not reason.strip():
            raise ValueError(f"{state.value} takes a reason")
        is_new = state is not before
        self._current = (state, one_line(reason), now_s if is_new else began_s)
        return is_new
