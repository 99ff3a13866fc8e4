"""When the streams rest because nothing plays, and when they wake."""

from __future__ import annotations

QUIET_S = 5.0
"""Silence before resting if no application plays; a new one causes an event."""

SILENT_S = 10.0
"""Silence before resting although an application plays. Its sound may begin without an event, and
waking up then costs its first tenths of a second."""

AWAKE_S = 8.0
"""Shortest time awake, as applications may open a stream some time before they play."""


class IdlePolicy:
    """Decides whether the streams rest; pure. resting: the current decision."""

    def __init__(self, now_s: float) -> None:
        self.resting = False
        self._woke_s = now_s
        self._players: frozenset[int] = frozenset()

    def update(
        self, now_s: float, players: frozenset[int], last_sound_s: float, *, heard: bool
    ) -> bool:
        """Return whether to rest.

        players: indexes of streams that may play; last_sound_s: time of the latest sound while
        awake; heard: whether sound was noticed while resting.
        """
        came = bool(players - self._players)
        self._players = players
        if came or (self.resting and heard):
            self.resting = False
            self._woke_s = now_s
        elif not self.resting and now_s - self._woke_s > AWAKE_S:
            self.resting = now_s - last_sound_s > (SILENT_S if players else QUIET_S)
        return self.resting

    def wake(self, now_s: float) -> None:
        """Wake, because something has changed that concerns the streams."""
        self.resting = False
        self._woke_s = now_s
