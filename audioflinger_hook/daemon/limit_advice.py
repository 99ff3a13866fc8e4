"""Advice for the user if many samples of the vibration are limited at full scale."""

from collections import deque

from audioflinger_hook.config.settings import Settings

WINDOW_S = 60.0  # longest time over which the share of limited samples is computed
STEP_S = 5.0  # shortest time between two stored counts
KNOWN_S = 20.0  # shortest time over which the share is computed
SHARE = 0.01  # smallest share of limited samples that causes advice


class LimitAdvice:
    """Ratio of limited samples to frames in the latest minute. Any thread may call `advice`."""

    def __init__(self) -> None:
        self._counts: deque[tuple[float, int, int]] = deque()
        self._share = 0.0

    def update(self, limited: int, frames: int, now_s: float) -> None:
        """Store the counts of limited samples and of frames since the engine began."""
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
        """Return advice on what to lower, or "" if few samples are limited."""
        share = min(1.0, self._share)
        if share < SHARE:
            return ""
        found = f"{100.0 * share:.0f} % of the latest minute's vibration was limited at full scale"
        if settings.parameters.loudness_db > 0.0:
            target_db = settings.parameters.loudness_target_db
            return f"{found}; lower loudness_target_db, which is {target_db:g} dB"
        return f"{found}; lower the volume of the sound"
