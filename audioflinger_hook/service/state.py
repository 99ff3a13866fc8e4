"""What the daemon is doing, since when, why, and how often it had to recover from what."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType

from audioflinger_hook.service.one_line import one_line


class DaemonState(Enum):
    """Where the daemon stands; the values are what users see."""

    STARTING = "starting"
    """Reading its config, taking its lock."""
    WAITING_FOR_SERVER = "waiting-for-server"
    """No sound server answers; it is tried again and again."""
    WAITING_FOR_DEVICE = "waiting-for-device"
    """The device that was asked for is not there."""
    WAITING_FOR_SOUND_SOURCE = "waiting-for-sound-source"
    """There is no tap, or none that is allowed; the reason says which and why."""
    RUNNING = "running"
    """Sound comes in and vibration goes out."""
    IDLE = "idle"
    """All is in place, and there is silence."""
    RECOVERING = "recovering"
    """Something was lost or changed a moment ago and is being put right."""
    STOPPING = "stopping"
    """The last state."""

    @property
    def sound_must_flow(self) -> bool:
        """Whether no buffer for seconds means that the daemon hangs."""
        return self is DaemonState.RUNNING


class Cause(Enum):
    """What a recovery was from; the values are what users see."""

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
    """The machine had slept."""


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
"""The states that may follow each one. Only what played recovers, and nothing follows the end."""


NOTES_MAX = 32
"""Notes kept until somebody asks for them; older ones go."""


@dataclass(frozen=True)
class Note:
    """One recovery. text: what happened, one line."""

    cause: Cause
    text: str


@dataclass(frozen=True)
class StateReport:
    """One consistent picture.

    reason: one line, may be empty. since_s: how long the state has lasted. spent_s: how long the
    daemon has been in each state in all. recoveries: how many there were, for every cause.
    """

    state: DaemonState
    reason: str
    since_s: float
    spent_s: Mapping[DaemonState, float]
    recoveries: Mapping[Cause, int]


class StateKeeper:
    """The state of one daemon, from STARTING at `now_s` on.

    One thread calls `enter`, `recover`, `count` and `notes`; any thread may call `report` at any
    time.
    Times are seconds of one clock; one that runs backwards counts as standing still. The memory
    used does not grow.
    """

    def __init__(self, now_s: float) -> None:
        self._counts = dict.fromkeys(Cause, 0)
        self._notes: deque[Note] = deque(maxlen=NOTES_MAX)
        # State, reason, start, time spent in earlier states: replaced as one, so that who reads
        # meanwhile sees one picture or the other. Never changed in place.
        self._current = (DaemonState.STARTING, "", now_s, dict.fromkeys(DaemonState, 0.0))

    @property
    def state(self) -> DaemonState:
        """The state now."""
        return self._current[0]

    def enter(self, state: DaemonState, now_s: float, reason: str = "") -> bool:
        """Enter a state, or give the present one another reason; return whether it is another.

        A state that goes on keeps its start. To recover takes a cause: `recover`.

        Raises
        ------
        ValueError
            The state may not follow the present one, or there is no reason where one is due.
        """
        if state is DaemonState.RECOVERING:
            raise ValueError("to recover takes a cause; call recover()")
        return self._enter(state, now_s, reason)

    def recover(self, cause: Cause, now_s: float, reason: str = "") -> bool:
        """Count a cause and enter RECOVERING, or stay there; return whether it is another state.

        What has not begun to play, or is ending, has nothing to recover: it is only counted.
        """
        self.count(cause, reason)
        if self.state not in PLAYING | {DaemonState.RECOVERING}:
            return False
        return self._enter(DaemonState.RECOVERING, now_s, reason or cause.value)

    def count(self, cause: Cause, text: str = "") -> None:
        """Count a recovery that was over at once; text: what happened."""
        self._counts[cause] += 1
        self._notes.append(Note(cause, one_line(text) or cause.value))

    def notes(self) -> list[Note]:
        """Return what was counted since the last call, NOTES_MAX of it at most."""
        notes = list(self._notes)
        self._notes.clear()
        return notes

    def report(self, now_s: float) -> StateReport:
        """Return the picture at `now_s`."""
        state, reason, began_s, earlier_s = self._current
        lasted_s = max(0.0, now_s - began_s)
        spent_s = earlier_s | {state: earlier_s[state] + lasted_s}
        return StateReport(
            state,
            reason,
            lasted_s,
            MappingProxyType(spent_s),
            MappingProxyType(self._counts.copy()),
        )

    def _enter(self, state: DaemonState, now_s: float, reason: str) -> bool:
        before, _, began_s, earlier_s = self._current
        if state is not before and state not in ALLOWED[before]:
            raise ValueError(f"{state.value} may not follow {before.value}")
        if state is DaemonState.WAITING_FOR_SOUND_SOURCE and not reason.strip():
            raise ValueError(f"{state.value} takes a reason")
        if state is before:
            self._current = (state, one_line(reason), began_s, earlier_s)
            return False
        spent_s = earlier_s | {before: earlier_s[before] + max(0.0, now_s - began_s)}
        self._current = (state, one_line(reason), now_s, spent_s)
        return True
