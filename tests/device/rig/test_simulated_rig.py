"""The twin and its stages: from full-scale samples to the volts that the instruments show."""

import math
from dataclasses import replace

import numpy as np
import pytest
import soundfile
from hypothesis import given, settings
from hypothesis import strategies as st

from device.errors import InternalError, UsageError, WriteError
from device.output import VibrationOutput
from device.rig import PAPER
from device.rig.actuator import LinearActuator
from device.rig.electronics import (
    ACCELERATION_FULL_SCALE_M_S2,
    CONDITIONING_V_PER_M_S2,
    Amplifier,
    Dac,
)
from device.rig.parameters import AmplifierParameters, DacParameters
from device.rig.simulated_rig import SimulatedRig
from device.wav_output import WavOutput

LOUD = replace(PAPER, amplifier=replace(PAPER.amplifier, gain=12.0, output_limit_v=50.0))
"""The rig with a stronger amplifier: full scale is beyond the linear model."""


def steady(frames, frequency_hz=90.0, samplerate=48_000):
    return np.sin(math.tau * frequency_hz * np.arange(frames) / samplerate)


class Recorder:
    """A VibrationOutput that keeps what happens to it."""

    samplerate = 48_000
    channels = 2

    def __init__(self):
        self.blocks, self.calls = [], []

    def write(self, vibration):
        self.blocks.append(vibration.copy())

    def close(self):
        self.calls.append("close")

    def abort(self):
        self.calls.append("abort")


# -------------------------------------------------------------------------------------- stages


@given(st.integers(8, 32), st.floats(-1, 1), st.floats(0.01, 10))
def test_the_dac_is_off_by_half_a_step_at_most(bits, sample, full_scale_v):
    step_v = full_scale_v / 2 ** (bits - 1)
    dac = Dac(DacParameters(bits, full_scale_v))
    volts = dac.volts(np.array([sample]))[0]
    # Half a step; a whole one at the very top. 1e-12: rounding of the product.
    allowed = step_v / 2 if sample <= 1 - 1 / 2 ** (bits - 1) else step_v
    assert abs(volts - sample * full_scale_v) <= allowed * (1 + 1e-12) + 1e-15
    assert volts / step_v == pytest.approx(round(volts / step_v), abs=1e-5)
    assert dac.clipped_samples == 0


def test_the_dac_saturates_and_counts_what_is_beyond_full_scale():
    dac = Dac(DacParameters(bits=16, full_scale_v=2.0))
    samples = np.array([[1.0, -1.0], [1.001, -1.7e308], [math.nan, math.inf]])
    top = 2.0 * (1 - 2**-15)
    assert dac.volts(samples).tolist() == [[top, -2.0], [top, -2.0], [0.0, 0.0]]
    assert (dac.clipped_samples, dac.replaced_samples) == (2, 2)
    assert np.isnan(samples[2, 0])  # the caller's array is left alone
    dac.reset()
    assert (dac.clipped_samples, dac.replaced_samples) == (0, 0)


def test_the_dac_takes_float32_and_keeps_every_bit_of_it_down_to_its_step():
    samples = np.random.default_rng(3).uniform(-0.9, 0.9, 1_000).astype(np.float32)
    volts = Dac(DacParameters(bits=32, full_scale_v=1.0)).volts(samples)
    assert np.abs(volts - samples).max() <= 2.0**-32


def test_the_amplifier_amplifies_and_counts_what_it_clips():
    amplifier = Amplifier(AmplifierParameters(10.0, output_limit_v=5.0, source_impedance_ohm=0.0))
    assert amplifier.drive(np.array([0.1, -0.5, 0.6, -9.0])).tolist() == [1.0, -5.0, 5.0, -5.0]
    assert amplifier.clipped_samples == 2
    amplifier.reset()
    assert amplifier.clipped_samples == 0


def test_the_instruments_show_one_volt_for_a_hundred_metres_a_second_squared():
    assert ACCELERATION_FULL_SCALE_M_S2 == 100.0
    assert (np.array([100.0, -50.0]) * CONDITIONING_V_PER_M_S2).tolist() == [1.0, -0.5]


# ----------------------------------------------------------------------------------------- twin


def test_steady_full_scale_vibration_at_90_hz_gives_the_acceleration_that_the_rig_states():
    twin = SimulatedRig(PAPER, 48_000, 1)
    twin.write(steady(48_000)[:, None])
    twin.write(steady(48_000)[:, None])  # 90 whole periods each: the second is steady
    last = twin.acceleration_m_s2
    assert np.abs(last).max() == pytest.approx(89.1, abs=0.05)
    displacement_m = np.abs(last).max() / (math.tau * 90.0) ** 2
    assert displacement_m == pytest.approx(0.28e-3, abs=0.005e-3)
    assert twin.peak_acceleration_m_s2 < ACCELERATION_FULL_SCALE_M_S2
    # Driven from rest at its resonance the motion grows to the steady one; it hardly overshoots.
    assert twin.peak_displacement_m == pytest.approx(displacement_m, rel=0.1)
    assert twin.clipped_samples == 0


def test_the_twin_is_its_stages_one_after_the_other():
    source = replace(PAPER.amplifier, source_impedance_ohm=2.0, output_limit_v=1.0)
    rig = replace(PAPER, amplifier=source, dac=DacParameters(bits=12, full_scale_v=0.8))
    vibration = np.column_stack([steady(500), 1.5 * steady(500, 60.0)])
    recorder = Recorder()
    twin = SimulatedRig(rig, 48_000, 2, recorder=recorder)
    twin.write(vibration)
    volts = Amplifier(source).drive(Dac(rig.dac).volts(vibration))
    motions = [LinearActuator(rig.actuator, 48_000, 2.0).move(volts[:, c]) for c in range(2)]
    accelerations = [motion.acceleration_m_s2 for motion in motions]
    assert np.array_equal(twin.acceleration_m_s2, np.column_stack(accelerations))
    assert np.array_equal(recorder.blocks[0], twin.acceleration_m_s2 * CONDITIONING_V_PER_M_S2)
    assert twin.peak_current_a == max(np.abs(motion.current_a).max() for motion in motions)
    assert twin.clipped_samples > 0


@given(st.lists(st.integers(0, 300), min_size=1, max_size=8))
def test_peaks_counts_and_record_do_not_depend_on_the_blocks(sizes):
    vibration = 1.2 * np.random.default_rng(4).standard_normal((sum(sizes), 2))
    vibration[::50] = math.nan
    twins = []
    for blocks in ([vibration], np.split(vibration, np.cumsum(sizes)[:-1])):
        recorder = Recorder()
        twin = SimulatedRig(PAPER, 48_000, 2, recorder=recorder)
        for block in blocks:
            twin.write(block)
        peaks = (twin.peak_acceleration_m_s2, twin.peak_displacement_m, twin.peak_current_a)
        record = np.concatenate(recorder.blocks).tobytes()
        twins.append((peaks, twin.clipped_samples, twin.replaced_samples, record))
    assert twins[0] == twins[1]
    assert np.isfinite(twins[0][0]).all()


@settings(deadline=None, max_examples=10)
@given(st.lists(st.integers(0, 9_000), min_size=1, max_size=8))
def test_a_record_of_chosen_models_has_the_same_bytes_however_it_was_cut(sizes):
    # From silence to beyond the linear model and back: the choice changes between blocks.
    frames = sum(sizes)
    level = np.sin(np.linspace(0.0, math.pi, frames)) ** 3
    vibration = np.column_stack([level * steady(frames), 0.3 * level * steady(frames, 50.0)])
    twins = []
    for blocks in ([vibration], np.split(vibration, np.cumsum(sizes)[:-1])):
        recorder = Recorder()
        twin = SimulatedRig(LOUD, 48_000, 2, recorder=recorder, tolerance=0.01)
        moved = []
        for block in blocks:
            twin.write(block)
            moved.append(twin.acceleration_m_s2)
        twin.close()
        moved.append(twin.acceleration_m_s2)
        record = np.concatenate(recorder.blocks)
        assert np.array_equal(np.concatenate(moved) * CONDITIONING_V_PER_M_S2, record)
        peaks = (twin.peak_acceleration_m_s2, twin.peak_displacement_m, twin.peak_current_a)
        twins.append((peaks, twin.clipped_samples, record.tobytes()))
        assert len(record) == frames
    assert twins[0] == twins[1]


def test_a_recorded_acceleration_is_a_wav_file_in_volts(tmp_path):
    recorder = WavOutput(tmp_path / "acceleration.wav", 48_000, 1)
    twin = SimulatedRig(PAPER, 48_000, 1, recorder=recorder)
    twin.write(steady(4_800).astype(np.float32)[:, None])
    twin.close()
    samples, rate = soundfile.read(tmp_path / "acceleration.wav")
    assert rate == 48_000
    # Half a step of float32 near 1.
    recorded = samples * ACCELERATION_FULL_SCALE_M_S2
    assert np.abs(recorded - twin.acceleration_m_s2[:, 0]).max() <= 100 * 2.0**-24


@pytest.mark.parametrize(("first", "then"), [("close", "abort"), ("abort", "close")])
def test_the_recorder_is_finished_once_in_the_way_asked_for_first(first, then):
    recorder = Recorder()
    twin: VibrationOutput = SimulatedRig(PAPER, 48_000, 2, recorder=recorder)
    for name in (first, first, then):
        getattr(twin, name)()
    assert recorder.calls == [first]
    with pytest.raises(InternalError, match="closed"):
        twin.write(np.zeros((1, 2)))


def test_a_failing_recorder_is_heard_of():
    class Full(Recorder):
        def write(self, vibration):
            raise WriteError("cannot write a.wav: the disk is full")

    with pytest.raises(WriteError, match="disk is full"):
        SimulatedRig(PAPER, 48_000, 2, recorder=Full()).write(np.zeros((1, 2)))


def test_reset_brings_the_twin_to_rest():
    twin = SimulatedRig(PAPER, 48_000, 1)
    twin.write(np.full((100, 1), 2.0))
    first = twin.acceleration_m_s2
    twin.reset()
    assert (twin.peak_acceleration_m_s2, twin.clipped_samples) == (0.0, 0)
    assert twin.acceleration_m_s2.shape == (0, 1)
    twin.write(np.full((100, 1), 2.0))
    assert np.array_equal(twin.acceleration_m_s2, first)


def test_what_does_not_fit_the_twin_is_refused():
    with pytest.raises(UsageError, match="samplerate=999"):
        SimulatedRig(PAPER, 999, 1)
    with pytest.raises(InternalError, match="channels=0"):
        SimulatedRig(PAPER, 48_000, 0)
    with pytest.raises(InternalError, match="the recorder needs 2 channels at 48000 Hz"):
        SimulatedRig(PAPER, 44_100, 2, recorder=Recorder())
    for shape in [(10,), (10, 2)]:
        with pytest.raises(InternalError, match="shape"):
            SimulatedRig(PAPER, 48_000, 1).write(np.zeros(shape))
