"""Other effects beside ours, as an effects file applies them: what runs, what is left out."""

from __future__ import annotations

import json
import sys
from uuid import UUID

import numpy as np
import pytest

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.effect.haptic_parameters import HAPTIC_CUSHION
from audioflinger_hook.pipeline.framework import Framework
from audioflinger_hook.pipeline.step import Pipeline
from audioflinger_hook.sources import FramesTap, TapClient
from device.drive.outputs import FADE_S
from device.errors import UsageError
from tests.effect.test_registry import HALVER, HALVER_UUID, entry
from tests.support.commands import call, cushion, listing, refused, sound, vibration
from tests.support.pipelines import RATE, music, steps_of, transformed

OTHER_UUID = UUID("5d0a6a3e-95f9-4b6c-8f6e-0d6a5a4f0007")

OTHER = f"""
    from uuid import UUID
    from audioflinger_hook.effect.interface import OK, EffectDescriptor, EffectFlag
    from audioflinger_hook.effect.registry import EffectLibrary

    NOW_S = [0.0]
    SEEN = [0]
    FLAGS = EffectFlag.INSERT

    OTHER = EffectDescriptor(UUID(int=9), UUID("{OTHER_UUID}"), "Other", "somebody else", FLAGS)

    class Other:
        descriptor = OTHER

        def process(self, source, target):
            SEEN[0] += 1
            if SEEN[0] > 3:
                MISBEHAVE
            target.audio[:] = -source.audio
            return OK

        def command(self, code, data=None):
            return OK, None

    LIBRARY = EffectLibrary("other", ((OTHER, Other),))
"""


def effects_xml(*libraries, effects, applied):
    """An audio_effects.xml; effects: (name, library, uuid); applied: names on the output mix."""
    lines = [f'<library name="{name}" path="{name}"/>' for name in libraries]
    declared = [f'<effect name="{n}" library="{lib}" uuid="{uuid}"/>' for n, lib, uuid in effects]
    applies = [f'<apply effect="{name}"/>' for name in applied]
    return "\n".join(
        [
            '<audio_effects_conf version="2.0"><libraries>',
            *lines,
            "</libraries><effects>",
            *declared,
            '</effects><postprocess><stream type="output_mix">',
            *applies,
            "</stream></postprocess></audio_effects_conf>",
        ]
    )


OURS = ("ours", "cushion", HAPTIC_CUSHION.uuid)
HALVING = ("halver", "halving", HALVER_UUID)
OTHERS = ("other", "other", OTHER_UUID)


@pytest.fixture
def effects_file(tmp_path):
    """Writes an effects file and returns its path."""

    def write(*arguments, **options):
        path = tmp_path / "audio_effects.xml"
        path.write_text(effects_xml(*arguments, **options) if options else arguments[0])
        return path

    return write


def playing(frames, path, **options):
    framework = Framework(RATE, frames.shape[1], Settings(effects_file=path), **options)
    return framework, *steps_of(TapClient(FramesTap(frames, RATE, 480)), framework)


# --- effects that run


@pytest.mark.parametrize("applied", [("halver", "ours"), ("ours", "halver")])
def test_ours_reads_what_every_other_effect_has_made_of_the_sound(site, effects_file, applied):
    site("halver_package", HALVER, entry("halver_package:LIBRARY"))
    path = effects_file("cushion", "halving", effects=[OURS, HALVING], applied=applied)
    frames = music(9_600)
    framework, audio, felt = playing(frames, path)
    halved = frames * np.float32(0.5)
    assert audio.tobytes() == halved.tobytes()
    assert felt.tobytes() == transformed(halved).tobytes()
    assert framework.warnings == framework.bypassed() == []
    assert "Effect 0: Halver" in framework.dump()
    assert "Effect 1: Haptic Cushion" in framework.dump()


def test_an_effect_that_is_installed_and_not_applied_does_not_run(site, effects_file):
    site("halver_package", HALVER, entry("halver_package:LIBRARY"))
    frames = music(4_800)
    for path in (
        None,
        effects_file("cushion", "halving", effects=[OURS, HALVING], applied=["ours"]),
    ):
        framework, audio, felt = playing(frames, path)
        assert audio.tobytes() == frames.tobytes()
        assert felt.tobytes() == transformed(frames).tobytes()
        assert "Halver" not in framework.dump()


@pytest.mark.exhaustive
def test_the_command_takes_effects_of_other_packages_from_the_file_that_the_config_names(
    tmp_path, site, effects_file
):
    site("halver_package", HALVER, entry("halver_package:LIBRARY"))
    effects_file("cushion", "halving", effects=[OURS, HALVING], applied=["halver", "ours"])
    config = tmp_path / "config.toml"
    config.write_text('effects_file = "audio_effects.xml"\n')
    frames = music(9_600)
    source = sound(tmp_path / "in.wav", frames)
    options = ["render", source, tmp_path / "out.wav", "--config", config]
    # From another folder: the file is looked for beside the config that names it.
    done = cushion(*options, prelude=f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n")
    assert (done.code, done.stderr) == (0, "")
    assert call("check", "--config", config).code == 0
    latency = Framework(RATE, 2).latency_frames
    wanted = transformed(frames * np.float32(0.5))[latency:]
    unfaded = slice(-round(FADE_S * RATE))
    assert vibration(tmp_path / "out.wav")[unfaded].tobytes() == wanted[unfaded].tobytes()


# --- effects that fail beside ours


@pytest.mark.parametrize(
    ("misbehave", "reason"),
    [
        ("raise KeyError('lost')", "raised KeyError: 'lost' in process"),
        ("return 'fine'", "answered process with str; allowed: OK (0), ENODATA"),
        ("source.audio[:] = float('nan'); return OK", "made samples that are not finite"),
        ("target.audio = None; return OK", "exchanged or reshaped its arrays"),
    ],
)
def test_an_effect_that_fails_is_bypassed_and_named_and_we_go_on(
    site, effects_file, misbehave, reason
):
    site("other_package", OTHER.replace("MISBEHAVE", misbehave), entry("other_package:LIBRARY"))
    path = effects_file("cushion", "other", effects=[OURS, OTHERS], applied=["other", "ours"])
    frames = np.nan_to_num(music(9_600))
    framework, audio, felt = playing(frames, path)
    heard = -frames
    heard[3 * 480 :] = frames[3 * 480 :]
    assert audio.tobytes() == heard.tobytes()
    assert felt.tobytes() == transformed(heard).tobytes()
    (bypassed,) = framework.bypassed()
    assert bypassed.startswith(f"session 0, Other: {reason}")
    assert f"Bypassed: {reason}" in framework.dump()
    assert "overruns 0, faults 1," in framework.dump()


def test_another_effect_that_waits_is_passed_by_but_never_ours(site, effects_file):
    waits = "[FRAMEWORK[0].look_for_blocked(n * 0.1) for n in range(5)]"
    busy = "FRAMEWORK[0].haptic.inside = True"  # as when the machine has no time for its thread
    waiting = OTHER.replace("MISBEHAVE", f"{busy}; {waits}").replace(
        "SEEN = [0]", "SEEN, FRAMEWORK = [0], [None]"
    )
    site("other_package", waiting, entry("other_package:LIBRARY"))
    path = effects_file("cushion", "other", effects=[OURS, OTHERS], applied=["other", "ours"])
    framework = Framework(RATE, 2, Settings(effects_file=path))
    sys.modules["other_package"].FRAMEWORK[0] = framework
    steps_of(TapClient(FramesTap(music(4_800), RATE, 480)), framework)
    assert framework.bypassed() == [
        "session 0, Other: kept the audio thread for over 0.4 s in process"
    ]


def test_sound_that_is_not_played_as_it_is_made_has_all_the_time_there_is(site, effects_file):
    late = "sum(range(1_000_000))"  # over 5 ms, whatever the machine
    site("other_package", OTHER.replace("MISBEHAVE", late), entry("other_package:LIBRARY"))
    path = effects_file("cushion", "other", effects=[OURS, OTHERS], applied=["other", "ours"])
    frames = music(4_800)
    framework, audio, _ = playing(frames, path)
    assert audio.tobytes() == (-frames).tobytes()
    assert framework.bypassed() == []


def test_a_rendering_warns_of_an_effect_that_was_bypassed(tmp_path, site, effects_file):
    broken = OTHER.replace("MISBEHAVE", "raise KeyError('lost')").replace("> 3", "> 0")
    site("other_package", broken, entry("other_package:LIBRARY"))
    effects_file("cushion", "other", effects=[OURS, OTHERS], applied=["other", "ours"])
    (tmp_path / "config.toml").write_text('effects_file = "audio_effects.xml"\n')
    frames = np.nan_to_num(music(9_600))
    source = sound(tmp_path / "in.wav", frames)
    out = tmp_path / "out.wav"
    done = call("render", source, out, "--config", tmp_path / "config.toml", "--json")
    assert done.code == 0
    assert done.stderr == (
        "cushion: warning: effect bypassed: session 0, Other: "
        "raised KeyError: 'lost' in process (other_package.py, line 18)\n"
    )
    assert json.loads(done.stdout)["warnings"] == [
        "effect bypassed: session 0, Other: "
        "raised KeyError: 'lost' in process (other_package.py, line 18)"
    ]
    latency = Framework(RATE, 2).latency_frames
    unfaded = slice(0, -round(FADE_S * RATE))
    assert np.array_equal(vibration(out)[unfaded], transformed(frames)[latency:][unfaded])


def test_a_check_of_the_config_names_the_mistakes_of_its_effects_file(tmp_path, effects_file):
    (tmp_path / "config.toml").write_text('effects_file = "audio_effects.xml"\n')
    effects_file("cushion", effects=[OURS], applied=["ours"])
    done = call("check", "--config", tmp_path / "config.toml")
    assert (done.code, done.stderr) == (0, "")
    assert done.stdout.endswith("config.toml: no mistakes\n")
    effects_file("cushion", effects=[OURS], applied=["gentle", "ours"])
    done = call("check", "--config", tmp_path / "config.toml")
    assert (done.code, done.stdout) == (0, "")
    assert "effect='gentle' is an unknown effect; left out" in done.stderr
    effects_file("cushion", effects=[OURS], applied=[])
    done = call("check", "--config", tmp_path / "config.toml", "--json")
    assert done.code == 2
    assert "does not apply the haptic effect" in done.stderr
    assert [found["key"] for found in json.loads(done.stdout)] == ["effects_file"]


# --- what is left out


def test_what_an_effects_file_declares_in_vain_is_warned_of_and_ours_runs(site, effects_file):
    site("broken_package", "raise RuntimeError('bad luck')", entry("broken_package:LIBRARY"))
    path = effects_file("cushion", "halving", effects=[OURS, HALVING], applied=["halver", "ours"])
    frames = music(4_800)
    framework, audio, felt = playing(frames, path)
    assert audio.tobytes() == frames.tobytes()
    assert felt.tobytes() == transformed(frames).tobytes()
    text = "\n".join(framework.warnings)
    assert "library 'halving' of package 'broken_package' is left out" in text
    assert f"{path}: line 3: <library> path='halving' is an unknown library" in text
    assert "effect='halver' is an unknown effect" in text


@pytest.mark.parametrize(
    ("part", "wrong", "reason"),
    [
        ("FLAGS = EffectFlag.INSERT", "FLAGS = EffectFlag.INSERT_EXCLUSIVE", "stand beside"),
        ("class Other:", "class Other:\n        def __init__(self): 1 / 0", "be made: ZeroDiv"),
    ],
)
def test_an_effect_that_cannot_be_made_or_stand_there_is_left_out_with_a_warning(
    site, effects_file, part, wrong, reason
):
    path = effects_file("cushion", "other", effects=[OURS, OTHERS], applied=["ours", "other"])
    source = OTHER.replace("MISBEHAVE", "pass").replace(part, wrong)
    site("other_package", source, entry("other_package:LIBRARY"))
    framework, _, felt = playing(music(4_800), path)
    assert felt.tobytes() == transformed(music(4_800)).tobytes()
    (warning,) = framework.warnings
    assert "effect 'Other' cannot" in warning
    assert reason in warning


@pytest.mark.parametrize(
    ("xml", "reason"),
    [
        ("", "is not XML"),
        ("<audio_effects_conf", "is not XML"),
        ("PK\x03\x04", "is not XML"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><a/>', "a document type"),
        (effects_xml("cushion", effects=[OURS], applied=[]), ""),
        (
            effects_xml("cushion", effects=[OURS], applied=["us"]),
            "effect='us' is an unknown effect",
        ),
        (effects_xml("cushion", effects=[], applied=["ours"]), "effect='ours' is an unknown"),
        (effects_xml("cushio", effects=[OURS], applied=["ours"]), "path='cushio' is an unknown"),
    ],
)
def test_a_file_that_does_not_apply_our_effect_is_refused_with_the_reason(
    tmp_path, effects_file, xml, reason
):
    path = effects_file(xml)
    with pytest.raises(UsageError, match=r"does not apply the haptic effect") as caught:
        Framework(RATE, 2, Settings(effects_file=path))
    assert str(path) in str(caught.value)
    assert reason in str(caught.value)
    (tmp_path / "config.toml").write_text('effects_file = "audio_effects.xml"\n')
    source = sound(tmp_path / "in.wav", music(500))
    before = listing(tmp_path)
    options = ["--config", tmp_path / "config.toml"]
    assert reason in refused(call("render", source, tmp_path / "out.wav", *options))
    assert listing(tmp_path) == before


def test_an_effect_that_lets_no_other_stand_beside_it_is_named_where_it_keeps_ours_out(
    site, effects_file
):
    path = effects_file("cushion", "other", effects=[OURS, OTHERS], applied=["other", "ours"])
    alone = OTHER.replace("FLAGS = EffectFlag.INSERT", "FLAGS = EffectFlag.INSERT_EXCLUSIVE")
    site("other_package", alone.replace("MISBEHAVE", "pass"), entry("other_package:LIBRARY"))
    with pytest.raises(UsageError, match="cannot stand beside 'Other'"):
        Framework(RATE, 2, Settings(effects_file=path))


@pytest.mark.parametrize(
    ("value", "wrong"),
    [
        ('"none.xml"', '= "none.xml" is not a file'),
        ('"."', '= "." is not a file'),
        ('""', '= "" is not a path'),
        ("3", "= 3 is not a path"),
        ('"a\\u0000b"', "is not a file"),
    ],
)
def test_a_config_that_names_no_effects_file_is_a_mistake_with_its_line(tmp_path, value, wrong):
    config = tmp_path / "config.toml"
    config.write_text(f"# effects\neffects_file = {value}\n")
    error = refused(call("check", "--config", config))
    assert "line 2: effects_file" in error
    assert wrong in error
    assert "allowed: the path of an audio_effects.xml" in error


def test_what_came_out_of_a_chain_stays_as_it_was(effects_file):
    path = effects_file("cushion", effects=[OURS], applied=["ours"])
    framework = Framework(RATE, 2, Settings(effects_file=path))
    chain = Pipeline(TapClient(FramesTap(music(2_000), RATE, 500)), framework, ())
    first = chain.step()
    assert first
    kept = first.audio.tobytes(), first.vibration.tobytes()
    while chain.step():
        pass
    assert (first.audio.tobytes(), first.vibration.tobytes()) == kept
