from uuid import UUID

import numpy as np
import pytest

from audioflinger_hook.effect.chain import EffectChains
from audioflinger_hook.effect.interface import EINVAL, OK, Access, Command, EffectFlag, Parameter
from audioflinger_hook.effect.module import BlockWatch
from audioflinger_hook.mixer.mix_buffer import DEVICE, OUTPUT_MIX, OUTPUT_STAGE
from device.errors import UsageError
from tests.support.effects import CYCLE_S, FRAMES, RATE, FakeClock, Probe, noise, running

ANY, FIRST = EffectFlag.INSERT_ANY, EffectFlag.INSERT_FIRST
LAST, POST = EffectFlag.INSERT_LAST, EffectFlag.POST_PROC
NEITHER = EffectFlag.AUXILIARY, EffectFlag.PRE_PROC
FLAGS = {"*": ANY, "F": FIRST, "L": LAST, "X": EffectFlag.INSERT_EXCLUSIVE, "P": POST}
ORDERS = {"**": "ba", "***": "cba", "FF": "ab", "F*": "ab", "*F": "ba", "F*F": "acb"}
ORDERS |= {"LL": "ba", "L*": "ba", "*L": "ab", "LF*L": "bcda", "*LFL*": "ceadb"}
ORDERS |= {"X": "a", "P*": "ab", "PFL*": "abdc"}


@pytest.mark.parametrize(("flags", "order"), ORDERS.items())
def test_effects_stand_where_audioflinger_would_put_them(flags, order):
    chains = EffectChains(FakeClock())
    for number, flag in enumerate(flags):
        chains.add(Probe("abcde"[number], number, FLAGS[flag]), OUTPUT_MIX)
    assert "".join(module.descriptor.name for module in chains.modules(OUTPUT_MIX)) == order


@pytest.mark.parametrize(
    ("flags", "session", "message"),
    [
        *((flags, 0, "only inserts and post-processing run here") for flags in NEITHER),
        *((ANY, one, "takes only post-processing") for one in (OUTPUT_STAGE, DEVICE)),
        *((ANY, one, f"session {one!r} does not exist") for one in (-3, "0", True)),
    ],
)
def test_an_effect_is_refused_where_it_cannot_run(flags, session, message):
    with pytest.raises(UsageError, match=message):
        EffectChains(FakeClock()).add(Probe(flags=flags), session)


def test_an_effect_without_a_descriptor_is_refused():
    without = Probe()
    without.descriptor = None
    with pytest.raises(UsageError, match="no descriptor: AttributeError"):
        EffectChains(FakeClock()).add(object(), 0)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="NoneType is not an EffectDescriptor"):
        EffectChains(FakeClock()).add(without, 0)


def test_chains_run_players_first_then_output_mix_output_stage_and_device():
    chains = EffectChains(FakeClock())
    for session in (OUTPUT_MIX, 3, DEVICE, 12, OUTPUT_STAGE, 5):
        chains.add(Probe(flags=POST), session)
    assert chains.sessions() == (12, 5, 3, 0, -1, -2)


def test_only_the_last_effect_accumulates_and_only_into_another_buffer_of_its_layout():
    first, second = Probe("a", 1, FIRST), Probe("b", 2, LAST)
    chains, one, two = running(first, second, session=3)
    chains.process(3, noise(), 0.0, noise(seed=1))
    assert (one.access, two.access) == (Access.WRITE, Access.ACCUMULATE)
    chains.remove(two)
    chains.process(3, noise(), 0.0, noise(seed=1))
    assert one.access.name == "ACCUMULATE"
    chains.process(3, noise(), 0.0)
    assert one.access.name == "WRITE"
    chains, module = running(Probe(), session=3)
    mix = noise(channels=1)
    chains.process(3, noise(), 0.0, mix)
    chains.process(9, noise(), 0.0, mix)
    assert (mix.samples.tobytes(), module.misfits) == (noise(channels=1).samples.tobytes(), 1)


@pytest.mark.parametrize("state", ["idle", "bypassed", "no chain"])
def test_sound_is_added_as_it_is_where_no_effect_runs(state):
    probe = Probe()
    chains, module = running(probe, session=3)

    if state == "idle":
        module.release()
        buffer = noise()
        chains.process(5, buffer, 0.0)  # no such session
        assert buffer.samples.tobytes() == noise().samples.tobytes()
    elif state == "bypassed":
        probe.act = lambda source, target: source.samples.fill(9.0) or target.samples.fill(9.0)
    else:
        chains.remove(module)
    own, mix = noise(seed=1), noise(seed=2)
    expected = own.samples + mix.samples
    chains.process(3, own, 0.0, mix)
    np.testing.assert_array_equal(mix.samples, expected)
    np.testing.assert_array_equal(own.samples, noise(seed=1).samples)


def test_effects_added_before_and_after_the_stream_is_known_are_both_configured():
    chains, early, late = EffectChains(FakeClock()), Probe("early", 1), Probe("late", 2)
    chains.add(early, 0)
    chains.set_format(RATE, 2, 1, FRAMES)
    chains.add(late, 0)
    chains.set_format(RATE, 2, 1, FRAMES)
    assert early.take() == late.take() == ["INIT", "SET_CONFIG"]


def test_a_dump_shows_what_dumpsys_would_and_asks_the_effect_once_a_second():
    probe = Probe("Level", 7, LAST, parameters=(Parameter("gain_db", float, -3.0, unit="dB"),))
    probe.replies[Command.GET_PARAM] = (OK, -3.0)
    probe.replies[Command.DUMP] = (OK, "two\nlines")
    chains, _ = running(probe)
    for cycle in range(1, 201):
        chains.end_of_cycle(cycle * 0.02)
    assert probe.take().count("DUMP") in (4, 5)
    text = "\n".join(chains.dump())
    assert probe.take() == []
    for expected in (
        *("1 Effect Chains", "cycles: 201, last at 4.000 s", "0       ACTIVE   y       n"),
        *(f"UUID: {UUID(int=7)}", "flags: 00000010 (conn. mode: insert, insert pref: last)"),
        *("Configuration: 48000 Hz, 2 + 1 channels, 960 frames, write", "gain_db: -3.0 dB"),
        "overruns 0, faults 0, refusals 0, misfits 0",
    ):
        assert expected in text
    assert [line.strip() for line in chains.dump()][-2:] == ["two", "lines"]


def test_a_dump_names_what_complained():
    probe = Probe()
    chains, module = running(probe)
    probe.replies[Command.DUMP] = (3, None)
    assert module.command(Command.DUMP) == (EINVAL, None)
    complaint = "answered DUMP with tuple; allowed: (status, reply)"
    assert f"      Last complaint: {complaint}" in chains.dump()


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
