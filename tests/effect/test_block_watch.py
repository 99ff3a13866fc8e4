"""Effects that keep the audio thread: found from another thread, whatever they wait for."""

import pytest

from audioflinger_hook.effect.interface import OK
from audioflinger_hook.effect.module import BlockWatch
from tests.support.effects import CYCLE_S, Probe, noise, running

TICK_S = 0.1


def watched(calls):
    """Play a buffer a call, at whose times the engine is looked at; named: what each look found."""
    probe, watch, named = Probe("Waiter"), BlockWatch(), []
    chains, module = running(probe)
    waiting = iter(calls)

    def wait(source, target):
        for now_s in next(waiting):
            watch.look([module], now_s)
            named.append(bool(chains.bypassed()))
        target.samples[:] = 9.0
        return OK

    probe.act = wait
    buffer = noise()
    for number in range(len(calls)):
        chains.process(0, buffer, number * CYCLE_S)
    return module, probe, buffer, named


def test_an_effect_that_does_not_return_is_bypassed_before_its_stream_is_lost():
    module, probe, buffer, named = watched([[n * TICK_S for n in range(5)]])
    assert named == [False, False, False, False, True], "named before it returns"
    assert module.bypassed == "kept the audio thread for over 0.4 s in process"
    assert (module.faults, buffer.samples.tobytes()) == (1, noise().samples.tobytes())
    probe.take()
    module.process(buffer, buffer)
    assert "process" not in probe.take()
    module.enable()
    module.update_state()
    assert module.bypassed == "", "it has another chance"


@pytest.mark.parametrize(
    ("calls", "reason"),
    [
        ([[n * TICK_S] for n in range(31)], "kept the audio thread in process at all times in"),
        # The whole process was stopped meanwhile: nobody is to blame.
        *(([[0.0, *later]], "") for later in ([60.0], [60.0 + n * 1e-3 for n in range(20)])),
    ],
)
def test_waiting_a_little_in_every_buffer_counts_and_a_stop_of_the_process_does_not(calls, reason):
    module, *_ = watched(calls)
    assert module.bypassed == (reason and f"{reason} the last 3 s")


def test_an_effect_found_at_work_now_and_then_goes_on():
    watch, probe = BlockWatch(), Probe("Busy")
    chains, module = running(probe)
    times = iter(range(1_000))

    def work(*_buffers):
        watch.look([module], next(times) * TICK_S)
        return OK

    probe.act = work
    for now in range(200):
        chains.process(0, noise(), now * CYCLE_S)
        if now % 5 == 4:
            work()
    assert module.bypassed == ""
