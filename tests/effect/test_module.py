from unittest.mock import Mock

import numpy as np
import pytest

from audioflinger_hook.effect.interface import EINVAL, ENODATA, OK, Command, Parameter
from audioflinger_hook.effect.module import EffectModule
from tests.support.effects import CYCLE_S, FRAMES, FakeClock, Probe, config, noise, running


def module_of(probe, **replies):
    probe.replies |= {Command[name]: reply for name, reply in replies.items()}
    return EffectModule(probe, session=0, clock=FakeClock(), budget_s=0.01)


def running_probe(**options):
    probe = Probe()
    chains, module = running(probe, **options)
    probe.take()
    return probe, chains, module


def cycle(module, buffer=None):
    buffer = buffer or noise()
    module.process(buffer, buffer)
    module.update_state()


ACTIVE = ["enable STARTING:", "cycle ACTIVE:ENABLE", "cycle ACTIVE:process"]
TAIL = ["disable STOPPING:", "cycle STOPPED:process,DISABLE"]
LIFECYCLES = {
    "enable and disable are sent at the end of a cycle, process comes later, with a tail": [
        *(*ACTIVE, *TAIL, "cycle STOPPED:process")
    ],
    "a second enable and a disable in idle change nothing": [
        *("disable IDLE:", "cycle IDLE:", "enable STARTING:", "enable STARTING:"),
        *("cycle ACTIVE:ENABLE", "enable ACTIVE:", "cycle ACTIVE:process"),
    ],
    "disable before enable was sent sends neither": [
        *("enable STARTING:", "disable IDLE:", "cycle IDLE:")
    ],
    "enable before disable was sent continues without either": [
        *(*ACTIVE, "disable STOPPING:", "enable ACTIVE:", "cycle ACTIVE:process")
    ],
    "enable within the tail restarts from rest": [
        *(*ACTIVE, *TAIL, "enable RESTART:", "cycle ACTIVE:process,RESET,ENABLE")
    ],
    "disable before the restart was sent continues the tail": [
        *(*ACTIVE, *TAIL, "enable RESTART:", "disable STOPPED:", "cycle STOPPED:process")
    ],
    "release while active stops the engine for good": [
        *(*ACTIVE, "release DESTROYED:DISABLE", "enable DESTROYED:", "cycle DESTROYED:")
    ],
    "release of an effect that never ran sends no disable": ["release DESTROYED:"],
    "reset while active reaches the engine and it goes on": [
        *(*ACTIVE, "RESET ACTIVE:RESET", "cycle ACTIVE:process")
    ],
    "commands do what the methods do": ["ENABLE STARTING:", "DISABLE IDLE:"],
}


@pytest.mark.parametrize("steps", LIFECYCLES.values(), ids=LIFECYCLES)
def test_commands_come_in_the_order_of_the_lifecycle(steps):
    probe = Probe()
    module = module_of(probe)
    module.set_config(config())
    assert probe.take() == ["INIT", "SET_CONFIG"]
    for step in steps:
        call, _, expected = step.partition(" ")
        if call == "cycle":
            cycle(module)
        elif call.isupper():
            assert module.command(Command[call]) == (OK, None)
        else:
            getattr(module, call)()
        assert f"{module.state.name}:{','.join(probe.take())}" == expected, step


def test_the_end_of_the_tail_resets_the_engine_and_an_endless_one_is_cut_off():
    probe, _, module = running_probe()
    module.disable()
    cycle(module)
    probe.act = lambda source, target: ENODATA
    probe.take()
    cycle(module)
    assert (module.state.name, probe.take()) == ("IDLE", ["process", "RESET"])
    cycle(module)
    assert probe.take() == []
    probe, _, module = running_probe()
    module.disable()
    module.update_state()
    cycles = 0
    while module.state.name == "STOPPED":
        cycle(module)
        cycles += 1
    assert cycles * CYCLE_S == pytest.approx(10.0)
    assert probe.take()[-1] == "RESET"


def test_nothing_is_processed_before_a_configuration_which_is_sent_only_where_it_is_new():
    probe = Probe()
    module = module_of(probe)
    module.enable()
    cycle(module)
    cycle(module)
    assert (probe.take(), module.command(Command.RESET)) == (["INIT"], (EINVAL, None))
    module.set_config(config())
    cycle(module)
    cycle(module)
    assert probe.take() == ["SET_CONFIG", "ENABLE", "process"]
    probe, _, module = running_probe()
    for new in (config(), config(44_100), config(44_100, channels=1)):
        assert module.set_config(new) == OK
    assert (probe.take(), module.state.name) == (["SET_CONFIG", "SET_CONFIG"], "ACTIVE")
    assert module.set_config("48000") == EINVAL


def test_a_removed_effect_refuses_everything():
    probe, chains, module = running_probe()
    for _ in range(2):
        chains.remove(module)
        assert chains.sessions() == ()
    assert module.enable() == module.disable() == module.set_config(config(44_100)) == EINVAL
    assert module.command(Command.RESET) == module.command(Command.ENABLE) == (EINVAL, None)
    assert probe.take() == ["DISABLE"]


def test_an_engine_that_refuses_to_start_or_init_is_named_and_stays_idle():
    module = module_of(Probe(), ENABLE=(EINVAL, None))
    module.set_config(config())
    module.enable()
    cycle(module)
    assert (module.state.name, module.refusals) == ("IDLE", 1)
    assert module.complaint == "refused ENABLE (status -22)"
    probe = Probe()
    module = module_of(probe, INIT=(EINVAL, None))
    assert (module.set_config(config()), module.bypassed) == (EINVAL, "refused INIT (status -22)")
    probe.replies.clear()
    assert (module.set_config(config()), module.bypassed) == (OK, "")


# What misbehaves is bypassed, counted and named, and the sound is as it was before it.
def exchange(source, target):
    target.audio = np.zeros((3, 3), np.float32)
    return OK


def reshape(source, target):
    target.audio.shape = (-1,)
    return OK


def drop(source, target):
    del target.haptic
    return OK


def scribble_and_raise(source, target):
    source.samples[:] = 9.0
    target.samples[:] = 9.0
    raise ZeroDivisionError("by zero\nin the middle")


class Unspeakable(BaseException):
    def __str__(self):
        raise RuntimeError("no words")


def unspeakable(source, target):
    raise Unspeakable


EXCHANGED = "exchanged or reshaped its arrays; write into them: target.audio[:] = ..."
ANSWERED = "answered process with {}; allowed: OK (0), ENODATA"
ANSWERS = ((7, "7"), (None, "None"), (True, "bool"), (np.zeros(3), "ndarray"), (EINVAL, "-22"))
MISBEHAVIOURS = [
    (scribble_and_raise, "raised ZeroDivisionError: by zero in the middle in process"),
    (unspeakable, "raised Unspeakable in process"),
    *((Mock(return_value=answer), ANSWERED.format(shown)) for answer, shown in ANSWERS),
    *((exchange, EXCHANGED), (drop, EXCHANGED)),
    pytest.param(
        *(reshape, EXCHANGED), marks=pytest.mark.filterwarnings("ignore::DeprecationWarning")
    ),
]


@pytest.mark.parametrize(("misbehave", "reason"), MISBEHAVIOURS)
def test_an_engine_that_misbehaves_is_bypassed_counted_and_named(misbehave, reason):
    probe, after = Probe("Rogue"), Probe("After", 2)
    chains, rogue, _ = running(probe, after)
    probe.act = misbehave
    buffer = noise()
    before = buffer.samples.copy()
    arrays = buffer.samples, buffer.audio, buffer.haptic
    for now in range(3):
        chains.process(0, buffer, now * CYCLE_S)
        chains.end_of_cycle(now * CYCLE_S)
    for now, then in zip((buffer.samples, buffer.audio, buffer.haptic), arrays, strict=True):
        assert now is then
    assert (buffer.audio.shape, buffer.samples.tobytes()) == ((960, 2), before.tobytes())
    assert rogue.faults == 1
    (bypassed,) = chains.bypassed()
    assert bypassed.startswith(f"session 0, Rogue: {reason}")
    assert ("(test_module.py, line " in bypassed) == reason.startswith("raised")
    assert (probe.take().count("process"), after.take().count("process")) == (1, 3)


def test_what_an_engine_does_later_to_a_buffer_it_kept_is_not_heard():
    probe, chains, module = running_probe()
    probe.act = Mock(return_value=OK)
    buffer = noise()
    chains.process(0, buffer, 0.0)
    probe.act.call_args.args[1].audio[:] = 9.0
    chains.process(0, buffer, 0.0)
    exchange(*probe.act.call_args.args)
    chains.process(0, buffer, 0.0)
    assert (module.bypassed, buffer.samples.tobytes()) == ("", noise().samples.tobytes())


@pytest.mark.parametrize(
    "before", [exchange, drop, lambda _, target: target.samples.setflags(write=False) or EINVAL]
)
@pytest.mark.parametrize("after", [lambda *_: OK, lambda *_: 7, lambda *_: 1 / 0])
def test_an_engine_that_is_given_another_chance_is_lent_a_sound_buffer(before, after):
    probe, chains, module = running_probe()
    probe.act = lambda source, target: before(source, target) or after()
    chains.process(0, noise(), 0.0)
    assert module.bypassed

    def halve(source, target):
        assert target.audio.shape == (FRAMES, 2)
        target.samples *= 0.5
        return OK

    probe.act = halve
    module.enable()
    chains.end_of_cycle(0.0)
    buffer = noise()
    chains.process(0, buffer, 0.0)
    assert not module.bypassed
    np.testing.assert_array_equal(buffer.samples, noise().samples * np.float32(0.5))


def test_not_finite_samples_that_came_with_the_sound_are_not_blamed_on_an_effect():
    probe, chains, module = running_probe()
    buffer = noise()
    buffer.audio[3, 1] = np.nan
    before = buffer.samples.tobytes()
    chains.process(0, buffer, 0.0)
    assert (module.faults, buffer.samples.tobytes()) == (0, before)
    probe.act = lambda source, target: target.haptic.put(5, np.inf) or OK
    chains.process(0, buffer, 0.0)
    assert (module.fault, buffer.samples.tobytes()) == ("made samples that are not finite", before)


@pytest.mark.parametrize("name", ["SET_CONFIG", "ENABLE", "DISABLE"])
@pytest.mark.parametrize("answer", [None, (1, 2, 3), ("0", None), (5, None), (None, None)])
def test_nonsense_as_the_answer_to_a_command_is_a_fault(name, answer):
    probe = Probe()
    module = module_of(probe, **{name: answer})
    module.set_config(config())
    for call in (module.enable, module.disable):
        call()
        cycle(module)
    shown = "None" if answer is None else "tuple"
    assert module.fault == f"answered {name} with {shown}; allowed: (status, reply)"
    probe.take()
    cycle(module)
    assert probe.take() == []


def test_an_engine_that_raises_when_asked_something_is_named_but_goes_on():
    probe, chains, module = running_probe()

    def fail():
        raise OSError("cannot")

    probe.replies[Command.DUMP] = fail
    assert (module.command(Command.DUMP), module.faults, module.bypassed) == ((EINVAL, None), 1, "")
    assert module.complaint.startswith("raised OSError: cannot in DUMP (test_module.py, line ")
    chains.process(0, noise(), 0.0)
    assert probe.take() == ["DUMP", "process"]


def test_the_user_can_still_interrupt():
    probe, chains, _ = running_probe()

    probe.act = Mock(side_effect=KeyboardInterrupt)
    with pytest.raises(KeyboardInterrupt):
        chains.process(0, noise(), 0.0)


@pytest.mark.parametrize(
    ("frames", "took_ms", "budget_share", "overruns"),
    [
        (FRAMES, [11, 11, 9, 11, 11, 11, 1], 0.5, 5),
        (FRAMES // 4, [3, 3, 3, 1], 0.5, 3),  # of 2.5 ms for a quarter of 20 ms
        *((FRAMES, [3, 3, 3, 1], 0.5, 0), (FRAMES, [3.6e6, 3.6e6, 3.6e6, 1], float("inf"), 0)),
    ],
)
def test_three_overruns_in_a_row_of_the_time_for_a_buffers_length_bypass_and_two_do_not(
    frames, took_ms, budget_share, overruns
):
    clock = FakeClock()
    probe, chains, module = running_probe(clock=clock, budget_share=budget_share)
    takes = iter(took_ms)

    def slow(source, target):
        clock.now_s += next(takes) * 1e-3
        target.audio *= 0.5
        return OK

    probe.act = slow
    loudness = []
    for _ in took_ms:
        buffer = noise(frames)
        chains.process(0, buffer, 0.0)
        loudness.append(np.abs(buffer.audio).max() / np.abs(noise(frames).audio).max())
    # What came late came whole, and is used; after a bypass the last buffer passes as it is.
    assert loudness == [0.5] * (len(took_ms) - 1) + [1.0 if overruns else 0.5]
    assert (module.overruns, module.faults) == (overruns, bool(overruns))
    assert module.worst_s == pytest.approx(max(took_ms) * 1e-3)
    assert ("ms allowed for" in module.bypassed) == bool(overruns)


def test_a_bypassed_effect_is_initialised_anew_when_it_is_enabled_again():
    probe, chains, module = running_probe()
    probe.act = scribble_and_raise
    chains.process(0, noise(), 0.0)
    chains.end_of_cycle(0.0)
    assert module.enabled
    probe.take()
    probe.act = lambda source, target: OK
    module.enable()
    chains.process(0, noise(), 0.0)
    assert probe.take() == []
    chains.end_of_cycle(0.0)
    chains.process(0, noise(), 0.0)
    assert probe.take() == ["INIT", "SET_CONFIG", "ENABLE", "process"]
    assert (module.bypassed, module.faults) == ("", 1)
    probe.act = scribble_and_raise
    chains.process(0, noise(), 0.0)
    probe.take()
    module.disable()
    chains.end_of_cycle(0.0)
    assert (module.state.name, probe.take()) == ("IDLE", []), "it does not hear of it"


@pytest.mark.parametrize("shape", [(961, 2, 1), (960, 1, 1), (960, 2, 2), (960, 2, 0), (0, 2, 1)])
def test_a_buffer_that_does_not_fit_the_configuration_passes_and_is_counted(shape):
    probe, _, module = running_probe()
    cycle(module, noise(*shape))
    assert (probe.take(), module.misfits) == ([], 1)
    cycle(module, noise(17))
    assert (probe.take(), module.misfits) == (["process"], 1)


def test_several_parameters_are_set_together_or_not_at_all():
    probe = Probe(parameters=(Parameter("a", float, 0.0, 0, 1), Parameter("b", bool, False)))
    module = module_of(probe)
    probe.take()
    for wrong in ({"a": 0.5, "b": 1}, {"a": 0.5, "c": True}):
        assert module.set_parameters(wrong) == EINVAL
    assert (probe.take(), module.set_parameters({"a": 0.5, "b": True})) == ([], OK)
    assert probe.take() == ["SET_PARAM_DEFERRED", "SET_PARAM_DEFERRED", "SET_PARAM_COMMIT"]
