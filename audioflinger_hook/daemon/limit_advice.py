"""Advice when much of the vibration is limited at full scale."""

from __future__ import annotations

from collections import deque

from audioflinger_hook.config.settings import Settings

WINDOW_S = 60.0
STEP_S = 5.0  # between counts
KNOWN_S = 20.0  # a share of less time says nothing of the setting
SHARE = 0.01  # of the samples, from which limiting is felt as flat peaks


class LimitAdvice:
    """Counts the limited samples of the latest minute. One thread updates it, any may ask."""

    def __init__(self) -> None:
        self._counts: deque[tuple[float, int, int]] = deque()
        self._share = 0.0

    def update(self, limited: int, frames: int, now_s: float) -> None:
        """Note both counts, which start again from 0 with another engine."""
        counts = self._counts
        if counts and (limited < counts[-1][1] or frames < counts[-1][2]):
            counts.clear()
        if not counts or now_s - counts[-1][0] >= STEP_S:
            counts.append((now_s, limited, frames))
            while now_s - counts[0][0] > WINDOW_S:
                counts.popleft()
            heard = frames - counts[0][2]
            known = heard > 0 and now_s - counts[0][0] >= KNOWN_S
            self._share = (limited - counts[0][1]) / heard if known else 0.0

    def advice(self, settings: Settings) -> str:
        """Return which setting to lower, "" while little is limited."""
        share = min(1.0, self._share)
        if share < SHARE:
            return ""
        found = f"{100.0 * share:.0f} % of the latest minute's vibration was limited at full scale"
        parameters = settings.parameters
        if parameters.loudness_db > 0.0:
            return (
                f"{found}; lower loudness_target_db, which is {parameters.loudness_target_db:g} dB"
            )
        return f"{found}; lower the volume of what plays"
