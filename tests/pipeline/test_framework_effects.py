import json
import sys
from functools import partial
from uuid import UUID

import numpy as np
import pytest

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.effect.haptic_parameters import HAPTIC_CUSHION
from audioflinger_hook.mixer import dump
from audioflinger_hook.pipeline.framework import Framework
from audioflinger_hook.sources import FramesTap, TapClient
from device.drive.outputs import FADE_S
from device.errors import UsageError
from tests.effect.test_registry import EFFECT, HALVER, HALVER_UUID, entry
from tests.support.commands import call, listing, refused, sound, vibration
from tests.support.pipelines import RATE, music, steps_of, transformed

OTHER_UUID = UUID("5d0a6a3e-95f9-4b6c-8f6e-0d6a5a4f0007")

MISBEHAVES = f"if SEEN[0] > 3: MISBEHAVE\n{' ' * 12}target.audio[:] = -source.audio"
OTHER = EFFECT.format(name="Other", library="other", uuid=OTHER_UUID, does=MISBEHAVES)


def effects_xml(*libraries, effects, applied):
    """An audio_effects.xml; effects: (name, library, uuid); applied: names on the output mix."""
    declared = [f'<effect name="{n}" library="{lib}" uuid="{uuid}"/>' for n, lib, uuid in effects]
    lines = [
        '<audio_effects_conf version="2.0"><libraries>',
        *(f'<library name="{name}" path="{name}"/>' for name in libraries),
        *("</libraries><effects>", *declared, "</effects>"),
        '<postprocess><stream type="output_mix">',
        *(f'<apply effect="{name}"/>' for name in applied),
        "</stream></postprocess></audio_effects_conf>",
    ]
    return "\n".join(lines)


OURS = ("ours", "cushion", HAPTIC_CUSHION.uuid)
HALVING = ("halver", "halving", HALVER_UUID)
OTHERS = ("other", "other", OTHER_UUID)


@pytest.fixture
def effects_file(tmp_path):
    """Writes an effects file and returns its path; a config beside it names it."""
    (tmp_path / "config.toml").write_text('effects_file = "audio_effects.xml"\n')
    path = tmp_path / "audio_effects.xml"

    def write(*arguments, **options):
        path.write_text(effects_xml(*arguments, **options) if options else arguments[0])
        return path

    return write


@pytest.fixture
def halver_applied(site, effects_file):
    """Writes the file of an effect that halves, installed, with some names applied."""
    site("halver_package", HALVER, entry("halver_package:LIBRARY"))
    return partial(effects_file, "cushion", "halving", effects=[OURS, HALVING])


@pytest.fixture
def other_applied(site, effects_file):
    """Installs the effect that misbehaves so, and returns the path of a file that applies it."""

    def write(misbehave, replaced=("", ""), applied=("other", "ours")):
        source = OTHER.replace("MISBEHAVE", misbehave).replace(*replaced)
        site("other_package", source, entry("other_package:LIBRARY"))
        return effects_file("cushion", "other", effects=[OURS, OTHERS], applied=applied)

    return write


def playing(frames, path, **options):
    framework = Framework(RATE, frames.shape[1], Settings(effects_file=path), **options)
    return framework, *steps_of(TapClient(FramesTap(frames, RATE, 480)), framework)


@pytest.mark.parametrize("applied", [("halver", "ours"), ("ours", "halver")])
def test_ours_reads_what_every_other_effect_has_made_of_the_sound(halver_applied, applied):
    frames = music(9_600)
    framework, audio, felt = playing(frames, halver_applied(applied=applied))
    halved = frames * np.float32(0.5)
    assert (audio.tobytes(), felt.tobytes()) == (halved.tobytes(), transformed(halved).tobytes())
    assert framework.warnings == framework.bypassed() == []
    assert "Effect 0: Halver" in dump(framework.mixer)
    assert "Effect 1: Haptic Cushion" in dump(framework.mixer)


def test_an_effect_that_is_installed_and_not_applied_does_not_run(halver_applied):
    frames = music(4_800)
    for path in (None, halver_applied(applied=["ours"])):
        framework, audio, felt = playing(frames, path)
        assert audio.tobytes() == frames.tobytes()
        assert felt.tobytes() == transformed(frames).tobytes()
        assert "Halver" not in dump(framework.mixer)


def test_an_effect_that_fails_is_bypassed_and_named_and_we_go_on(other_applied):
    frames, reason = np.nan_to_num(music(9_600)), "exchanged or reshaped its arrays"
    framework, audio, felt = playing(frames, other_applied("target.audio = None; return OK"))
    heard = -frames
    heard[3 * 480 :] = frames[3 * 480 :]
    assert (audio.tobytes(), felt.tobytes()) == (heard.tobytes(), transformed(heard).tobytes())
    (bypassed,) = framework.bypassed()
    assert bypassed.startswith(f"session 0, Other: {reason}")
    assert f"Bypassed: {reason}" in dump(framework.mixer)
    assert "overruns 0, faults 1," in dump(framework.mixer)


def test_another_effect_that_waits_is_passed_by_but_never_ours(other_applied):
    waits = "[FRAMEWORK[0].look_for_blocked(n * 0.1) for n in range(5)]"
    busy = "FRAMEWORK[0].haptic.inside = True"  # as when the machine has no time for its thread
    path = other_applied(f"{busy}; {waits}", ("SEEN = [0]", "SEEN, FRAMEWORK = [0], [None]"))
    framework = Framework(RATE, 2, Settings(effects_file=path))
    sys.modules["other_package"].FRAMEWORK[0] = framework
    steps_of(TapClient(FramesTap(music(4_800), RATE, 480)), framework)
    why = "kept the audio thread for over 0.4 s in process"
    assert framework.bypassed() == [f"session 0, Other: {why}"]


def test_sound_that_is_not_played_as_it_is_made_has_all_the_time_there_is(other_applied):
    path = other_applied("sum(range(1_000_000))")  # over 5 ms, whatever the machine
    frames = music(4_800)
    framework, audio, _ = playing(frames, path)
    assert (audio.tobytes(), framework.bypassed()) == ((-frames).tobytes(), [])


def test_a_rendering_runs_its_configs_effects_and_warns_of_one_bypassed(tmp_path, other_applied):
    other_applied("raise KeyError('lost')", ("> 3", "> 0"))
    frames = np.nan_to_num(music(9_600))
    source, out = sound(tmp_path / "in.wav", frames), tmp_path / "out.wav"
    done = call("render", source, out, "--config", tmp_path / "config.toml", "--json")
    assert done.code == 0
    warning = (
        "effect bypassed: session 0, Other: "
        "raised KeyError: 'lost' in process (other_package.py, line 15)"
    )
    assert done.stderr == f"cushion: warning: {warning}\n"
    assert json.loads(done.stdout)["warnings"] == [warning]
    whole = transformed(frames)[Framework(RATE, 2).latency_frames :]
    unfaded = slice(-round(FADE_S * RATE))
    assert vibration(out)[unfaded].tobytes() == whole[unfaded].tobytes()


def test_a_check_of_the_config_names_the_mistakes_of_its_effects_file(tmp_path, effects_file):
    def checked(applied, *options):
        effects_file("cushion", effects=[OURS], applied=applied)
        return call("check", "--config", tmp_path / "config.toml", *options)

    done = checked(["ours"])
    assert (done.code, done.stderr) == (0, "")
    assert done.stdout.endswith("config.toml: no mistakes\n")
    done = checked(["gentle", "ours"])
    assert (done.code, done.stdout) == (0, "")
    assert "effect='gentle' is an unknown effect; left out" in done.stderr
    done = checked([], "--json")
    assert done.code == 2
    (found,) = json.loads(done.stdout)
    assert (found["key"], done.stderr) == ("effects_file", "")
    assert "does not apply the haptic effect" in json.dumps(found)


def test_what_an_effects_file_declares_in_vain_is_warned_of_and_ours_runs(site, effects_file):
    site("broken_package", "raise RuntimeError('bad luck')", entry("broken_package:LIBRARY"))
    path = effects_file("cushion", "halving", effects=[OURS, HALVING], applied=["halver", "ours"])
    frames = music(4_800)
    framework, audio, felt = playing(frames, path)
    assert (audio.tobytes(), felt.tobytes()) == (frames.tobytes(), transformed(frames).tobytes())
    text = "\n".join(framework.warnings)
    assert "library 'halving' of package 'broken_package' is left out" in text
    assert f"{path}: line 3: <library> path='halving' is an unknown library" in text
    assert "effect='halver' is an unknown effect" in text


ALONE = ("EffectFlag.INSERT", "EffectFlag.INSERT_EXCLUSIVE")
UNMADE = ("class Other:", "class Other:\n        def __init__(self): 1 / 0")


@pytest.mark.parametrize(
    ("replaced", "reason"), [(ALONE, "stand beside"), (UNMADE, "be made: ZeroDiv")]
)
def test_an_effect_that_cannot_be_made_or_stand_there_is_warned_of(other_applied, replaced, reason):
    framework, _, felt = playing(music(4_800), other_applied("pass", replaced, ("ours", "other")))
    assert felt.tobytes() == transformed(music(4_800)).tobytes()
    (warning,) = framework.warnings
    assert "effect 'Other' cannot" in warning
    assert reason in warning


def test_an_effect_that_lets_no_other_beside_it_is_named_where_it_keeps_ours_out(other_applied):
    with pytest.raises(UsageError, match="cannot stand beside 'Other'"):
        Framework(RATE, 2, Settings(effects_file=other_applied("pass", ALONE)))


@pytest.mark.parametrize(
    ("xml", "reason"),
    [
        ("<audio_effects_conf", "is not XML"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><a/>', "a document type"),
        (effects_xml("cushion", effects=[OURS], applied=[]), ""),
        (effects_xml("cushion", effects=[], applied=["ours"]), "effect='ours' is an unknown"),
        (effects_xml("cushio", effects=[OURS], applied=["ours"]), "path='cushio' is an unknown"),
    ],
)
def test_a_file_that_does_not_apply_our_effect_is_refused(tmp_path, effects_file, xml, reason):
    path, source = effects_file(xml), sound(tmp_path / "in.wav", music(500))
    before, options = listing(tmp_path), ["--config", tmp_path / "config.toml"]
    said = refused(call("render", source, tmp_path / "out.wav", *options))
    assert "does not apply the haptic effect" in said
    assert str(path) in said
    assert reason in said
    assert listing(tmp_path) == before
