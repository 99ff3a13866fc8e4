import time
from dataclasses import replace
from unittest.mock import Mock
from uuid import UUID

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from audioflinger_hook.effect.haptic import CUSHION, HapticEffect
from audioflinger_hook.effect.haptic_parameters import HAPTIC_CUSHION
from audioflinger_hook.effect.interface import EffectFlag, Parameter, VendorCommand
from audioflinger_hook.effect.registry import EffectLibrary, EffectRegistry, descriptor_problem
from audioflinger_hook.effect.xml import SIZE_MAX, parse_effects, read_effects
from device.errors import InternalError, NotFoundError, UsageError
from tests.support.data import table, text
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
    return (
        "from audioflinger_hook.effect.haptic import HAPTIC_CUSHION, HapticEffect\n"
        "from audioflinger_hook.effect.registry import EffectLibrary\n"
        f"L = EffectLibrary({arguments})"
    )


def installed(site, source=HALVER, package="halver_package", value="LIBRARY", **options):
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


REGISTRY = EffectRegistry([CUSHION, LIBRARY])

GOOD = text("audio-effects.xml").format(haptic=HAPTIC_CUSHION.uuid, delay=str(ECHO_UUID).upper())


LINES = GOOD.splitlines(keepends=True)
ANY_ORDER = "".join([*LINES[:2], *LINES[10:17], *LINES[6:10], *LINES[2:6], LINES[17]])
NOT_EMULATED = GOOD.replace("<effects>", '<effects><effectProxy name="p"><libsw/></effectProxy>')
NOT_EMULATED = NOT_EMULATED.replace(
    "</audio_effects_conf>",
    """<preprocess><stream type="voice_communication"><apply effect="aec"/></stream></preprocess>
    <deviceEffects><devicePort type="BUS" address="x"/></deviceEffects></audio_effects_conf>""",
)


@pytest.mark.parametrize("text", [GOOD, ANY_ORDER, NOT_EMULATED])
def test_effects_libraries_and_streams_are_read_in_any_order_and_among_what_only_android_has(text):
    declared = parse_effects(text.encode(), REGISTRY)
    assert declared.problems == []
    assert declared.effects == {"haptic": HAPTIC_CUSHION.uuid, "delay": ECHO_UUID}
    of_the_mix = [ECHO_UUID, HAPTIC_CUSHION.uuid]
    assert declared.postprocess == {"output_mix": of_the_mix, "music": [ECHO_UUID]}


BAD = [
    ('path="echoes"', 'path="libx.so"', ["path='libx.so' is an unknown library", "library='lib2'"]),
    ('<library name="lib2" path="echoes"/>', "<library/>", ["has no name and no path"]),
    ('name="lib2" path="echoes"', 'name="cushion" path="echoes"', ["'cushion' is declared twice"]),
    ('library="lib2"', 'library="lib9"', ["library='lib9' is an unknown library"]),
    (str(ECHO_UUID).upper(), "7d7cb2f0", ["uuid='7d7cb2f0' is not a UUID"]),
    (str(ECHO_UUID).upper(), f"{{{ECHO_UUID}}}", ["is not a UUID"]),
    (str(ECHO_UUID).upper(), str(UUID(int=3)), ["is not in library 'lib2'"]),
    (str(ECHO_UUID).upper(), str(HAPTIC_CUSHION.uuid), ["is a duplicate UUID"]),
    ('name="delay"', 'name="haptic"', ["name='haptic' is declared twice"]),
    ('name="delay"', "", ["has no name"]),
]


@pytest.mark.parametrize(("right", "wrong", "reasons"), BAD)
def test_a_bad_element_is_left_out_with_what_needs_it_and_the_rest_counts(right, wrong, reasons):
    declared = parse_effects(GOOD.replace(right, wrong).encode(), REGISTRY)
    problems = [str(problem) for problem in declared.problems]
    line = GOOD[: GOOD.index(right)].count("\n") + 1
    assert problems[0].startswith(f"line {line}: ")
    for reason in reasons:
        assert any(reason in problem for problem in problems), problems
    # Both of its applications are named with their lines too.
    assert declared.effects == {"haptic": HAPTIC_CUSHION.uuid}
    assert [p.line for p in declared.problems if "unknown effect" in p.text] == [13, 16]
    assert declared.postprocess["output_mix"] == [HAPTIC_CUSHION.uuid]


@pytest.mark.parametrize(
    ("right", "wrong", "line", "reason"),
    table("audio-effects-mistakes.toml")["mistakes"],
)
def test_each_mistake_is_named_once_with_its_line(right, wrong, line, reason):
    declared = parse_effects(GOOD.replace(right, wrong, 1).encode(), REGISTRY)
    (problem,) = declared.problems
    assert problem.line == line
    assert reason in problem.text
    assert len(declared.effects) == 2


@pytest.mark.parametrize(
    ("cut", "reason"),
    [
        *(("        <stream type", "no element found"), ("    </postprocess>", "no element found")),
        ('" uuid="7D7CB2F0', "unclosed token"),
    ],
)
def test_what_stands_before_a_syntax_error_counts(cut, reason):
    text = GOOD[: GOOD.index(cut)]
    declared = parse_effects(text.encode(), REGISTRY)
    assert declared.effects["haptic"] == HAPTIC_CUSHION.uuid
    texts = [problem.text for problem in declared.problems]
    assert any(reason in text and "nothing after it is read" in text for text in texts)


@pytest.mark.parametrize(
    ("xml", "line", "reason"),
    [
        *((b"", 1, "no element found"), (b"\n\nno xml", 3, "syntax error")),
        *((b"<a><b></a>", 1, "mismatched tag"), (b'<a x="1" x="2"/>', 1, "duplicate attribute")),
        (b"<other/>", 1, "<other> does not belong at the top"),
        (b'<?xml version="1.0" encoding="nonsense"?><a/>', 1, "encoding"),
        (b'<?xml version="1.0" encoding="utf-7"?><a/>', 1, "encoding"),
        (b"\xff\xfe\x00", 1, "nothing after it is read"),
        (b"<a>\x00</a>", 1, "nothing after it is read"),
    ],
)
def test_what_is_no_such_file_is_named_and_nothing_is_declared(xml, line, reason):
    declared = parse_effects(xml, REGISTRY)
    assert declared.effects == declared.postprocess == {}
    assert any(reason in problem.text for problem in declared.problems)
    assert declared.problems[0].line == line


def test_entities_are_refused_before_they_expand_and_nested_elements_do_no_harm():
    bomb = '<!DOCTYPE a [<!ENTITY a "ha">' + "".join(
        f'<!ENTITY {new} "{f"&{old};" * 50}">'
        for old, new in zip("abcdefgh", "bcdefghi", strict=True)
    )
    text = GOOD.replace("<audio_effects_conf", bomb + "]>\n<audio_effects_conf", 1)
    text, began = text.replace('effect="haptic"', 'effect="&i;"'), time.process_time()
    declared = parse_effects(text.encode(), REGISTRY)
    assert time.process_time() - began < 1.0
    (problem,) = declared.problems
    assert problem.line == 2
    assert "document type, with its entities, is not allowed" in problem.text
    assert declared.effects == {}
    declared = parse_effects(b'<audio_effects_conf version="2.0">' + b"<x>" * 100_000, REGISTRY)
    assert len(declared.problems) == 2


@given(st.binary(max_size=200) | st.text(max_size=200).map(lambda text: text.encode()))
@example(b"<audio_effects_conf version='2.0'><effects><effect uuid='\xc2\x80'/>")
def test_no_bytes_make_it_raise(xml):
    parse_effects(xml, REGISTRY)


@given(st.integers(0, len(GOOD) - 1), st.sampled_from([b"", b"<", b">", b'"', b"/", b"&", b"\x00"]))
def test_no_damage_to_a_good_file_makes_it_raise_or_declare_what_is_not_there(place, damage):
    xml = GOOD.encode()
    declared = parse_effects(xml[:place] + damage + xml[place + 1 :], REGISTRY)
    assert set(declared.effects.values()) <= {HAPTIC_CUSHION.uuid, ECHO_UUID}
    for uuids in declared.postprocess.values():
        assert len(uuids) <= 2


def test_a_file_that_cannot_be_read_is_an_error(tmp_path):
    good = tmp_path / "audio_effects.xml"
    good.write_text(GOOD)
    assert read_effects(good, REGISTRY).problems == []
    for path in (tmp_path / "absent.xml", tmp_path):
        with pytest.raises(UsageError, match="cannot be read"):
            read_effects(path, REGISTRY)
    good.write_bytes(b"<" * (SIZE_MAX + 1))
    with pytest.raises(UsageError, match="too large"):
        read_effects(good, REGISTRY)
