from types import NoneType
from uuid import UUID

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from audioflinger_hook.effect import interface
from audioflinger_hook.effect.chain import EffectChains
from audioflinger_hook.effect.commands import CommandCheck
from audioflinger_hook.effect.interface import (
    EINVAL,
    OK,
    Access,
    Command,
    EffectFlag,
    Parameter,
    VendorCommand,
)
from audioflinger_hook.effect.module import BlockWatch, EffectModule
from audioflinger_hook.mixer.mix_buffer import DEVICE, OUTPUT_MIX, OUTPUT_STAGE
from device.errors import UsageError
from tests.support.effects import CYCLE_S, FRAMES, RATE, FakeClock, Probe, config, noise, running

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


KNOBS = (
    *(Parameter("level", float, 0.5, 0.0, 1.0), Parameter("count", int, 3, 1, 9)),
    *(Parameter("mode", str, "soft", choices=("soft", "hard")), Parameter("bright", bool, False)),
    Parameter("meter", float),
)
OWN = (VendorCommand(0x1_0005, "FREEZE", NoneType), VendorCommand(0x1_0006, "LOAD", bytes))


def probe_and_module(flags=EffectFlag.INSERT):
    probe = Probe(flags=flags, parameters=KNOBS, vendor_commands=OWN)
    module = EffectModule(probe, session=0, clock=FakeClock(), budget_s=0.01)
    module.set_config(config())
    probe.take()
    return probe, module


NAN, INF = float("nan"), float("inf")
WRONG_CODES: tuple[object, ...] = (
    *(-1, 22, 0xFFFF, 0x1_0000, 0x1_0007, 2**70, 3.0, "ENABLE", None, True, [], np.int64(3)),
)
WRONG_VALUES: dict[object, tuple[object, ...]] = {
    "level": ("0.5", True, 1.0000001, NAN, INF, 10**400, np.float64(0.5), np.zeros(3), None),
    "count": (3.0, 0),
    "mode": ("SOFT",),
    "bright": (1,),
    **dict.fromkeys(("meter", "Level", b"level"), (0.5,)),
}
WRONG_PAIRS = (None, (), ("level",), ("level", 0.5, 0.5), ["level", 0.5], {"level": 0.5})
TAKE_NONE = (Command.ENABLE, Command.DISABLE, Command.RESET, Command.DUMP, Command.SET_PARAM_COMMIT)
WRONG_DATA: dict[object, tuple[object, ...]] = {
    **dict.fromkeys((*TAKE_NONE, 0x1_0005), (1, (), {}, "", 0)),
    Command.SET_PARAM: (*WRONG_PAIRS, (["level"], 0.5)),
    Command.SET_VOLUME: ((), (1.5,), (0.5, NAN), (0.5,) * 65, 0.5),
    Command.SET_DEVICE: (-1, 2**32, 1.0),
    Command.GET_PARAM: (None, "volume", ("level",)),
    Command.INIT: (None,),
    Command.SET_CONFIG: (config(), None),
    Command.SET_PARAM_DEFERRED: (("level", 2.0),),
    Command.SET_AUDIO_MODE: (True,),
    Command.SET_CONFIG_REVERSE: ((48_000, 2),),
    Command.OFFLOAD: ((1, 1),),
    Command.GET_FEATURE_SUPPORTED_CONFIGS: ((1,),),
    Command.SET_FEATURE_CONFIG: (("1", 1),),
    0x1_0006: (None, bytearray(3)),
}
WRONG: list[tuple[object, object]] = [
    *((code, None) for code in WRONG_CODES),
    *((Command.SET_PARAM, (name, one)) for name in WRONG_VALUES for one in WRONG_VALUES[name]),
    *((code, one) for code, several in WRONG_DATA.items() for one in several),
]


@pytest.mark.parametrize(("code", "data"), WRONG)
def test_what_is_wrong_never_reaches_the_engine(code, data):
    probe, module = probe_and_module(EffectFlag.INSERT | EffectFlag.VOLUME_CTRL)
    assert (module.command(code, data), probe.take()) == ((EINVAL, None), [])


RIGHT = [
    *((code, None) for code in (Command.RESET, Command.SET_PARAM_COMMIT, Command.GET_CONFIG)),
    *((Command.SET_PARAM, one) for one in (("level", 1), ("level", 0.25), ("count", 9))),
    *((Command.SET_PARAM_DEFERRED, ("mode", "hard")), (Command.SET_VOLUME, (0.5, 1))),
    *((Command.SET_DEVICE, 2), (Command.SET_AUDIO_MODE, 0), (Command.OFFLOAD, (False, 0))),
    *((Command.GET_FEATURE_SUPPORTED_CONFIGS, (0, 4)), (Command.SET_FEATURE_CONFIG, (0, b""))),
    *((Command.SET_CONFIG_REVERSE, config()), (Command.DUMP, None)),
    *((0x1_0005, None), (0x1_0006, b"x")),
]


@pytest.mark.parametrize(("code", "data"), RIGHT)
def test_what_is_right_reaches_the_engine_once(code, data):
    told = EffectFlag.INSERT | EffectFlag.VOLUME_CTRL | EffectFlag.DEVICE_IND
    probe, module = probe_and_module(told)
    assert (module.command(code, data), len(probe.take())) == ((interface.OK, None), 1)


def test_an_effect_that_asked_for_neither_volume_nor_device_is_not_told_of_them():
    probe, module = probe_and_module()
    assert module.command(Command.SET_VOLUME, (0.5,)) == (interface.ENOSYS, None)
    assert (module.command(Command.SET_DEVICE, 2), probe.take()) == ((interface.ENOSYS, None), [])


@pytest.mark.parametrize("reply", [None, "x", True, 3 + 0j, np.float64(0.5)])
def test_a_reply_of_the_wrong_type_to_get_param_is_named_and_not_handed_on(reply):
    probe, module = probe_and_module()
    probe.replies[Command.GET_PARAM] = (interface.OK, reply)
    assert module.command(Command.GET_PARAM, "level") == (EINVAL, None)
    assert (module.complaint, module.bypassed) == ("answered GET_PARAM level with nonsense", "")


names = st.sampled_from([*(knob.name for knob in KNOBS), "gain_db", "form", "mute"])
numbers = st.booleans() | st.integers() | st.floats()
others = st.none() | st.just(np.zeros((2, 2))) | st.just(config())
anything = st.recursive(
    st.text(max_size=5) | st.binary(max_size=5) | names | numbers | others,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.lists(inner, min_size=1, max_size=3).map(tuple)
        | st.dictionaries(st.text(max_size=3), inner, max_size=2)
    ),
    max_leaves=6,
)
codes = st.integers(-2, 25) | st.sampled_from([0x1_0000, 0x1_0001, 0x1_0005, 0x1_0006]) | anything


@given(codes, anything)
def test_no_command_raises_and_only_right_ones_reach_the_engine(code, data):
    probe, module = probe_and_module()
    status, reply = module.command(code, data)
    seen = probe.take()
    if CommandCheck(probe.descriptor).status(code, data) != interface.OK:
        assert (status, reply) in [(EINVAL, None), (interface.ENOSYS, None)]
        assert seen == []
    else:
        assert len(seen) <= 1
    assert module.faults == 0 or code == Command.GET_PARAM


def test_a_parameter_says_what_it_may_hold():
    gain = Parameter("gain_db", float, 0.0, -60.0, 0.0, unit="dB")
    assert "; ".join(map(str, (*KNOBS, gain, Parameter("title", str, "x")))) == (
        "level (0 to 1); count (1 to 9); mode (soft, hard); bright (true or false); "
        "meter (read only); gain_db (-60 to 0 dB); title (any text)"
    )
