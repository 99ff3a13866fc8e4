import os
import signal
import subprocess
import sys
import time
from contextlib import closing, suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from device.units import Float32Array
from tests.servers import witness
from tests.servers.daemons import tone
from tests.servers.listening import RATE_HZ
from tools.live_latency.bursts import BurstDelays, burst_sound, onsets
from tools.live_latency.pauses import LEAST_S, NAP_S, Pause, PauseWitness, common, undisturbed


def test_what_one_core_did_not_notice_is_no_pause_of_the_machine() -> None:
    busy, still = Pause(1.0, 1.5), Pause(2.0, 2.03)
    seen = common([[busy, still], [Pause(1.998, 2.028)]])
    assert seen == (Pause(2.0, 2.028),)
    assert seen[0].seconds == pytest.approx(0.028)
    apart = [[Pause(5.0, 5.0 + LEAST_S)], [Pause(5.0 + NAP_S, 5.0 + NAP_S + LEAST_S)]]
    assert len(common(apart)) == 1  # cores may notice one a nap apart
    assert common([[Pause(0.0, 0.02)], [Pause(0.016, 0.04)]]) == ()
    assert common([]) == common([[], []]) == ()


@given(st.lists(st.floats(0.0, 100.0), max_size=8), st.floats(0.0, 5.0))
def test_times_are_left_out_until_a_pause_is_over(starts_s: list[float], recovers_s: float) -> None:
    pauses = [Pause(start_s, start_s + 0.02) for start_s in starts_s]
    times_s = np.linspace(-1.0, 110.0, 1_111)
    for time_s, is_clear in zip(times_s, undisturbed(times_s, pauses, recovers_s), strict=True):
        assert is_clear != any(one.start_s <= time_s <= one.end_s + recovers_s for one in pauses)


def test_the_witness_watches_every_core_and_ends_when_it_is_closed() -> None:
    with closing(PauseWitness()) as witness:
        processes = list(witness._processes)
        assert len(processes) == len(os.sched_getaffinity(0))
        began_s = time.monotonic()
        for pause in witness.pauses():
            assert pause.seconds >= LEAST_S - NAP_S
            assert pause.end_s > began_s - 1.0
    assert all(process.returncode is not None for process in processes)
    witness.pauses()  # also after the end


def test_processes_that_were_stopped_look_like_a_machine_that_stood_still() -> None:
    with closing(PauseWitness()) as witness:
        pids = [process.pid for process in witness._processes]
        stopped_s = time.monotonic()
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)
        while (continued_s := time.monotonic()) < stopped_s + 0.1:
            pass
        for pid in pids:
            os.kill(pid, signal.SIGCONT)
        deadline_s = time.monotonic() + 5.0
        while not (found := [one for one in witness.pauses() if one.end_s >= continued_s]):
            assert time.monotonic() < deadline_s
        now_s = time.monotonic()  # a busy machine lets them go on later
    assert found[0].start_s < continued_s - 0.05  # a busy machine stops them later
    assert found[0].end_s < now_s


def test_one_core_that_is_taken_away_is_a_pause_only_of_that_core() -> None:
    with closing(PauseWitness()) as witness:
        if len(witness._processes) < 2:
            pytest.skip("there is one core")
        pid, stopped_s = witness._processes[0].pid, time.monotonic()
        os.kill(pid, signal.SIGSTOP)
        while time.monotonic() < stopped_s + 0.1:
            pass
        os.kill(pid, signal.SIGCONT)
        deadline_s = time.monotonic() + 5.0
        while not any(one.seconds >= 0.05 for one in witness._seen[0]):
            witness.pauses()
            assert time.monotonic() < deadline_s
        assert [one for one in witness.pauses() if one.seconds > 0.05] == []
        parts = [one for one in witness.core_pauses() if one.seconds > 0.05]
        assert parts if witness.first else parts == []
        starts_s = [one.start_s for one in witness.core_pauses()]
        assert starts_s == sorted(starts_s)


@pytest.mark.exhaustive
def test_who_is_killed_leaves_no_witness_behind() -> None:
    watches = (
        "from tools.live_latency.pauses import PauseWitness\n"
        "witness = PauseWitness()\n"
        "print(*(process.pid for process in witness._processes), flush=True)\n"
        "input()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", watches], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        pids = process.stdout.readline().split()
        process.kill()
    assert pids
    deadline_s = time.monotonic() + 5.0
    for pid in pids:
        with suppress(OSError):  # it is gone altogether
            while Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX":
                assert time.monotonic() < deadline_s


def without_a_cycle(at: int, frames: int) -> Float32Array:
    whole = tone(110.0, 4.0)
    return np.concatenate([whole[:at], whole[at + frames :]])


def test_a_lost_cycle_tears_a_tone_and_counts_only_while_something_is_felt():
    whole = tone(110.0, 4.0)
    assert witness.tears(whole) == 0
    assert witness.above_250_hz(whole).max() < witness.CLICK_DB - 10.0
    assert not witness.silent_blocks(whole).any()
    for frames in (128, 256, 1_024):
        assert witness.tears(without_a_cycle(2 * RATE_HZ, frames)) > 0
    torn, felt = without_a_cycle(2 * RATE_HZ, 256), tone(110.0, 4.0)
    assert witness.tears(torn, felt) > 0
    felt[2 * RATE_HZ : 2 * RATE_HZ + RATE_HZ // 10] = 0.0
    assert witness.tears(torn, felt) == 0
    assert witness.tears(without_a_cycle(RATE_HZ, 256), felt) > 0


def test_a_second_failed_attempt_fails_and_does_not_count_but_skips_where_the_witness_was_torn():
    verdict = witness.Verdict("step")
    assert not verdict.add(1, good=True, witness_torn=False)
    assert not verdict.add(2, good=False, witness_torn=True)
    assert not verdict.add(3, good=False, witness_torn=False)
    with pytest.raises(AssertionError, match="step, after 1 clean attempts: 4"):
        verdict.add(4, good=False, witness_torn=False)
    verdict = witness.Verdict("step")
    assert [verdict.add(n, good=True, witness_torn=n > 1) for n in range(witness.CLEAN)][-1]
    verdict = witness.Verdict("step")
    for attempt in range(witness.EXCUSED - 1):
        assert not verdict.add(attempt, good=False, witness_torn=True)
    with pytest.raises(pytest.skip.Exception, match="too busy"):
        verdict.add(witness.EXCUSED, good=False, witness_torn=True)


def test_a_known_delay_is_found_to_the_sample():
    sound = burst_sound(9, RATE_HZ)
    assert len(onsets(sound, RATE_HZ)) == 9
    for delay in (0, 480, 2_400):
        felt = np.concatenate([np.zeros(delay), sound[: len(sound) - delay]])
        found = BurstDelays.of(sound, felt, RATE_HZ)
        assert found.half_ms.size == 9
        # the first sample of a cosine is its peak
        assert found.tenth_ms == pytest.approx(1e3 * delay / RATE_HZ)
        assert found.half_ms == pytest.approx(1e3 * delay / RATE_HZ)
