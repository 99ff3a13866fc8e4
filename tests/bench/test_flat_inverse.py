"""The flat inverse: a rig that stiffens moves as a linear one, and damping holds up to Xmax."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from device.drive.damping import choose_damping, undamped
from device.errors import UsageError
from device.rig import CONSUMER, PAPER
from device.rig.actuator import LinearActuator
from device.rig.adaptive_actuator import AdaptiveActuator
from tools.bench.measures.flat_inverse import FlatInverse
from tools.bench.measures.large_bursts import large_burst_response, undamped_large

RATE = 48_000
X_MAX = PAPER.actuator.x_max_m
CHOSEN = choose_damping(PAPER.actuator)[0].damping


def scaled(rig, signal, level):
    """The signal in V with which the linear rig swings to a share of Xmax, and that motion."""
    source = rig.amplifier.source_impedance_ohm
    largest = np.abs(LinearActuator(rig.actuator, RATE, source).move(signal).displacement_m).max()
    volts = signal * (level * rig.actuator.x_max_m / largest)
    return volts, LinearActuator(rig.actuator, RATE, source).move(volts)


def bumps(frequencies_hz, seconds=0.2):
    """Tones that come and go together, (frames,)."""
    time_s = np.arange(round(seconds * RATE)) / RATE
    envelope = np.sin(np.pi * time_s / seconds) ** 2
    return envelope * sum(np.sin(math.tau * f * time_s) for f in frequencies_hz)


def error(got, wanted):
    return np.sqrt(np.mean((got - wanted) ** 2) / np.mean(wanted**2))


@settings(max_examples=25)
@given(
    st.lists(st.floats(0.2, 1.4), min_size=1, max_size=4),
    st.floats(0.01, 1.1),
    st.sampled_from([PAPER, CONSUMER]),
)
def test_the_rig_moves_as_the_linear_one_with_any_tones_to_beyond_xmax(ratios, level, rig):
    # Far above its resonance it would take hundreds of volts, and the motion would not be stable.
    volts, wanted = scaled(rig, bumps([r * rig.actuator.resonance_hz for r in ratios]), level)
    got = AdaptiveActuator(rig, RATE, model="nonlinear").move(FlatInverse(rig, RATE).process(volts))
    # Between samples the voltage is a straight line, and the level's nodes are at 6 kHz: 1e-4.
    assert error(got.acceleration_m_s2, wanted.acceleration_m_s2) < 1e-3
    assert error(got.displacement_m, wanted.displacement_m) < 1e-3


def test_the_third_harmonic_of_a_low_tone_is_gone_and_without_it_the_rig_moves_otherwise():
    volts, _ = scaled(PAPER, bumps([30.0], 0.5), 0.9)
    shown = []
    for drive in (volts, FlatInverse(PAPER, RATE).process(volts)):
        a = AdaptiveActuator(PAPER, RATE, model="nonlinear").move(drive).acceleration_m_s2
        spectrum = np.abs(np.fft.rfft(a * np.hanning(len(a))))
        shown.append(spectrum[45] / spectrum[15])  # bins of 2 Hz: 90 and 30 Hz
    assert shown[0] > 0.05
    assert shown[1] < 1e-3
    volts, wanted = scaled(PAPER, bumps([90.0]), 1.0)
    got = AdaptiveActuator(PAPER, RATE, model="nonlinear").move(volts)
    assert error(got.acceleration_m_s2, wanted.acceleration_m_s2) > 0.3


def against_undamped(level, flat, detuning=0.0):
    """A damped burst at a share of Xmax against an undamped one."""
    burst = large_burst_response(PAPER, CHOSEN, level * X_MAX, flat=flat, detuning=detuning)
    return burst.response.against(undamped_large(PAPER, level * X_MAX, detuning=detuning).response)


# At Xmax damping alone does not hold: -10.5 dB.
@pytest.mark.parametrize(
    ("level", "flat"), [(0.05, False), (0.05, True), (0.1, False), (0.1, True), (1.0, True)]
)
def test_damping_holds_its_limits_at_a_low_level_and_with_the_inverse_at_xmax(level, flat):
    low = (
        undamped(PAPER.actuator) if level == 1.0 else undamped_large(PAPER, level * X_MAX).response
    )
    burst = large_burst_response(PAPER, CHOSEN, level * X_MAX, flat=flat).response
    assert burst.against(low).residual_db <= -11.0
    for detuning in (-0.1, 0.1):
        assert against_undamped(level, flat, detuning).residual_db <= -7.0
    volts_db = against_undamped(level, flat).peak_volts_db
    if level < 1.0:
        assert volts_db <= 5.0
    else:
        assert 5.0 < volts_db < 11.0
        alone = large_burst_response(PAPER, CHOSEN, X_MAX, flat=False).response
        assert alone.against(low).residual_db > -10.5


@settings(max_examples=20)
@given(st.lists(st.integers(0, 4_000), max_size=8))
def test_any_split_gives_the_same_bytes_and_reset_begins_anew(cuts):
    volts, _ = scaled(PAPER, bumps([90.0], 0.1), 1.0)
    inverse = FlatInverse(PAPER, RATE)
    whole = inverse.process(volts)
    inverse.reset()
    parts = [inverse.process(part) for part in np.split(volts, sorted(cuts))]
    assert np.concatenate(parts).tobytes() == whole.tobytes()
    small = 1e-6 * volts  # is left alone
    inverse.reset()
    np.testing.assert_allclose(inverse.process(small), small, atol=1e-6 * np.abs(small).max())


@settings(max_examples=40)
@given(st.lists(st.floats() | st.sampled_from([1e4, -1e6, math.nan]), max_size=300))
def test_what_comes_out_is_finite_whatever_goes_in(volts):
    for rig in (PAPER, CONSUMER):
        assert np.isfinite(FlatInverse(rig, RATE).process(np.array(volts))).all()


def test_what_lies_beyond_the_stops_is_counted_and_a_rig_without_stiffening_is_refused():
    inverse = FlatInverse(PAPER, RATE)
    inverse.process(scaled(PAPER, bumps([90.0]), 1.0)[0])
    assert inverse.beyond_samples == 0
    inverse.process(scaled(PAPER, bumps([90.0]), 2.0)[0])
    assert inverse.beyond_samples > 0
    inverse.reset()
    assert inverse.beyond_samples == 0
    with pytest.raises(UsageError, match="large_signal"):
        FlatInverse(replace(PAPER, large_signal=None), RATE)
