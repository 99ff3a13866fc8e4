"""Effects that keep the audio thread: found from another thread, whatever they wait for."""

from __future__ import annotations

from audioflinger_hook.effect.interface import OK
from audioflinger_hook.effect.module import BlockWatch
from tests.support.effects import CYCLE_S, Probe, noise, running

TICK_S = 0.1


def during_calls(looks, calls):
    """A module whose engine is looked at during each call: the list `looks` has the times."""
    probe, watch = Probe("Waiter"), BlockWatch()
    chains, module = running(probe)
    times = iter(looks)

    def wait(source, target):
        for _ in range(len(looks) // calls):
            watch.look([module], next(times))
        target.samples[:] = 9.0
        return OK

    probe.act = wait
    buffer = noise()
    for now in range(calls):
        chains.process(0, buffer, now * CYCLE_S)
    return module, buffer, probe


def test_an_effect_that_does_not_return_is_bypassed_before_its_stream_is_lost():
    module, buffer, probe = during_calls([n * TICK_S for n in range(5)], calls=1)
    assert module.bypassed == "kept the audio thread for over 0.4 s in process"
    assert (module.faults, buffer.samples.tobytes()) == (1, noise().samples.tobytes())
    probe.take()
    module.process(buffer, buffer)
    assert "process" not in probe.take()


def test_an_effect_that_has_not_returned_yet_is_named_already():
    probe, watch, named = Probe("Waiter"), BlockWatch(), []
    chains, module = running(probe)

    def wait(source, target):
        for n in range(5):
            watch.look([module], n * TICK_S)
            named.append(bool(chains.bypassed()))
        return OK

    probe.act = wait
    chains.process(0, noise(), 0.0)
    assert named == [False, False, False, False, True]


def test_an_effect_that_waits_a_little_in_every_buffer_is_bypassed_too():
    module, _, _ = during_calls([n * TICK_S for n in range(31)], calls=31)
    assert module.bypassed == "kept the audio thread in process at all times in the last 3 s"


def test_an_effect_found_at_work_now_and_then_goes_on():
    watch, probe = BlockWatch(), Probe("Busy")
    chains, module = running(probe)
    times = iter(range(1_000))

    def work(source, target):
        watch.look([module], next(times) * TICK_S)
        return OK

    probe.act = work
    for now in range(200):
        chains.process(0, noise(), now * CYCLE_S)
        if now % 5 == 4:
            watch.look([module], next(times) * TICK_S)
    assert module.bypassed == ""


def test_a_process_that_was_stopped_meanwhile_blames_nobody():
    module, _, _ = during_calls([0.0, 60.0], calls=1)
    assert module.bypassed == ""
    module, _, _ = during_calls([0.0, *(60.0 + n * 1e-3 for n in range(20))], calls=1)
    assert module.bypassed == ""


def test_an_effect_that_was_given_up_has_another_chance_once_it_is_enabled():
    module, _, probe = during_calls([n * TICK_S for n in range(5)], calls=1)
    probe.act = lambda source, target: OK
    module.enable()
    module.update_state()
    assert module.bypassed == ""
