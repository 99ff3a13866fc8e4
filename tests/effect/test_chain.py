"""Chains: who runs, in which order, into which buffer, and how it is shown."""

from __future__ import annotations

from dataclasses import replace
from uuid import UUID

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from audioflinger_hook.effect.chain import EffectChains, insert_index
from audioflinger_hook.effect.interface import (
    EINVAL,
    OK,
    Access,
    Command,
    EffectDescriptor,
    EffectFlag,
    Parameter,
)
from audioflinger_hook.mixer.mix_buffer import DEVICE, OUTPUT_MIX, OUTPUT_STAGE
from device.errors import UsageError
from tests.support.effects import FRAMES, RATE, FakeClock, Probe, descriptor, noise, running

ANY, FIRST = EffectFlag.INSERT_ANY, EffectFlag.INSERT_FIRST
LAST, EXCLUSIVE = EffectFlag.INSERT_LAST, EffectFlag.INSERT_EXCLUSIVE
POST = EffectFlag.POST_PROC


def names_after(*flags):
    """Names of a chain's effects, a, b, c, ... by when they were added."""
    chains = EffectChains(FakeClock())
    for number, flag in enumerate(flags):
        chains.add(Probe("abcdefgh"[number], number, flag), OUTPUT_MIX)
    return "".join(module.descriptor.name for module in chains.modules(OUTPUT_MIX))


@pytest.mark.parametrize(
    ("flags", "order"),
    [
        ([ANY, ANY], "ba"),
        ([ANY, ANY, ANY], "cba"),
        ([FIRST, FIRST], "ab"),
        ([FIRST, ANY], "ab"),
        ([ANY, FIRST], "ba"),
        ([FIRST, ANY, FIRST], "acb"),
        ([LAST, LAST], "ba"),
        ([LAST, ANY], "ba"),
        ([ANY, LAST], "ab"),
        ([LAST, FIRST, ANY, LAST], "bcda"),
        ([ANY, LAST, FIRST, LAST, ANY], "ceadb"),
        ([EXCLUSIVE], "a"),
        ([POST, ANY], "ab"),
        ([POST, FIRST, LAST, ANY], "abdc"),
    ],
)
def test_effects_stand_where_audioflinger_would_put_them(flags, order):
    assert names_after(*flags) == order


@given(st.lists(st.sampled_from([ANY, FIRST, LAST]), max_size=8))
def test_first_ones_are_always_first_and_last_ones_last(flags):
    chain: list[EffectDescriptor] = []
    for number, flag in enumerate(flags):
        new = descriptor(number=number, flags=flag)
        chain.insert(insert_index(new, chain), new)
    rank = {FIRST: 0, ANY: 1, LAST: 2}
    ranks = [rank[one.flags] for one in chain]
    assert ranks == sorted(ranks)


@pytest.mark.parametrize("flags", [(EXCLUSIVE, ANY), (ANY, EXCLUSIVE), (EXCLUSIVE, EXCLUSIVE)])
def test_an_exclusive_effect_is_refused_beside_others(flags):
    chains = EffectChains(FakeClock())
    chains.add(Probe("a", 1, flags[0]), 0)
    late = Probe("b", 2, flags[1])
    with pytest.raises(UsageError, match="'b' cannot stand beside 'a': one of them is exclusive"):
        chains.add(late, 0)
    assert len(chains.modules(0)) == 1
    assert late.take() == []
    chains.add(late, 7)


@pytest.mark.parametrize(
    ("flags", "session", "message"),
    [
        (EffectFlag.AUXILIARY, 0, "only inserts and post-processing run here"),
        (EffectFlag.PRE_PROC, 0, "only inserts and post-processing run here"),
        (ANY, OUTPUT_STAGE, "session -1 takes only post-processing"),
        (ANY, DEVICE, "session -2 takes only post-processing"),
        (ANY, -3, "session -3 does not exist"),
        (ANY, "0", "session '0' does not exist"),
        (ANY, True, "session True does not exist"),
    ],
)
def test_an_effect_is_refused_where_it_cannot_run(flags, session, message):
    with pytest.raises(UsageError, match=message):
        EffectChains(FakeClock()).add(Probe(flags=flags), session)


class Headless:
    @property
    def descriptor(self):
        raise LookupError("lost")


def test_an_effect_without_a_sound_descriptor_is_refused():
    chains = EffectChains(FakeClock())
    with pytest.raises(UsageError, match="no descriptor: LookupError: lost"):
        chains.add(Headless(), 0)  # type: ignore[arg-type]
    wrong = Probe()
    wrong.descriptor = replace(wrong.descriptor, uuid="1")
    with pytest.raises(UsageError, match="'Probe' has an invalid UUID"):
        chains.add(wrong, 0)
    wrong.descriptor = None
    with pytest.raises(UsageError, match="NoneType is not an EffectDescriptor"):
        chains.add(wrong, 0)


def test_chains_run_players_first_then_output_mix_output_stage_and_device():
    chains = EffectChains(FakeClock())
    for session in (OUTPUT_MIX, 3, DEVICE, 12, OUTPUT_STAGE, 5):
        chains.add(Probe(flags=POST), session)
    assert chains.sessions() == (12, 5, 3, 0, -1, -2)
    chains.remove(chains.modules(5)[0])
    assert chains.sessions() == (12, 3, 0, -1, -2)


def adding(number):
    def act(source, target):
        target.audio += number
        return OK

    return act


def test_each_effect_treats_what_the_one_before_it_made():
    first, second = Probe("first", 1, FIRST), Probe("second", 2, LAST)
    first.act = adding(1.0)

    def double(source, target):
        target.audio *= 2.0
        return OK

    second.act = double
    chains, *_ = running(first, second)
    buffer = noise()
    chains.process(0, buffer, 0.0)
    np.testing.assert_array_equal(buffer.audio, (noise().audio + np.float32(1.0)) * 2)
    np.testing.assert_array_equal(buffer.haptic, noise().haptic)


def test_only_the_last_effect_accumulates_and_only_into_another_buffer():
    first, second = Probe("a", 1, FIRST), Probe("b", 2, LAST)
    chains, one, two = running(first, second, session=3)
    assert (one.access, two.access) == (Access.WRITE, Access.WRITE)
    chains.process(3, noise(), 0.0, noise(seed=1))
    assert (one.access, two.access) == (Access.WRITE, Access.ACCUMULATE)
    chains.remove(two)
    chains.process(3, noise(), 0.0, noise(seed=1))
    assert one.access.name == "ACCUMULATE"
    chains.process(3, noise(), 0.0)
    assert one.access.name == "WRITE"


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
        probe.act = lambda source, target: 99
    else:
        chains.remove(module)
    own, mix = noise(seed=1), noise(seed=2)
    expected = own.samples + mix.samples
    chains.process(3, own, 0.0, mix)
    np.testing.assert_array_equal(mix.samples, expected)


def test_a_target_of_another_layout_is_left_alone():
    chains, module = running(Probe(), session=3)
    mix = noise(channels=1)
    chains.process(3, noise(), 0.0, mix)
    chains.process(9, noise(), 0.0, mix)
    assert mix.samples.tobytes() == noise(channels=1).samples.tobytes()
    assert module.misfits == 1


def test_effects_added_before_and_after_the_stream_is_known_are_both_configured():
    chains = EffectChains(FakeClock())
    early, late = Probe("early", 1), Probe("late", 2)
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
        "1 Effect Chains",
        "cycles: 201, last at 4.000 s",
        "1 effects for session 0",
        "Effect 0: Level",
        "0       ACTIVE   y       n",
        f"UUID: {UUID(int=7)}",
        "flags: 00000010 (conn. mode: insert, insert pref: last)",
        "Configuration: 48000 Hz, 2 + 1 channels, 960 frames, write",
        "gain_db: -3.0 dB",
        "overruns 0, faults 0, refusals 0, misfits 0",
    ):
        assert expected in text
    assert [line.strip() for line in chains.dump()][-2:] == ["two", "lines"]


def test_a_dump_names_what_is_bypassed_and_what_complained():
    probe = Probe()
    chains, module = running(probe)
    probe.replies[Command.DUMP] = (3, None)
    assert module.command(Command.DUMP) == (EINVAL, None)
    complaint = "answered DUMP with tuple; allowed: (status, reply)"
    assert f"      Last complaint: {complaint}" in chains.dump()
    probe.act = lambda source, target: 3
    chains.process(0, noise(), 0.0)
    dump = chains.dump()
    assert "      Bypassed: answered process with 3; allowed: OK (0), ENODATA" in dump
    assert any("faults 2" in line for line in dump)
