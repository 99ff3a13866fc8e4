"""The soft end and beginning of the Python engine when the native one takes over, or gives way.

A stream or chain that joins or leaves PipeWire's graph may cost others a cycle, so it does that
while both engines are silent.
"""

from __future__ import annotations

import math

from audioflinger_hook.daemon.soft_fade import SoftFade

HOLD_S = 0.03
"""Wait after a chain has left the graph: other streams of its devices then miss a cycle."""

DRAINED_S = 0.1
"""From the last sample of a fade until the device has played it."""

FADED_S = 0.5
"""Longest wait for a fade; a device may request no samples."""

SETTLES_S = 0.7
"""From the first buffer of new streams until they play evenly."""

OPENED_S = 0.04
"""From the moment at which both streams are open until they have joined the graph."""

DIP_S = 0.15
"""Longest silence of the native engine while streams open; a device may refuse them."""


class Handover:
    """When the Python engine fades in or out. For the supervising thread alone."""

    def __init__(self) -> None:
        self._moved_s: float | None = None
        self._began_s: float | None = None
        self._silent_s = math.inf
        self._holds = False

    @property
    def is_under_way(self) -> bool:
        """Whether the engine is being changed."""
        return self._moved_s is not None

    def begin_silent(self, now_s: float) -> None:
        """Note that the Python engine's next streams begin silent."""
        self._began_s = self._moved_s = now_s

    def has_settled(self, now_s: float) -> bool:
        """Whether streams that began silent play evenly by now."""
        return self._began_s is None or now_s - self._began_s > SETTLES_S

    def fade_out(self, fade: SoftFade, now_s: float) -> bool:
        """Fade out; return whether the device has played the end. Repeat it until then."""
        if fade.audible or self._moved_s is None:
            fade.audible, self._moved_s, self._silent_s = False, now_s, math.inf
        if fade.position == 0.0:
            self._silent_s = min(self._silent_s, now_s)
        return now_s - self._silent_s > DRAINED_S or now_s - self._moved_s > FADED_S

    def fade_in(self, fade: SoftFade, now_s: float) -> bool:
        """Fade in after HOLD_S; return whether the level is full. Repeat it until then."""
        if not self._holds:
            self._holds, self._moved_s = True, now_s
        since_s = now_s - (now_s if self._moved_s is None else self._moved_s)
        if since_s < HOLD_S:
            return False
        fade.audible = True
        return fade.position == 1.0 or since_s > FADED_S

    def reset(self) -> None:
        """End a change: the Python engine has its full level from now on."""
        self._moved_s = self._began_s = None
        self._holds = False


class Dip:
    """The native engine's silence while the Python engine's streams join the graph."""

    def __init__(self) -> None:
        self._began_s: float | None = None
        self._opened_s = math.inf

    @property
    def is_under_way(self) -> bool:
        """Whether the native engine is to be silent."""
        return self._began_s is not None

    def begin(self, now_s: float) -> None:
        """Begin, unless it is under way."""
        if self._began_s is None:
            self._began_s, self._opened_s = now_s, math.inf

    def note_open(self, now_s: float) -> None:
        """Note that both streams are open."""
        self._opened_s = min(self._opened_s, now_s)

    def is_over(self, now_s: float) -> bool:
        """Whether the streams have joined, or do not open."""
        began_s = math.inf if self._began_s is None else self._began_s
        return now_s - self._opened_s > OPENED_S or now_s - began_s > DIP_S

    def end(self) -> None:
        """End it; the native engine may play."""
        self._began_s = None
