"""Where effects come from: the bundled library, and packages that bring others."""

from __future__ import annotations

import sys
from dataclasses import replace
from uuid import UUID

import numpy as np
import pytest

from audioflinger_hook.effect.haptic import CUSHION, HapticEffect
from audioflinger_hook.effect.haptic_parameters import HAPTIC_CUSHION
from audioflinger_hook.effect.interface import OK, EffectFlag, Parameter, VendorCommand
from audioflinger_hook.effect.registry import EffectLibrary, EffectRegistry, descriptor_problem
from device.errors import InternalError, NotFoundError, UsageError
from tests.support.effects import ECHO, ECHO_UUID, LIBRARY, Probe, descriptor, noise, running

HALVER_UUID = UUID("5d0a6a3e-95f9-4b6c-8f6e-0d6a5a4f0001")

HALVER = """
    from uuid import UUID
    from audioflinger_hook.effect.interface import EINVAL, OK, Command, EffectDescriptor
    from audioflinger_hook.effect.registry import EffectLibrary
    from audioflinger_hook.effect.interface import Parameter

    HALVER = EffectDescriptor(
        UUID("5d0a6a3e-95f9-4b6c-8f6e-0d6a5a4f0000"),
        UUID("5d0a6a3e-95f9-4b6c-8f6e-0d6a5a4f0001"),
        "Halver",
        "somebody else",
        parameters=(Parameter("factor", float, 0.5, 0.0, 1.0),),
    )

    class Halver:
        descriptor = HALVER
        factor = 0.5

        def process(self, source, target):
            target.audio[:] = self.factor * source.audio
            return OK

        def command(self, code, data=None):
            if code == Command.SET_PARAM:
                self.factor = data[1]
            return OK, self.factor if code == Command.GET_PARAM else None

    LIBRARY = EffectLibrary("halving", ((HALVER, Halver),))
"""


def entry(value, name="halving"):
    return f"[audioflinger_hook.effects]\n{name} = {value}\n"


def test_the_bundled_library_is_there_without_any_entry_point():
    registry = EffectRegistry.installed()
    assert "cushion" in registry.libraries
    assert registry.problems == []
    engine = registry.create(HAPTIC_CUSHION.uuid)
    assert isinstance(engine, HapticEffect)
    assert registry.create(HAPTIC_CUSHION.uuid) is not engine


def test_a_package_brings_an_effect_through_its_entry_point_and_it_runs(site):
    site("halver_package", HALVER, entry("halver_package:LIBRARY"))
    registry = EffectRegistry.installed()
    assert registry.problems == []
    assert "halving" in registry.libraries
    chains, module, _ = running(registry.create(HALVER_UUID), HapticEffect())
    assert module.command(5, ("factor", 0.25)) == (OK, None)
    buffer = noise()
    chains.process(0, buffer, 0.0)
    np.testing.assert_array_equal(buffer.audio, np.float32(0.25) * noise().audio)
    assert chains.bypassed() == []


BROKEN = {
    "no such module": ("", entry("nowhere_at_all:LIBRARY"), "ModuleNotFoundError"),
    "no such name": ("", entry("broken_package:LIBRARY"), "AttributeError"),
    "raises": ("raise RuntimeError('bad\\nluck')", entry("broken_package:L"), "Error: bad luck"),
    "exits": ("import sys; sys.exit(4)", entry("broken_package:L"), "SystemExit: 4"),
    "syntax": ("def", entry("broken_package:L"), "SyntaxError"),
    "other type": ("L = 3", entry("broken_package:L"), "of type int; an EffectLibrary is needed"),
    "class": (HALVER, entry("broken_package:Halver"), "of type type; an EffectLibrary"),
    "no object": ("", entry("not a reference"), "halving"),
    "taken UUID": (
        "from audioflinger_hook.effect.haptic import HAPTIC_CUSHION, HapticEffect\n"
        "from audioflinger_hook.effect.registry import EffectLibrary\n"
        "L = EffectLibrary('twin', ((HAPTIC_CUSHION, HapticEffect),))",
        entry("broken_package:L"),
        "is that of effect 'Haptic Cushion'",
    ),
    "taken name": (
        "from audioflinger_hook.effect.registry import EffectLibrary\n"
        "L = EffectLibrary('cushion', ())",
        entry("broken_package:L"),
        "'cushion' exists already",
    ),
    "wrong shape": (
        "from audioflinger_hook.effect.registry import EffectLibrary\n"
        "L = EffectLibrary('odd', (3, 4))",
        entry("broken_package:L"),
        "TypeError",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_package_is_left_out_and_named_and_others_are_there(site, case):
    source, entry_points, reason = BROKEN[case]
    site("broken_package", source, entry_points)
    site("halver_package", HALVER.replace("halving", "halves"), entry("halver_package:LIBRARY"))
    if case == "class":
        sys.modules.pop("halver_package", None)
    registry = EffectRegistry.installed()
    assert set(registry.libraries) == {"cushion", "halves"}
    (problem,) = registry.problems
    assert "library 'halving' of package 'broken_package' is left out" in problem
    assert reason in problem
    assert "\n" not in problem


@pytest.mark.parametrize(
    "entry_points", [b"[audioflinger_hook.effects]\nno equals sign\n", b"\xff\xfe\x00", b"a = b"]
)
def test_a_package_with_unreadable_metadata_is_left_out_and_the_others_are_there(
    site, entry_points
):
    site("broken_package", "", entry_points)
    site("halver_package", HALVER, entry("halver_package:LIBRARY"))
    registry = EffectRegistry.installed()
    assert set(registry.libraries) == {"cushion", "halving"}
    assert len(registry.problems) <= 1
    assert all("broken_package-1.0" in problem for problem in registry.problems)


def test_a_package_without_a_name_is_left_out_or_loaded_but_breaks_nothing(site):
    site("nameless_package", HALVER, entry("nameless_package:LIBRARY"), metadata="")
    registry = EffectRegistry.installed()
    assert "cushion" in registry.libraries
    assert len(registry.problems) + len(registry.libraries) == 2


def test_entry_points_of_other_groups_are_not_loaded(site):
    site("other_package", "raise RuntimeError", "[some.group]\nx = other_package:X\n")
    assert EffectRegistry.installed().problems == []


def test_uuids_are_unique_within_and_between_libraries():
    registry = EffectRegistry([CUSHION, LIBRARY])
    uuids = [one.uuid for one in registry.descriptors]
    assert len(set(uuids)) == len(uuids) == 2
    assert registry.uuids("echoes") == {ECHO_UUID}
    assert registry.uuids("nothing") == frozenset()
    with pytest.raises(UsageError, match=f"UUID {ECHO_UUID} of effect 'Echo' is that of"):
        registry.add(EffectLibrary("again", ((ECHO, Probe),)))
    twice = EffectLibrary("twice", ((descriptor("a"), Probe), (descriptor("b"), Probe)))
    with pytest.raises(UsageError, match="effect 'b' is that of effect 'a'"):
        registry.add(twice)
    assert registry.libraries == ("cushion", "echoes")


def test_an_unknown_uuid_is_named_with_those_that_there_are():
    with pytest.raises(
        NotFoundError, match=r"no effect has UUID .*; known effects: .*Haptic Cushion"
    ):
        EffectRegistry([CUSHION]).create(UUID(int=5))


def make_nothing():
    raise MemoryError("too little")


@pytest.mark.parametrize(
    ("factory", "message"),
    [
        (make_nothing, "'Probe' cannot be made: MemoryError: too little"),
        (object, "'Probe' cannot be made: AttributeError"),
        (HapticEffect, "'Probe': its library made another effect"),
    ],
)
def test_a_factory_that_fails_is_named(factory, message):
    registry = EffectRegistry([EffectLibrary("odd", ((descriptor(), factory),))])
    with pytest.raises(InternalError, match=message):
        registry.create(UUID(int=1))


def test_what_is_wrong_with_a_library_is_said():
    registry = EffectRegistry()
    with pytest.raises(UsageError, match="name '' is not a name"):
        registry.add(EffectLibrary("", ()))
    with pytest.raises(UsageError, match="3 does not make an engine"):
        registry.add(EffectLibrary("odd", ((descriptor(), 3),)))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("wrong", "problem"),
    [
        ({"uuid": "x"}, "has an invalid UUID"),
        ({"type_uuid": 3}, "has an invalid UUID"),
        ({"name": ""}, "has no name"),
        ({"flags": 0}, "has invalid flags"),
        ({"parameters": ("gain",)}, "has an invalid parameter"),
        ({"parameters": (Parameter("a", list, 1),)}, "has an invalid parameter"),
        ({"parameters": (Parameter("a", int, 5, 6, 7),)}, "default of a .6 to 7. is out of its"),
        ({"parameters": (Parameter("a", int, 5),) * 2}, "two parameters of the same name"),
        ({"vendor_commands": (VendorCommand(5, "SET_PARAM"),)}, "below 0x10000"),
    ],
)
def test_what_is_wrong_with_a_descriptor_is_said(wrong, problem):
    right = descriptor(flags=EffectFlag.INSERT)
    assert descriptor_problem(right) == ""
    with pytest.raises(UsageError, match=problem):
        EffectRegistry([EffectLibrary("odd", ((replace(right, **wrong), Probe),))])
