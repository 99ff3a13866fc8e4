"""The amplifier's band, the instruments, and the twin on the adaptive."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from device.errors import UsageError
from device.rig import CONSUMER, PAPER
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.electronics import Amplifier, InstrumentChain
from device.rig.simulated_rig import SimulatedRig

FS = 48_000


def sine(frequency_hz, seconds=2.0, samplerate=FS):
    return np.sin(math.tau * frequency_hz * np.arange(round(seconds * samplerate)) / samplerate)


def amplitude(samples, frequency_hz, samplerate=FS):
    """Of the last whole second."""
    last = samples[-samplerate:]
    turns = np.exp(-2j * math.pi * frequency_hz * np.arange(samplerate) / samplerate)
    return 2.0 * abs(last @ turns) / samplerate


@pytest.mark.parametrize(("frequency_hz", "loss_db"), [(10.0, 0.5), (90.0, 0.0), (220.0, 0.0)])
def test_the_papers_amplifier_loses_half_a_decibel_at_the_end_of_its_band(frequency_hz, loss_db):
    out = Amplifier(PAPER.amplifier, FS).drive(0.1 * sine(frequency_hz))
    gain_db = 20 * math.log10(amplitude(out, frequency_hz) / 0.1 / PAPER.amplifier.gain)
    assert gain_db == pytest.approx(-loss_db, abs=0.02)


def test_a_rate_that_shows_the_upper_end_of_the_band_has_it():
    samplerate = 192_000
    out = Amplifier(PAPER.amplifier, samplerate).drive(0.1 * sine(20e3, samplerate=samplerate))
    gain_db = 20 * math.log10(amplitude(out, 20e3, samplerate) / 0.1 / PAPER.amplifier.gain)
    assert gain_db == pytest.approx(-0.5, abs=0.15)  # the digital filter is warped up there


@settings(max_examples=20)
@given(st.lists(st.integers(0, 1_000), max_size=5))
def test_band_and_noise_do_not_depend_on_the_blocks(cuts):
    motion = 20.0 * np.column_stack([sine(90.0, 1_000 / FS), sine(30.0, 1_000 / FS)])
    amplifiers = [Amplifier(PAPER.amplifier), Amplifier(PAPER.amplifier)]
    chains = [InstrumentChain(PAPER, FS, seed=3), InstrumentChain(PAPER, FS, seed=3)]
    for whole, split in (
        (amplifiers[0].drive, amplifiers[1].drive),
        (chains[0].acceleration_m_s2, chains[1].acceleration_m_s2),
    ):
        parts = [split(block) for block in np.split(motion, sorted(cuts))]
        assert np.concatenate(parts).tobytes() == whole(motion).tobytes()


def test_the_instruments_read_the_acceleration_within_their_noise():
    chain = InstrumentChain(PAPER, FS)
    read = chain.acceleration_m_s2(50.0 * sine(90.0))
    assert amplitude(read, 90.0) == pytest.approx(50.0, rel=1e-3)
    silent = InstrumentChain(PAPER, FS).acceleration_m_s2(np.zeros(4 * FS))
    assert PAPER.conditioning
    assert PAPER.daq
    # The charge amplifier's 5 fC and the converter's 280 uV; its steps add 305 uV / sqrt(12).
    expected = math.hypot(
        PAPER.conditioning.noise_pc / 0.15,
        PAPER.daq.noise_v / chain.v_per_m_s2,
        20.0 / 2**16 / math.sqrt(12) / chain.v_per_m_s2,
    )
    assert silent.std() == pytest.approx(expected, rel=0.03)
    assert chain.clipped_samples == 0


def test_what_is_beyond_an_instrument_is_clipped_and_counted():
    chain = InstrumentChain(PAPER, FS)
    read = chain.acceleration_m_s2(2_000.0 * sine(90.0, 0.1))
    assert np.abs(read).max() <= 1_000.0 * (1 + 1e-9)  # 10 V
    assert chain.clipped_samples > 1_000


def test_instruments_that_are_not_there_or_too_slow_are_refused():
    with pytest.raises(UsageError, match=r"no \[accelerometer\], \[conditioning\], \[daq\]"):
        InstrumentChain(CONSUMER, FS)
    with pytest.raises(UsageError, match="beyond the DAQ's max_samplerate_hz=1250000"):
        InstrumentChain(PAPER, 2e6)


# ------------------------------------------------------------------------------------------ twin


def test_a_twin_with_a_tolerance_moves_as_its_adaptive_actuator_does():
    vibration = np.column_stack([0.9 * sine(90.0, 0.2), 0.2 * sine(60.0, 0.2)])
    twin = SimulatedRig(PAPER, FS, 2, tolerance=1e-3)
    twin.write(vibration)
    linear = SimulatedRig(PAPER, FS, 2)
    linear.write(vibration)
    volts = Amplifier(PAPER.amplifier, FS).drive(np.round(vibration * 2**23) / 2**23)
    expected = AdaptiveActuator(PAPER, FS, 1e-3).move(np.ascontiguousarray(volts[:, 0]))
    assert np.array_equal(twin.acceleration_m_s2[:, 0], expected.acceleration_m_s2)
    difference = np.abs(twin.acceleration_m_s2 - linear.acceleration_m_s2).max(axis=0)
    # Louder, the linear twin is further off.
    assert difference[0] / 0.9 > 2 * difference[1] / 0.2 > 0.0


def test_a_current_beyond_the_amplifiers_limit_is_counted():
    weak = replace(PAPER, amplifier=replace(PAPER.amplifier, current_limit_a=0.3))
    twin = SimulatedRig(weak, FS, 1)
    twin.write(0.9 * sine(60.0, 0.1)[:, None])
    assert twin.peak_current_a > 0.3
    assert 0 < twin.overcurrent_samples < 4_800
    twin.reset()
    assert twin.overcurrent_samples == 0
