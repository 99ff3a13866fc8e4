import math
from dataclasses import replace
from itertools import count
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from device.errors import InternalError, UsageError, WriteError
from device.output import VibrationOutput
from device.rig import CONSUMER, PAPER, electronics
from device.rig.actuator import LinearActuator
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.electronics import Amplifier, Dac, InstrumentChain
from device.rig.parameters import AmplifierParameters, DacParameters
from device.rig.simulated_rig import SimulatedRig
from tests.support import soak
from tests.support.outputs import KeptOutput
from tests.support.random_rigs import Found
from tests.support.soak import soak_energy, soak_identification, steady_drive
from tools.bench.sections import kept_records
from tools.bench.sounds.signals import SAMPLERATE
from tools.bench.workbench import QUICK, SUBJECTS, Workbench
from tools.soak_record import SoakRecord, keep_record

FS = 48_000
V_PER_M_S2 = electronics.CONDITIONING_V_PER_M_S2
LOUD = replace(PAPER, amplifier=replace(PAPER.amplifier, gain=12.0, output_limit_v=50.0))
"""The rig with a stronger amplifier: full scale is beyond the linear model."""


def sine(frequency_hz, seconds=2.0, samplerate=FS):
    return np.sin(math.tau * frequency_hz * np.arange(round(seconds * samplerate)) / samplerate)


def amplitude(samples, frequency_hz, samplerate=FS):
    """Of the last whole second."""
    last = samples[-samplerate:]
    turns = np.exp(-2j * math.pi * frequency_hz * np.arange(samplerate) / samplerate)
    return 2.0 * abs(last @ turns) / samplerate


# At 192 kHz the upper end shows, where the digital filter is warped.
@pytest.mark.parametrize(
    ("samplerate", "frequency_hz", "loss_db"),
    [(FS, 10.0, 0.5), (FS, 90.0, 0.0), (FS, 220.0, 0.0), (192_000, 2e4, 0.5)],
)
def test_the_papers_amplifier_loses_half_a_decibel_at_its_ends(samplerate, frequency_hz, loss_db):
    within_db = 0.02 if samplerate == FS else 0.15
    amplifier = Amplifier(PAPER.amplifier, samplerate)
    out = amplifier.drive(0.1 * sine(frequency_hz, samplerate=samplerate))
    gain = amplitude(out, frequency_hz, samplerate) / 0.1 / PAPER.amplifier.gain
    assert 20 * math.log10(gain) == pytest.approx(-loss_db, abs=within_db)


@settings(max_examples=20)
@given(st.lists(st.integers(0, 1_000), max_size=5))
def test_band_and_noise_do_not_depend_on_the_blocks(cuts):
    motion = 20.0 * np.column_stack([sine(90.0, 1_000 / FS), sine(30.0, 1_000 / FS)])
    for made in (
        lambda: Amplifier(PAPER.amplifier).drive,
        lambda: InstrumentChain(PAPER, FS, seed=3).acceleration_m_s2,
    ):
        whole, split = made(), made()
        parts = [split(block) for block in np.split(motion, sorted(cuts))]
        assert np.concatenate(parts).tobytes() == whole(motion).tobytes()


def test_the_instruments_read_the_acceleration_within_their_noise():
    chain = InstrumentChain(PAPER, FS)
    read = chain.acceleration_m_s2(50.0 * sine(90.0))
    assert amplitude(read, 90.0) == pytest.approx(50.0, rel=1e-3)
    silent, paper = InstrumentChain(PAPER, FS).acceleration_m_s2(np.zeros(4 * FS)), cast(Any, PAPER)
    # The charge amplifier's 5 fC and the converter's 280 uV; its steps add 305 uV / sqrt(12).
    charge = paper.conditioning.noise_pc / 0.15
    step_v = 20.0 / 2**16 / math.sqrt(12)
    expected = math.hypot(charge, math.hypot(paper.daq.noise_v, step_v) / chain.v_per_m_s2)
    assert (silent.std(), chain.clipped_samples) == (pytest.approx(expected, rel=0.03), 0)


def test_what_is_beyond_an_instrument_is_clipped_and_counted_as_is_the_amplifiers_current():
    chain = InstrumentChain(PAPER, FS)
    read = chain.acceleration_m_s2(2_000.0 * sine(90.0, 0.1))
    assert np.abs(read).max() <= 1_000.0 * (1 + 1e-9)  # 10 V
    assert chain.clipped_samples > 1_000
    weak = replace(PAPER, amplifier=replace(PAPER.amplifier, current_limit_a=0.3))
    twin = SimulatedRig(weak, FS, 1)
    twin.write(0.9 * sine(60.0, 0.1)[:, None])
    assert twin.peak_current_a > 0.3
    assert 0 < twin.overcurrent_samples < 4_800
    twin.reset()
    assert twin.overcurrent_samples == 0


@given(st.integers(8, 32), st.floats(-1, 1, width=32), st.floats(0.01, 10), st.sampled_from("fd"))
def test_the_dac_is_off_by_half_a_step_at_most(bits, sample, full_scale_v, dtype):
    step_v = full_scale_v / 2 ** (bits - 1)
    dac = Dac(DacParameters(bits, full_scale_v))
    volts = dac.volts(np.array([sample], dtype))[0]
    # Half a step; a whole one at the very top. 1e-12: rounding of the product.
    allowed = step_v / 2 if sample <= 1 - 1 / 2 ** (bits - 1) else step_v
    assert abs(volts - sample * full_scale_v) <= allowed * (1 + 1e-12) + 1e-15
    assert volts / step_v == pytest.approx(round(volts / step_v), abs=1e-5)
    assert dac.clipped_samples == 0


def test_dac_and_amplifier_saturate_and_count_what_is_beyond_full_scale():
    dac = Dac(DacParameters(bits=16, full_scale_v=2.0))
    samples = np.array([[1.0, -1.0], [1.001, -1.7e308], [math.nan, math.inf]])
    top = 2.0 * (1 - 2**-15)
    assert dac.volts(samples).tolist() == [[top, -2.0], [top, -2.0], [0.0, 0.0]]
    assert (dac.clipped_samples, dac.replaced_samples) == (2, 2)
    assert np.isnan(samples[2, 0])  # the caller's array is left alone
    dac.reset()
    assert (dac.clipped_samples, dac.replaced_samples) == (0, 0)
    amplifier = Amplifier(AmplifierParameters(10.0, output_limit_v=5.0, source_impedance_ohm=0.0))
    assert amplifier.drive(np.array([0.1, -0.5, 0.6, -9.0])).tolist() == [1.0, -5.0, 5.0, -5.0]
    assert amplifier.clipped_samples == 2
    amplifier.reset()
    assert amplifier.clipped_samples == 0


def test_steady_full_scale_vibration_at_90_hz_gives_the_acceleration_that_the_rig_states():
    twin = SimulatedRig(PAPER, FS, 1)
    twin.write(sine(90.0, 1.0)[:, None])
    twin.write(sine(90.0, 1.0)[:, None])  # 90 whole periods each: the second is steady
    last = twin.acceleration_m_s2
    assert np.abs(last).max() == pytest.approx(89.1, abs=0.05)
    displacement_m = np.abs(last).max() / (math.tau * 90.0) ** 2
    assert displacement_m == pytest.approx(0.28e-3, abs=0.005e-3)
    assert twin.peak_acceleration_m_s2 < electronics.ACCELERATION_FULL_SCALE_M_S2
    # Driven from rest at its resonance the motion grows to the steady one; it hardly overshoots.
    assert twin.peak_displacement_m == pytest.approx(displacement_m, rel=0.1)
    assert twin.clipped_samples == 0


@pytest.mark.parametrize("tolerance", [None, 1e-3])
def test_the_twin_is_its_stages_one_after_the_other(tolerance):
    source = replace(PAPER.amplifier, source_impedance_ohm=2.0, output_limit_v=1.0)
    rig = replace(PAPER, amplifier=source, dac=DacParameters(bits=12, full_scale_v=0.8))
    vibration = np.column_stack([sine(90.0, 0.2), 1.5 * sine(60.0, 0.2)])
    recorder = KeptOutput(FS, 2)
    twin = SimulatedRig(rig, FS, 2, recorder=recorder, tolerance=tolerance)
    twin.write(vibration)
    volts = Amplifier(source, FS).drive(Dac(rig.dac).volts(vibration))
    motions = []
    for column in np.ascontiguousarray(volts.T):
        linear = LinearActuator(rig.actuator, FS, 2.0)
        motions.append((AdaptiveActuator(rig, FS, tolerance) if tolerance else linear).move(column))
    accelerations = [motion.acceleration_m_s2 for motion in motions]
    assert np.array_equal(twin.acceleration_m_s2, np.column_stack(accelerations))
    assert np.array_equal(recorder.whole, twin.acceleration_m_s2 * V_PER_M_S2)
    assert twin.peak_current_a == max(np.abs(motion.current_a).max() for motion in motions)
    assert twin.clipped_samples > 0


@pytest.mark.parametrize(("rig", "tolerance"), [(PAPER, None), (LOUD, 0.01)])
@settings(deadline=None, max_examples=15)
@given(st.lists(st.integers(0, 9_000), min_size=1, max_size=8))
def test_peaks_counts_and_record_do_not_depend_on_the_blocks(rig, tolerance, sizes):
    # From silence to beyond the linear model and back: the choice changes between blocks.
    frames = sum(sizes)
    level = 1.2 * np.sin(np.linspace(0.0, math.pi, frames)) ** 3
    sines = [sine(90.0, frames / FS), 0.3 * sine(50.0, frames / FS)]
    vibration = level[:, None] * np.column_stack(sines)
    vibration[::50] = math.nan
    twins = []
    for blocks in ([vibration], np.split(vibration, np.cumsum(sizes)[:-1])):
        recorder = KeptOutput(FS, 2)
        twin = SimulatedRig(rig, FS, 2, recorder=recorder, tolerance=tolerance)
        moved = []
        for block in blocks:
            twin.write(block)
            moved.append(twin.acceleration_m_s2)
        twin.close()
        if tolerance:
            moved.append(twin.acceleration_m_s2)
        record = np.concatenate(recorder.blocks)
        assert np.array_equal(np.concatenate(moved) * V_PER_M_S2, record)
        assert len(record) == frames
        peaks = (twin.peak_acceleration_m_s2, twin.peak_displacement_m, twin.peak_current_a)
        assert np.isfinite(peaks).all()
        twins.append((peaks, twin.clipped_samples, twin.replaced_samples, record.tobytes()))
    assert twins[0] == twins[1]


@pytest.mark.parametrize("names", [("close", "close", "abort"), ("abort", "abort", "close")])
def test_the_recorder_is_finished_once_in_the_way_asked_for_first(names):
    recorder = KeptOutput(FS, 2)
    twin: VibrationOutput = SimulatedRig(PAPER, FS, 2, recorder=recorder)
    for name in names:
        getattr(twin, name)()
    assert recorder.ended == ["closed" if names[0] == "close" else "aborted"]
    with pytest.raises(InternalError, match="closed"):
        twin.write(np.zeros((1, 2)))


def test_a_failing_recorder_is_heard_of():
    class Full(KeptOutput):
        def write(self, vibration):
            raise WriteError("cannot write a.wav: the disk is full")

    with pytest.raises(WriteError, match="disk is full"):
        SimulatedRig(PAPER, FS, 2, recorder=Full(FS, 2)).write(np.zeros((1, 2)))


def test_reset_brings_the_twin_to_rest():
    twin = SimulatedRig(PAPER, FS, 1)
    twin.write(np.full((100, 1), 2.0))
    first = twin.acceleration_m_s2
    twin.reset()
    assert (twin.peak_acceleration_m_s2, twin.clipped_samples) == (0.0, 0)
    assert twin.acceleration_m_s2.shape == (0, 1)
    twin.write(np.full((100, 1), 2.0))
    assert np.array_equal(twin.acceleration_m_s2, first)


def test_what_does_not_fit_the_twin_or_its_instruments_is_refused():
    with pytest.raises(UsageError, match=r"no \[accelerometer\], \[conditioning\], \[daq\]"):
        InstrumentChain(CONSUMER, FS)
    with pytest.raises(UsageError, match="beyond the DAQ's max_samplerate_hz=1250000"):
        InstrumentChain(PAPER, 2e6)
    with pytest.raises(UsageError, match="samplerate=999"):
        SimulatedRig(PAPER, 999, 1)
    with pytest.raises(InternalError, match="channels=0"):
        SimulatedRig(PAPER, FS, 0)
    with pytest.raises(InternalError, match="the recorder needs 2 channels at 48000 Hz"):
        SimulatedRig(PAPER, 44_100, 2, recorder=KeptOutput(FS, 2))
    for shape in [(10,), (10, 2)]:
        with pytest.raises(InternalError, match="shape"):
            SimulatedRig(PAPER, FS, 1).write(np.zeros(shape))


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
    large: Any = PAPER.large_signal
    assert 0.6 * PAPER.actuator.x_max_m < np.abs(motion.displacement_m).max() < large.stop_m
    # The jump at the seam is as any other from sample to sample.
    assert abs(volts[0] - volts[-1]) <= np.abs(np.diff(volts)).max()


def test_a_model_that_gains_a_millionth_in_each_loop_is_found_out(monkeypatch):
    moved, moves = soak.energy_of("linear"), count(1)

    def louder(volts):
        return moved(volts) * (1.0 + 1e-6 * next(moves))

    monkeypatch.setattr(soak, "energy_of", lambda _: louder)
    record = soak_energy("linear", 3_000_000)
    assert ((record.energy_creep or 0.0) > 1e-6, record.passed) == (True, False)


def test_energy_that_rises_after_the_drive_is_found_out_while_there_is_any():
    energy = np.exp(-0.01 * np.arange(6_000))
    energy[5_000] *= 2.0  # 2e-22 of what it was
    assert soak.largest_rise(energy) == 0.0
    energy[1_000] = energy[999] * 1.001
    assert soak.largest_rise(energy) == pytest.approx(1e-3)


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
