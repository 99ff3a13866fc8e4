"""Much limiting leads to advice; a moment of it does not."""

from __future__ import annotations

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon.limit_advice import LimitAdvice

RATE_HZ = 48_000


def advice(share: float, seconds: int, settings: Settings | None = None) -> str:
    """The advice after so long with this share of samples limited."""
    limits = LimitAdvice()
    for second in range(seconds + 1):
        limits.update(int(share * second * RATE_HZ), second * RATE_HZ, float(second))
    return limits.advice(settings or Settings(profile="cinema"))


def test_where_loudness_is_followed_its_target_is_named_with_its_value() -> None:
    assert advice(0.05, 90) == (
        "5 % of the latest minute's vibration was limited at full scale; "
        "lower loudness_target_db, which is -24 dB"
    )


def test_without_loudness_the_volume_is_named() -> None:
    assert advice(0.05, 90, Settings(profile="paper")).endswith("lower the volume of what plays")


def test_little_limiting_or_an_old_one_is_left_alone() -> None:
    assert advice(0.005, 90) == ""
    limits = LimitAdvice()
    for second in range(200):
        limits.update(min(second, 60) * RATE_HZ, second * RATE_HZ, float(second))
    assert limits.advice(Settings()) == ""


def test_another_engine_that_counts_from_zero_starts_a_new_minute() -> None:
    limits = LimitAdvice()
    for second in range(30):
        limits.update(second * RATE_HZ, second * RATE_HZ, float(second))
    for second in range(30, 50):
        limits.update(0, (second - 30) * RATE_HZ, float(second))
    assert limits.advice(Settings()) == ""
