from dataclasses import replace
from unittest.mock import Mock
from uuid import UUID

import pytest

from audioflinger_hook.effect.haptic import CUSHION, HapticEffect
from audioflinger_hook.effect.interface import EffectFlag, Parameter, VendorCommand
from audioflinger_hook.effect.registry import EffectLibrary, EffectRegistry, descriptor_problem
from device.errors import InternalError, NotFoundError, UsageError
from tests.support.effects import ECHO_UUID, LIBRARY, Probe, descriptor

HALVER_UUID = UUID("5d0a6a3e-95f9-4b6c-8f6e-0d6a5a4f0001")

EFFECT = """
    from uuid import UUID
    from audioflinger_hook.effect.interface import OK, EffectDescriptor, EffectFlag
    from audioflinger_hook.effect.registry import EffectLibrary

    SEEN = [0]
    FLAGS = EffectFlag.INSERT
    KIND = EffectDescriptor(UUID(int=9), UUID("{uuid}"), "{name}", "somebody else", FLAGS)

    class {name}:
        descriptor = KIND

        def process(self, source, target):
            SEEN[0] += 1
            {does}
            return OK

        def command(self, code, data=None):
            return OK, None

    LIBRARY = EffectLibrary("{library}", ((KIND, {name}),))
"""
HALF = "target.audio[:] = 0.5 * source.audio"
HALVER = EFFECT.format(name="Halver", library="halving", uuid=HALVER_UUID, does=HALF)


def entry(value, name="halving"):
    return f"[audioflinger_hook.effects]\n{name} = {value}\n"


def library(arguments):
    """The source of a package with a library L."""
    return (
        "from audioflinger_hook.effect.haptic import HAPTIC_CUSHION, HapticEffect\n"
        "from audioflinger_hook.effect.registry import EffectLibrary\n"
        f"L = EffectLibrary({arguments})"
    )


def installed(site, source=HALVER, package="halver_package", value="LIBRARY", **options):
    """The effects that there are with one package more."""
    site(package, source, entry(f"{package}:{value}"), **options)
    return EffectRegistry.installed()


NEEDED = "an EffectLibrary is needed"
BROKEN = {
    "no such module": ("", entry("nowhere_at_all:LIBRARY"), "ModuleNotFoundError"),
    "no object": ("", entry("not a reference"), "halving"),
    "no such name": ("", "", "AttributeError"),
    "raises": ("raise RuntimeError('bad\\nluck')", "", "Error: bad luck"),
    "exits": ("import sys; sys.exit(4)", "", "SystemExit: 4"),
    "syntax": ("def", "", "SyntaxError"),
    "other type": ("L = 3", "", f"of type int; {NEEDED}"),
    "class": ("class L: pass", "", f"of type type; {NEEDED}"),
    "taken UUID": (
        *(library("'twin', ((HAPTIC_CUSHION, HapticEffect),)"), ""),
        "is that of effect 'Haptic Cushion'",
    ),
    "taken name": (library("'cushion', ()"), "", "'cushion' exists already"),
    "wrong shape": (library("'odd', (3, 4)"), "", "TypeError"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_package_is_left_out_and_named_and_others_are_there(site, case):
    source, entry_points, reason = BROKEN[case]
    site("broken_package", source, entry_points or entry("broken_package:L"))
    registry = installed(site, HALVER.replace("halving", "halves"))
    assert set(registry.libraries) == {"cushion", "halves"}
    (problem,) = registry.problems
    assert "library 'halving' of package 'broken_package' is left out" in problem
    assert reason in problem
    assert "\n" not in problem


@pytest.mark.parametrize(
    "entry_points", [b"[audioflinger_hook.effects]\nno equals sign\n", b"\xff\xfe\x00", b"a = b"]
)
def test_a_package_with_unreadable_metadata_is_left_out_and_others_are_there(site, entry_points):
    site("broken_package", "", entry_points)
    registry = installed(site)
    assert set(registry.libraries) == {"cushion", "halving"}
    assert len(registry.problems) <= 1
    assert all("broken_package-1.0" in problem for problem in registry.problems)


def test_a_package_without_a_name_is_left_out_or_loaded_but_breaks_nothing(site):
    registry = installed(site, metadata="")
    assert "cushion" in registry.libraries
    assert len(registry.problems) + len(registry.libraries) == 2


def test_entry_points_of_other_groups_are_not_loaded(site):
    site("other_package", "raise RuntimeError", "[some.group]\nx = other_package:X\n")
    assert EffectRegistry.installed().problems == []


def test_uuids_are_unique_within_and_between_libraries_and_an_unknown_one_is_told():
    registry = EffectRegistry([CUSHION, LIBRARY])
    uuids = [one.uuid for one in registry.descriptors]
    assert len(set(uuids)) == len(uuids) == 2
    assert registry.uuids("echoes") == {ECHO_UUID}
    assert registry.uuids("nothing") == frozenset()
    twice = EffectLibrary("twice", ((descriptor("a"), Probe), (descriptor("b"), Probe)))
    with pytest.raises(UsageError, match="effect 'b' is that of effect 'a'"):
        registry.add(twice)
    assert registry.libraries == ("cushion", "echoes")
    known = r"no effect has UUID .*; known effects: .*Haptic Cushion"
    with pytest.raises(NotFoundError, match=known):
        EffectRegistry([CUSHION]).create(UUID(int=5))


@pytest.mark.parametrize(
    ("factory", "message"),
    [
        (Mock(side_effect=MemoryError("much")), "'Probe' cannot be made: MemoryError: much"),
        (object, "'Probe' cannot be made: AttributeError"),
        (HapticEffect, "'Probe': its library made another effect"),
    ],
)
def test_a_factory_that_fails_is_named(factory, message):
    registry = EffectRegistry([EffectLibrary("odd", ((descriptor(), factory),))])
    with pytest.raises(InternalError, match=message):
        registry.create(UUID(int=1))


@pytest.mark.parametrize(
    ("name", "factory", "message"),
    [("", Probe, "name '' is not a name"), ("odd", 3, "3 does not make an engine")],
)
def test_what_is_wrong_with_a_library_is_said(name, factory, message):
    with pytest.raises(UsageError, match=message):
        EffectRegistry([EffectLibrary(name, ((descriptor(), factory),))])


@pytest.mark.parametrize(
    ("wrong", "problem"),
    [
        *(({"uuid": "x"}, "has an invalid UUID"), ({"type_uuid": 3}, "has an invalid UUID")),
        *(({"name": ""}, "has no name"), ({"flags": 0}, "has invalid flags")),
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
