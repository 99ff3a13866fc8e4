"""Chooses the offset: how much later the vibration plays, so that sound and vibration coincide.

A trial has priority, then a number in the config, then a stored measurement of these two sinks. The
last choice are the delays that the sinks declare. In drop-in mode, the sound can be delayed too.
"""

from typing import NamedTuple

from audioflinger_hook.daemon.offset_store import OffsetStore, SinkPair
from audioflinger_hook.daemon.run_config import RunConfig
from device.errors import UsageError
from device.server.forwarding import MAX_DELAY_S, MIN_DELAY_S

DECLARED, MEASURED = "declared by the sink", "measured by cushion sync"
SET, UNKNOWN = "set in the config", "not known"

FOLLOWED_S = 0.005  # smaller changes of a delay are not followed
LONGEST_S = 2.0  # longest delay that is believed and played
TRIAL_S = 30.0  # a trial that is not repeated ends after this time, as its program was killed

# In drop-in mode, every change of the sound's delay is heard. The sound is therefore delayed a
# little more than necessary, and the vibration makes up for later changes.
SPARE_S, SPARE_MAX_S = 0.01, 0.04


class Declared(NamedTuple):
    """Delays that sinks declare, in seconds. heard_s: of the sound. felt_s: of the vibration.

    is_known: whether the sink of the sound declares a delay. forwarded_s: part of heard_s that
    drop-in mode's own delay contains.
    """

    heard_s: float = 0.0
    felt_s: float = 0.0
    is_known: bool = False
    forwarded_s: float = 0.0


class Offset:
    """The delays of vibration and sound. Only the main thread may call the methods.

    vibration_s: delay of the vibration, 0 to LONGEST_S. sound_s: delay of the sound in drop-in
    mode, else 0. reason: DECLARED, MEASURED, SET or UNKNOWN.
    """

    def __init__(self, config: RunConfig, store: OffsetStore) -> None:
        self._store = store
        self._pair: SinkPair | None = None
        self._own_s: float | None = None
        self._declared = Declared()
        self._behind_s = 0.0
        self._behind_of: tuple[object, ...] = ()
        self._delay_s = 0.0
        self._trial_s: float | None = None
        self._trial_ends_s: float | None = None
        self._found = UNKNOWN
        self.vibration_s = self.sound_s = 0.0
        self.follow(config)

    @property
    def reason(self) -> str:
        """Where the offset comes from. A trial does not change it."""
        return self._found if self._live.offset_s is None else SET

    def follow(self, config: RunConfig) -> None:
        """Apply another config."""
        self._live = config.live
        self._choose()

    def try_out(self, offset_s: float | None) -> None:
        """Play an offset until the next call, for at most TRIAL_S. None ends the trial."""
        self._trial_s, self._trial_ends_s = offset_s, None
        self._choose()

    def store(self, offset_s: float) -> None:
        """Store an offset for the present pair of sinks, and use it.

        UsageError: there is no pair, or no engine plays. WriteError: the file cannot be written.
        """
        if self._pair is None or self._own_s is None:
            raise UsageError(
                "the delay cannot be stored: it needs a sound that plays, a tap of a sink, and a "
                "device that plays the vibration"
            )
        sound_s = max(MIN_DELAY_S, -offset_s) if self._live.drop_in else 0.0
        delay_s = max(0.0, offset_s) + self._own_s - self._added_s(sound_s)
        self._trial_s = self._trial_ends_s = None
        try:
            self._store.store(self._pair, delay_s)
        finally:
            self._find()

    def update(
        self, pair: SinkPair | None, declared: Declared, own_s: float | None, now_s: float
    ) -> None:
        """Follow the pair of sinks, their declared delays and the daemon's own latency in seconds.

        own_s: latency without the offset; None while no engine plays, which keeps the offset.
        """
        self._pair, self._declared = pair, declared
        self._own_s = own_s
        if self._trial_s is not None:
            self._trial_ends_s = self._trial_ends_s or now_s + TRIAL_S
            if now_s > self._trial_ends_s:
                self._trial_s = self._trial_ends_s = None
        self._find()

    def of_trial(self, own_s: float, transform_s: float) -> tuple[float, float]:
        """Return how much later vibration than sound begins in a stream of both, and is felt.

        own_s: latency of the vibration after the stream. transform_s: latency of the transform,
        which the stream avoids; a number in the config takes it for granted.
        """
        set_s, later_s = self._live.offset_s, own_s + self.vibration_s
        wanted_s = self._delay_s if set_s is None else set_s + transform_s + own_s
        return wanted_s - later_s, later_s + self._declared.felt_s

    def _find(self) -> None:
        """Find how far the vibration is behind its sound, apart from the offset."""
        measured_s = self._store.delay_s(self._pair) if self._pair else None
        delay_s = self._declared.heard_s - self._declared.felt_s
        self._found = DECLARED if self._declared.is_known else UNKNOWN
        if measured_s is not None:
            self._found, delay_s = MEASURED, measured_s
        self._delay_s = delay_s
        if self._own_s is not None:
            behind_s, known = self._own_s - delay_s, (self._pair, self._found, measured_s)
            if self._behind_of != known or abs(behind_s - self._behind_s) > FOLLOWED_S:
                self._behind_s, self._behind_of = behind_s, known
        self._choose()

    def _choose(self) -> None:
        offset_s = self._live.offset_s if self._trial_s is None else self._trial_s
        if offset_s is not None:
            self.vibration_s, self.sound_s = max(0.0, offset_s), max(0.0, -offset_s)
            return
        if not self._live.drop_in:
            self.sound_s = 0.0
        elif self._behind_of and not 0.0 <= self._early_s <= SPARE_MAX_S:
            wanted_s = self._declared.forwarded_s + self._behind_s + SPARE_S
            self.sound_s = max(MIN_DELAY_S, min(MAX_DELAY_S, wanted_s))
        self.vibration_s = max(0.0, min(LONGEST_S, self._early_s))

    @property
    def _early_s(self) -> float:
        """By how much the vibration is before its sound, apart from `vibration_s`."""
        return self._added_s(self.sound_s) - self._behind_s

    def _added_s(self, sound_s: float) -> float:
        """Return how much later the sound is heard if drop-in mode delays it by sound_s."""
        return max(0.0, sound_s - self._declared.forwarded_s) if sound_s else 0.0
