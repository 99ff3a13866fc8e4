"""The rig's soaks in short, and that each would see what it looks for."""

from itertools import count

import numpy as np
import pytest

from device.rig import PAPER
from device.rig.adaptive_actuator import AdaptiveActuator
from tests.support import rig_soak
from tests.support.random_rigs import Found
from tests.support.rig_soak import soak_energy, steady_drive
from tests.support.soak import soak_identification
from tools.bench.sections import kept_records
from tools.bench.sounds.signals import SAMPLERATE
from tools.bench.workbench import QUICK, SUBJECTS, Workbench
from tools.soak_record import SoakRecord, keep_record

SAMPLES = {"linear": 2_000_000, "nonlinear": 1_000_000}


@pytest.mark.sweep
@pytest.mark.parametrize("model", SAMPLES)
def test_the_largest_energy_of_a_steady_drive_stays_and_falls_when_it_stops(model):
    record = soak_energy(model, SAMPLES[model])
    assert (record.samples or 0) >= SAMPLES[model]
    assert record.passed, record


def test_the_drive_is_loud_enough_to_be_non_linear_and_goes_on_in_a_loop():
    volts = steady_drive(10.0)
    motion = AdaptiveActuator(PAPER, SAMPLERATE, model="nonlinear").move(volts, ("displacement_m",))
    large = PAPER.large_signal
    assert large
    assert 0.6 * PAPER.actuator.x_max_m < np.abs(motion.displacement_m).max() < large.stop_m
    # The jump at the seam is as any other from sample to sample.
    assert abs(volts[0] - volts[-1]) <= np.abs(np.diff(volts)).max()


def test_a_model_that_gains_a_millionth_in_each_loop_is_found_out(monkeypatch):
    moved, moves = rig_soak.energy_of("linear"), count(1)

    def louder(volts):
        return moved(volts) * (1.0 + 1e-6 * next(moves))

    monkeypatch.setattr(rig_soak, "energy_of", lambda _: louder)
    record = soak_energy("linear", 3_000_000)
    assert ((record.energy_creep or 0.0) > 1e-6, record.passed) == (True, False)


def test_energy_that_rises_after_the_drive_is_found_out_while_there_is_any():
    energy = np.exp(-0.01 * np.arange(6_000))
    energy[5_000] *= 2.0  # 2e-22 of what it was
    assert rig_soak.largest_rise(energy) == 0.0
    energy[1_000] = energy[999] * 1.001
    assert rig_soak.largest_rise(energy) == pytest.approx(1e-3)


@pytest.mark.exhaustive
def test_a_soak_of_the_identification_says_how_many_rigs_and_how_far_off():
    record = soak_identification(0.05, 2)
    assert (record.rigs, record.passed) == (2, True)
    assert 0.0 < (record.f0_error_percent or 0.0) < 0.5


def test_one_limit_that_is_not_kept_fails_the_soak():
    assert Found(0.1, 1, 95, 95).passed
    broken = [(0.6, 1, 95, 95), (0.1, 6, 95, 95), (0.1, 1, 89, 95), (0.1, 1, 95, 89)]
    assert not any(Found(*percents).passed for percents in broken)


def test_each_section_shows_the_records_of_its_kind_alone(monkeypatch, tmp_path):
    path = tmp_path / "soak.json"
    monkeypatch.setattr(kept_records, "record_path", lambda _: path)
    for what, fields in (
        ("a level", {"samples": 100_000_000, "energy_creep": 2e-6, "energy_rise": 0.0}),
        ("sweeps", {"rigs": 200, "f0_error_percent": 0.3, "f0_held_percent": 97.5}),
        ("a tone", {"hops": 1_000_000}),
    ):
        keep_record(SoakRecord(what, "2026-01-01", "cpu", 1.0, 1.0, True, **fields), path)
    bench = Workbench(QUICK, SUBJECTS, ())
    assert [row.name for row in kept_records.transform_soak(bench).rows] == ["a tone"]
    energies = [row for row in kept_records.rig_soak(bench).rows if "largest energy" in row.column]
    assert [(row.name, row.met) for row in energies] == [("a level", False)]
    assert [row.value for row in kept_records.identification_soak(bench).rows] == [200.0, 0.3, 97.5]
