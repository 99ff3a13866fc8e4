"""The soft end and beginning of the Python engine when the native one takes over, or gives way.

Its level moves in steps, each within one buffer, so that nothing clicks.
"""

from __future__ import annotations

from dataclasses import replace

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon.engine import Engine
from device.drive.settings import GAIN_MIN_DB
from device.units import amplitude_to_db

STEPS = 12
"""Steps from full level to silence. Each takes a twelfth: at full scale a step of one buffer leaves
-52 dB above 250 Hz."""

STEPS_DB = (*(amplitude_to_db(1.0 - step / STEPS) for step in range(STEPS)), GAIN_MIN_DB)
"""Levels on the way down."""

STEP_S = 0.02
"""Time between two steps."""

HOLD_S = 0.05
"""Wait after a chain has left the graph: other streams of its devices then miss a cycle."""

DRAINED_S = 0.15
"""From the last step down until it has passed the delay line."""

SETTLES_S = 0.7
"""From the first buffer of new streams until they play evenly."""


class Handover:
    """The level of the Python engine during a change of engine. For the supervising thread alone.

    level_db: relative to the configured level.
    """

    def __init__(self) -> None:
        self.level_db = 0.0
        self._step = 0
        self._moved_s: float | None = None
        self._began_s: float | None = None

    @property
    def is_under_way(self) -> bool:
        """Whether the engine is being changed."""
        return self._moved_s is not None

    def begin_silent(self, now_s: float) -> None:
        """Let the Python engine's next streams begin silent."""
        self._step, self._began_s, self._moved_s = len(STEPS_DB) - 1, now_s, now_s
        self.level_db = GAIN_MIN_DB

    def hold(self, now_s: float) -> None:
        """Let the next step wait for HOLD_S."""
        self._moved_s = now_s + HOLD_S - STEP_S

    def has_settled(self, now_s: float) -> bool:
        """Whether streams that began silent play evenly by now."""
        return self._began_s is None or now_s - self._began_s > SETTLES_S

    def settings(self, settings: Settings) -> Settings:
        """Return settings at the present level."""
        gain_db = max(GAIN_MIN_DB, settings.gain_db + self.level_db)
        return settings if self.level_db == 0.0 else replace(settings, gain_db=gain_db)

    def move(
        self, engine: Engine, settings: Settings, offset_s: float, now_s: float, *, down: bool
    ) -> bool:
        """Make the next step if it is due; return whether the last one has taken effect."""
        since_s = STEP_S if self._moved_s is None else now_s - self._moved_s
        wanted = len(STEPS_DB) - 1 if down else 0
        if self._step == wanted:
            return since_s >= (DRAINED_S if down else STEP_S)
        if since_s >= STEP_S:
            self._step += 1 if down else -1
            self.level_db, self._moved_s = STEPS_DB[self._step], now_s
            engine.follow(self.settings(settings), offset_s)
        return False

    def reset(self) -> None:
        """End a change: the Python engine has its full level from now on."""
        self.level_db, self._step, self._moved_s, self._began_s = 0.0, 0, None, None
