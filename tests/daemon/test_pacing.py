import os
import subprocess
import time

import pytest

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon.limit_advice import LimitAdvice
from audioflinger_hook.daemon.native.chain import has_realtime
from audioflinger_hook.daemon.pacing import BREATH_S, BURST, LATE_MAX_S, FrameTime, Pacer
from audioflinger_hook.daemon.status_report import worst_exposure
from audioflinger_hook.service.status import ExposureFigures
from tests.support.alsa_files import until

RATE_HZ = 48_000
BLOCK = 256


class Blocks:
    def __init__(self, frames: int = BLOCK, blocks: int | None = None) -> None:
        self.error: Exception | None = None
        self.done_s: list[float] = []
        self._played, self._frames, self._blocks = FrameTime(), frames, blocks

    @property
    def due_s(self) -> float:
        return self._played.after(self._frames, RATE_HZ)

    def run(self, now_s: float) -> bool:
        self.done_s.append(now_s)
        self._played.add(self._frames, RATE_HZ)
        return self._blocks is None or len(self.done_s) < self._blocks


def pacer(*jobs: Blocks, exact: bool = True) -> Pacer:
    """A pacer whose thread rests: the test is the clock."""
    made = Pacer(lambda: 0.0, exact=exact)
    made.close()
    for job in jobs:
        made.begin(job, 0.0)
    return made


def played(made: Pacer, until_s: float, late_s: float = 0.0) -> None:
    """Step whenever something is due, up to `until_s`, each time so much too late."""
    now_s = 0.0
    while now_s < until_s:
        now_s += made.step(now_s) + late_s


@pytest.mark.exhaustive
def test_a_day_of_blocks_ends_on_the_sample():
    clock, blocks = FrameTime(), 24 * 3_600 * 44_100 // BLOCK
    for _ in range(blocks):
        clock.add(BLOCK, 44_100)
    assert clock.after(0, 44_100) == blocks * BLOCK / 44_100
    clock.add(RATE_HZ, RATE_HZ)  # a change of rate begins a new count
    assert clock.after(RATE_HZ // 2, RATE_HZ) == blocks * BLOCK / 44_100 + 1.5


@pytest.mark.parametrize("late_s", [0.0, 0.003, 0.02])
def test_late_wakings_do_not_add_up(late_s):
    job = Blocks()
    played(pacer(job, exact=False), 60.0, late_s)
    lateness = [now_s - n * BLOCK / RATE_HZ for n, now_s in enumerate(job.done_s)]
    assert min(lateness) >= -1e-9
    assert max(lateness) <= late_s + BREATH_S + 1e-9
    assert abs(len(job.done_s) - 60.0 * RATE_HZ / BLOCK) < 6


def test_jobs_are_done_in_the_order_of_their_due_times_even_after_a_stall():
    order: list[tuple[float, int]] = []

    class Noted(Blocks):
        def run(self, now_s: float) -> bool:
            order.append((now_s, self._frames))
            return super().run(now_s)

    made = pacer(Noted(256), Noted(480), Noted(1_024))
    made.step(0.1)
    for _ in range(10):
        made.step(1.5)
    assert order == sorted(order, key=lambda done: done[0])
    assert len(order) > 200


def test_after_a_stall_all_is_made_up_for_in_bursts_and_nothing_is_left_out():
    job = Blocks()
    made, stall_s = pacer(job), 0.9 * LATE_MAX_S
    assert made.step(stall_s) == BREATH_S  # others have their turn
    assert len(job.done_s) == BURST
    for _ in range(10):
        made.step(stall_s)
    due = [n * BLOCK / RATE_HZ for n in range(len(job.done_s))]
    assert job.done_s == pytest.approx(due, abs=1e-9)
    assert due[-1] <= stall_s < due[-1] + BLOCK / RATE_HZ


def test_a_long_stall_is_a_pause_for_all_jobs_alike():
    one, other = Blocks(256), Blocks(960)
    made = pacer(one, other)
    played(made, 1.0)
    before = len(one.done_s), len(other.done_s)
    wait_s = made.step(1_000.0)
    assert len(one.done_s) - before[0] <= 2
    assert len(other.done_s) - before[1] <= 1
    assert 0.0 < wait_s <= 960 / RATE_HZ
    # their distance is what it was: the next due times differ by less than a block of each
    assert max(made.step(1_000.0 + 0.001 * n) for n in range(100)) <= 256 / RATE_HZ + 1e-9


def test_what_a_job_raises_ends_it_and_no_other():
    class Broken(Blocks):
        def run(self, now_s: float) -> bool:
            raise OSError("no more")

    bad, good = Broken(), Blocks(blocks=3)
    made = pacer(bad, good)
    played_to = made.step(1.0)
    assert isinstance(bad.error, OSError)
    assert not made.is_doing(bad)
    assert not made.is_doing(good)
    assert (len(good.done_s), played_to) == (3, float("inf"))


def test_its_thread_keeps_real_time_and_an_ended_job_rests_until_it_is_begun_again():
    job, made, began_s = Blocks(), Pacer(time.monotonic), time.monotonic()
    made.begin(job, began_s)
    until(lambda: len(job.done_s) >= 100, 30.0)
    assert job.done_s[99] - began_s >= 99 * BLOCK / RATE_HZ - 1e-6
    made.end(job)
    count = len(job.done_s)
    time.sleep(0.1)
    assert len(job.done_s) == count
    made.begin(job, time.monotonic())
    until(lambda: len(job.done_s) > count, 30.0)
    made.close()


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
