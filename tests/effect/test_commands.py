from types import NoneType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from audioflinger_hook.effect import interface
from audioflinger_hook.effect.commands import CommandCheck
from audioflinger_hook.effect.interface import EINVAL, Command, EffectFlag, Parameter, VendorCommand
from audioflinger_hook.effect.module import EffectModule
from tests.support.effects import FakeClock, Probe, config

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
