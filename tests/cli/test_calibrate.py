import argparse
import re
from dataclasses import replace

import numpy as np
import pytest

from audioflinger_hook.cli.calibrate_live import levelled
from device.errors import UsageError
from device.identification import IdentificationError
from device.identification.calibration import STEPS, calibrate
from device.identification.recording import Sweep
from device.identification.simulated_laboratory import SimulatedLaboratory
from device.rig import PAPER, read_rig
from tests.support.commands import call, document, noise, on_a_terminal, refused, sound
from tests.support.data import table

SHORT = Sweep(low_hz=15.0, high_hz=400.0, duration_s=2.0)


class Tampered:
    """A bench whose recordings of the acceleration are changed; it keeps the levels of sweeps."""

    def __init__(self, change):
        self.bench, self.change, self.levels = SimulatedLaboratory(PAPER), change, []

    def measure(self, sweep, pairs):
        self.levels.append(sweep.level)
        return [
            replace(recording, response=self.change(recording.response, sweep.level))
            if recording.names[1] == "acceleration"
            else recording
            for recording in self.bench.measure(sweep, pairs)
        ]


@pytest.mark.exhaustive
def test_the_twin_is_calibrated_and_its_file_holds_what_was_identified(tmp_path):
    path = tmp_path / "mine.toml"
    found = document("calibrate", "--device", "twin", "--out", path)
    assert found["level_of_x_max"] == pytest.approx(0.05, rel=0.05)
    rig = read_rig(path)
    for parameter, estimate in found["values"].items():
        stage, name = parameter.split(".")
        value, true = getattr(getattr(rig, stage), name), getattr(getattr(PAPER, stage), name)
        assert value == estimate["value"] == pytest.approx(true, rel=0.02)
        source = next(source for source in rig.sources if source.parameter == parameter)
        assert source.kind == "identified"
        assert "0.05" in source.words
        assert list(source.interval or ()) == estimate["interval"]
    assert len(found["values"]) == 7
    assert found["rig"] == rig.name == "mine"
    recordings = found["recordings"]
    responses = [one["response"] for one in recordings]
    assert responses == ["acceleration", "current", "acceleration", "voltage"]
    assert all(one["coherence"] > 0.9 for one in recordings)
    assert [one["order"] for one in recordings[0]["distortion"]] == [2, 3, 4, 5]
    played = sound(tmp_path / "in.wav", noise(4_800))
    assert document("render", played, tmp_path / "out.wav", "--rig", path)["frames"] == 4_800


@pytest.mark.exhaustive
def test_a_terminal_sees_how_far_it_is_and_a_pipe_only_the_result():
    run = ("calibrate", "--device", "twin", "--seconds", "2")
    done, shown = on_a_terminal(*run, streams=("stderr",))
    assert "sweeps of 15 to 400 Hz" in shown
    # The bar is drawn ten times a second, so a fast sweep's share may not be seen; the last one is.
    assert re.search(r"[1-9]\d* %", shown)
    assert "acceleration for voltage: coherence 1.0000" in done.stdout
    assert "distortion by order 2: " in done.stdout
    for words in ("sweeps of", "\x1b"):
        assert words not in done.stdout


@pytest.mark.exhaustive
def test_on_a_seat_neither_force_factor_nor_mass_is_given():
    done = call("calibrate", "--device", "twin", "--seat", "--seconds", "4")
    assert done.code == 0, done.stderr
    assert "actuator.resonance_hz" in done.stdout
    assert "force_factor" not in done.stdout
    assert "cannot be identified on an elastic seat" in done.stderr


@pytest.mark.sweep
@pytest.mark.parametrize(("device", "code", "words"), table("wrong-usage.toml")["calibrate"])
def test_what_cannot_be_calibrated_is_one_line_and_no_file(tmp_path, device, code, words):
    path = tmp_path / "mine.toml"
    assert words in refused(call("calibrate", "--device", *device.split(), "--out", path), code)
    assert not path.exists()


def test_a_file_that_could_not_be_used_or_written_is_refused_before_anything_is_played(tmp_path):
    for name, words in (("mine.txt", "ends in .toml"), ("no/a.toml", "no")):
        assert words in refused(call("calibrate", "--device", "twin", "--out", tmp_path / name))


def test_a_known_rig_is_never_asked_to_move_more_than_its_sweep_may(capsys):
    options, known = argparse.Namespace(level=0.25, loud=False), replace(PAPER, sources=())
    assert levelled(PAPER, SHORT, options).level == 0.25  # what is assumed limits nothing
    loud = levelled(replace(known, amplifier=replace(known.amplifier, gain=20.0)), SHORT, options)
    assert 0.0 < loud.level < 0.25
    assert "0.15 Xmax" in capsys.readouterr().err


@pytest.mark.parametrize(("level", "loud"), [(0.0, False), (0.26, False), (1.1, True), (-1, True)])
def test_a_level_is_a_share_of_full_scale_and_a_low_one_unless_asked(level, loud):
    with pytest.raises(UsageError, match="must be above 0, up to"):
        levelled(PAPER, SHORT, argparse.Namespace(level=level, loud=loud))


def test_clipping_and_a_rig_that_moves_further_than_it_says_are_refused():
    laboratory = Tampered(lambda a, _: np.clip(a, -0.5 * a.max(), 0.5 * a.max()))
    twin = SimulatedLaboratory(PAPER)
    with pytest.raises(IdentificationError, match="acceleration: "):
        calibrate(laboratory, PAPER, twin.sweep_at_excursion(SHORT))
    assert len(laboratory.levels) == 1
    small = replace(PAPER, actuator=replace(PAPER.actuator, x_max_m=2e-4))
    with pytest.raises(IdentificationError, match="moves more than it says"):
        calibrate(twin, small, twin.sweep_at_excursion(SHORT, 0.05))


@pytest.mark.exhaustive
def test_levels_rise_to_the_wanted_one():
    laboratory = Tampered(lambda a, _: a)
    sweep = SimulatedLaboratory(PAPER).sweep_at_excursion(SHORT)
    found = calibrate(laboratory, PAPER, sweep)
    assert laboratory.levels == sorted(step * sweep.level for step in STEPS)
    assert laboratory.levels[-1] == found.sweep.level
