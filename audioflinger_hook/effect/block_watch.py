"""Finds effects that keep the audio thread waiting, from another thread, and bypasses them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from audioflinger_hook.effect.module import EffectModule

BLOCKED_S, BLOCKED_LOOKS = 0.4, 4
"""A call that lasts this long, and is found in this many looks, blocks: a stream is lost at 0.5 s.
A process that was stopped or starved looks less often, so that no effect is bypassed for it."""

# An effect that is found at work in so many looks in a row takes nearly all of the time.
ALWAYS_LOOKS = 30
APART_S = 0.05  # looks that are closer together count once


@dataclass
class _Found:
    """An effect found at work in every look since `first_s`, in the same call since `since_s`."""

    first_s: float
    since_s: float
    latest_s: float
    calls: int
    looks: int = 1
    looks_at_call: int = 1


class BlockWatch:
    """Bypasses effects that wait, unlike `EffectModule`. For one thread that ticks."""

    def __init__(self) -> None:
        self._found: dict[int, _Found] = {}

    def look(self, effects: Iterable[EffectModule], now_s: float) -> None:
        """Look which effects are at work at `now_s` (s); bypass those that keep the thread."""
        for effect in effects:
            calls = effect.calls
            if not effect.inside or effect.bypassed:
                self._found.pop(id(effect), None)
                continue
            found = self._found.setdefault(id(effect), _Found(now_s, now_s, now_s, calls))
            if now_s - found.latest_s < APART_S:
                continue
            if calls != found.calls:
                found.calls, found.since_s, found.looks_at_call = calls, now_s, 0
            found.latest_s = now_s
            found.looks += 1
            found.looks_at_call += 1
            if now_s - found.since_s >= BLOCKED_S and found.looks_at_call >= BLOCKED_LOOKS:
                effect.give_up(f"kept the audio thread for over {BLOCKED_S:g} s in process")
            elif found.looks >= ALWAYS_LOOKS:
                effect.give_up(
                    "kept the audio thread in process at all times in the last "
                    f"{now_s - found.first_s:.0f} s"
                )
