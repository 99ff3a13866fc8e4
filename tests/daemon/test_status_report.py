"""What the status says of several actuators, of much limiting and of missing priority."""

import os
import subprocess

import pytest

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon.limit_advice import LimitAdvice
from audioflinger_hook.daemon.native.chain import has_realtime
from audioflinger_hook.daemon.status_report import worst_exposure
from audioflinger_hook.service.status import ExposureFigures

RATE_HZ = 48_000


def test_each_reading_of_the_exposure_is_of_the_actuator_where_it_is_worst():
    assert worst_exposure([]) is None
    hum = ExposureFigures(20.0, 0.5, 0.6, 1.54, True, False, 0.2, True, "limit", 1.0)
    knock = ExposureFigures(19.0, 2.0, 0.1, 21.5, True, True, 0.9, False, "action", 0.4)
    for order in ([hum, knock], [knock, hum]):
        worst = worst_exposure(order)
        assert worst == ExposureFigures(20.0, 2.0, 0.6, 21.5, True, True, 0.2, True, "action", 0.4)


def advice(counts, profile="cinema"):
    """The advice after (limited, all) seconds of samples at each second."""
    limits = LimitAdvice()
    for second, (limited, played) in enumerate(counts):
        limits.update(int(limited * RATE_HZ), played * RATE_HZ, float(second))
    return limits.advice(Settings(profile=profile))


def test_much_limiting_leads_to_advice_that_names_the_loudness_or_else_the_volume():
    much = [(0.05 * second, second) for second in range(91)]
    assert advice(much) == (
        "5 % of the latest minute's vibration was limited at full scale; "
        "lower loudness_target_db, which is -24 dB"
    )
    assert advice(much, "paper").endswith("lower the volume of the sound")
    # of little limiting, of an old one and of one of another engine, which counts from 0, nothing
    assert advice((0.005 * second, second) for second in range(91)) == ""
    assert advice((min(second, 60), second) for second in range(200)) == ""
    assert advice([*((n, n) for n in range(30)), *((0, n) for n in range(20))]) == ""


def test_a_process_has_real_time_priority_once_one_of_its_threads_has_it():
    with subprocess.Popen(["sleep", "60"]) as process:
        try:
            assert not has_realtime(process.pid)
            try:
                os.sched_setscheduler(process.pid, os.SCHED_RR, os.sched_param(1))
            except PermissionError:
                pytest.skip("this user may not give real-time priority")
            assert has_realtime(process.pid)
        finally:
            process.kill()
    assert not has_realtime(process.pid)  # it has ended
