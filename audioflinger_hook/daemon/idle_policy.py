"""When nothing plays, nothing needs to run: the rule for resting and for waking."""

from __future__ import annotations

QUIET_S = 5.0
"""After silence of this length, if no application plays: none can sound without a new event."""

SILENT_S = 10.0
"""After silence of this length although an application plays: its sound may come at any moment,
and waking up costs it its first tenths of a second."""

AWAKE_S = 8.0
"""For so long at least it stays awake: an application may open its stream well before it plays."""


class IdlePolicy:
    """Whether to rest. Pure: time and what is heard come in. For the supervising thread.

    resting: the decision at present.
    """

    def __init__(self, now_s: float) -> None:
        self.resting = False
        self._woke_s = now_s
        self._players: frozenset[int] = frozenset()

    def update(
        self, now_s: float, players: frozenset[int], last_sound_s: float, *, heard: bool
    ) -> bool:
        """Return whether to rest.

        players: indexes of the streams that may sound at any moment; last_sound_s: when sound was
        heard last, while awake; heard: whether sound was heard while resting.
        """
        came = bool(players - self._players)
        self._players = players
        if came or (self.resting and heard):
            self.resting = False
            self._woke_s = now_s
        elif not self.resting and now_s - self._woke_s > AWAKE_S:
            self.resting = now_s - last_sound_s > (SILENT_S if players else QUIET_S)
        return self.resting

    def awake(self, now_s: float) -> None:
        """Be awake: something changed that the streams have to follow."""
        self.resting = False
        self._woke_s = now_s
