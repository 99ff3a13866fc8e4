"""Exposure: Wk against its formula, doses against sums by hand, and the meter against both."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, sosfilt, sosfreqz

from device.drive.exposure import ExposureMeter, cap_gain
from device.drive.exposure.dose import (
    ACTION_A8_M_S2,
    DAY_S,
    LIMIT_A8_M_S2,
    LIMIT_VDV,
    PARTS,
    Dose,
    Exposure,
    wk_sections,
)
from device.drive.exposure.meter import Decimator
from device.errors import InternalError, UsageError
from device.rig import CONSUMER, PAPER
from device.rig.actuator import SEAT_ACCELERATION, LinearActuator
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.model_levels import ModelLevel
from device.rig.seat import SeatMotion

RATES = [8_000, 11_025, 16_000, 22_050, 32_000, 44_100, 48_000, 96_000, 192_000]
BAND_HZ = np.geomspace(0.5, 80.0, 200)
NOTHING = Exposure(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
BARE = replace(PAPER, seat=None)


def tone(frequency_hz, amplitude, seconds, samplerate):
    time_s = np.arange(round(seconds * samplerate)) / samplerate
    return amplitude * np.sin(math.tau * frequency_hz * time_s)[:, None]


# --------------------------------------------------------------------------------- weighting


def wk_response(frequency_hz):
    """The complex factor of Wk at each frequency in Hz, from the formula of the standard."""
    s = 2j * np.pi * frequency_hz
    response = np.ones_like(s)
    for numerator, denominator, _ in PARTS:
        response *= np.polyval(numerator, s) / np.polyval(denominator, s)
    return response


# ISO 2631-1:1997, table 3: factors times 1000 at third-octave centres, rounded to three digits.
@pytest.mark.parametrize(
    ("nominal_hz", "factor"),
    [(0.5, 0.418), (1.0, 0.482), (2.0, 0.531), (4.0, 0.967), (5.0, 1.039), (8.0, 1.036),
     (12.5, 0.902), (16.0, 0.768), (20.0, 0.636), (31.5, 0.405), (40.0, 0.314), (63.0, 0.186),
     (80.0, 0.132)],
)  # fmt: skip
def test_the_formula_gives_the_table_of_the_standard(nominal_hz, factor):
    assert abs(wk_response(np.array(nominal_hz))) == pytest.approx(
        factor, abs=1e-3
    )  # its last digit


@pytest.mark.parametrize("samplerate", [2_000, 3_000, 6_000, *RATES])
def test_the_sections_are_within_one_percent_of_the_formula_from_half_a_hertz_to_80(samplerate):
    _, response = sosfreqz(wk_sections(samplerate), BAND_HZ, fs=samplerate)
    error = np.abs(response / wk_response(BAND_HZ) - 1.0).max()  # phase counts, too
    assert error < 0.01
    # What is left of the bilinear transform's bent scale, where each part is exact at its own
    # frequency: (w T)^2 / 12 at 80 Hz.
    assert error < 1.05 * (math.tau * 80.0 / samplerate) ** 2 / 12


@pytest.mark.parametrize("samplerate", RATES)
@pytest.mark.parametrize("frequency_hz", [0.5, 20.0, 80.0])
def test_a_filtered_tone_has_the_level_that_the_formula_gives(samplerate, frequency_hz):
    seconds = 4.0 + 4.0 / frequency_hz
    weighted = sosfilt(wk_sections(samplerate), tone(frequency_hz, 1.0, seconds, samplerate)[:, 0])
    late = weighted[-round(2.0 / frequency_hz * samplerate) :]
    expected = abs(wk_response(np.array(frequency_hz))) / math.sqrt(2.0)
    # 1 %: what is left of the beginning, at 0.4 Hz and Q 0.7, is e^-20.
    assert np.sqrt(np.mean(late**2)) == pytest.approx(expected, rel=0.01)


def test_float64_sections_hold_where_one_polynomial_does_not():
    sections = wk_sections(192_000)
    _, response = sosfreqz(sections, np.array([0.5]), fs=192_000)
    assert abs(response[0]) == pytest.approx(0.41825, rel=1e-4)
    assert sections.dtype == np.float64


# -------------------------------------------------------------------------------------- dose


def dose_of(weighted, samplerate=1_000):
    dose = Dose(samplerate, weighted.shape[1])
    dose.add(weighted)
    return dose.exposure()


def test_half_an_hour_of_one_m_s2_is_a_quarter_over_eight_hours():
    # 1 m/s^2 for 0.5 h: A(8) = sqrt(0.5 / 8) = 0.25; VDV = 1800^(1/4) = 6.51.
    dose = Dose(200, 1)
    for _ in range(30):
        dose.add(np.ones((60 * 200, 1)))
    exposure = dose.exposure()
    assert exposure.time_s == pytest.approx(1800.0)
    assert exposure.rms_m_s2 == pytest.approx(1.0)
    assert exposure.a8_m_s2 == pytest.approx(0.25, rel=1e-9)
    assert exposure.vdv == pytest.approx(1800**0.25, rel=1e-9)


def test_a_sine_of_two_for_a_minute_by_hand():
    # mean square 2, mean fourth power 3/8 * 16 = 6
    exposure = dose_of(tone(10.0, 2.0, 60.0, 1_000))
    assert exposure.a8_m_s2 == pytest.approx(math.sqrt(2.0 * 60.0 / DAY_S), rel=1e-9)
    assert exposure.vdv == pytest.approx((6.0 * 60.0) ** 0.25, rel=1e-9)


def test_one_knock_counts_more_in_vdv_than_in_the_mean():
    # 50 m/s^2 for 10 ms in a minute of silence: energy 25, fourth power 62 500
    knock = np.zeros((60_000, 1))
    knock[30_000:30_010] = 50.0
    exposure = dose_of(knock)
    assert exposure.rms_m_s2 == pytest.approx(math.sqrt(25.0 / 60.0), rel=1e-9)
    assert exposure.vdv == pytest.approx(62_500**0.25, rel=1e-9)


def test_the_running_mean_forgets_by_e_in_a_second():
    samples = np.concatenate([np.ones((20_000, 1)), np.zeros((1_000, 1))])
    exposure = dose_of(samples)
    assert exposure.running_m_s2**2 == pytest.approx(math.exp(-1.0), rel=1e-3)


def test_the_worst_channel_is_shown():
    exposure = dose_of(np.tile([[0.1, 3.0, 0.2]], (1_000, 1)))
    assert exposure.rms_m_s2 == pytest.approx(3.0)


def test_each_reading_is_of_the_channel_where_it_is_largest():
    # One channel hums with 0.5 m/s^2 for 20 s, the other knocks once with 20 for 10 ms.
    weighted = np.zeros((20_000, 2))
    weighted[:, 0] = 0.5
    weighted[-10:, 1] = 20.0
    hum, knock = dose_of(weighted[:, :1]), dose_of(weighted[:, 1:])
    assert (hum.a8_m_s2 > knock.a8_m_s2, hum.vdv < knock.vdv) == (True, True)
    both = dose_of(weighted)
    assert (both.a8_m_s2, both.rms_m_s2) == (hum.a8_m_s2, hum.rms_m_s2)
    assert both.vdv == knock.vdv
    assert both.running_m_s2 == max(hum.running_m_s2, knock.running_m_s2) == knock.running_m_s2


def test_a_value_that_one_quiet_channel_exceeds_is_told():
    # 100 m/s^2 for 1 ms: VDV 17.8 above its action value, while the other has the larger A(8).
    weighted = np.zeros((60_000, 2))
    weighted[:, 0] = 1.0
    weighted[7, 1] = 100.0
    assert not dose_of(weighted[:, :1]).above_action
    assert dose_of(weighted).above_action


def test_values_of_the_directive_are_told():
    over = replace(NOTHING, a8_m_s2=0.5)
    assert over.above_action
    assert not over.above_limit
    assert not replace(NOTHING, a8_m_s2=0.49, vdv=9.0).above_action
    assert replace(NOTHING, vdv=21.0).above_limit


def test_it_says_how_much_is_extrapolated():
    low, high = (dose_of(tone(f, 1.0, 20.0, 6_000), 6_000) for f in (30.0, 180.0))
    assert low.extrapolated < 0.001  # 4th order: (30/80)^8
    assert high.extrapolated > 0.99
    assert "99 % of it above 80 Hz, extrapolated" in str(replace(high, extrapolated=0.99))


# --------------------------------------------------------------------------------------- cap


def test_the_cap_leaves_alone_what_is_under_half_of_the_limits():
    used = replace(NOTHING, a8_m_s2=0.70 * LIMIT_A8_M_S2, vdv=0.8 * LIMIT_VDV)
    assert cap_gain(used, LIMIT_A8_M_S2, LIMIT_VDV) == 1.0
    assert cap_gain(replace(used, a8_m_s2=2.0), LIMIT_A8_M_S2, LIMIT_VDV) == 0.0
    assert cap_gain(replace(used, vdv=30.0), LIMIT_A8_M_S2, LIMIT_VDV) == 0.0


@pytest.mark.parametrize("level", [1.0, 3.0, 8.0])
def test_no_level_takes_a_day_over_its_limit_with_the_cap(level):
    squares = fourths = 0.0
    gains, exposure = [], NOTHING
    for _ in range(36_000):  # a tenth of a second each, as the meter looks, for an hour
        gain = cap_gain(exposure, ACTION_A8_M_S2, 9.1)
        gains.append(gain)
        squares += 0.1 * (gain * level) ** 2
        fourths += 0.1 * (gain * level) ** 4
        exposure = replace(NOTHING, a8_m_s2=math.sqrt(squares / DAY_S), vdv=fourths**0.25)
    assert exposure.a8_m_s2 <= ACTION_A8_M_S2
    assert exposure.vdv <= 9.1
    assert np.diff(gains).max() <= 0.0
    if level > 1.0:
        # It did come near: without the cap VDV would be 23 and 62.
        assert exposure.vdv > 0.95 * 9.1
        assert gains[-1] < 0.5


# ------------------------------------------------------------------------------------- meter


def test_a_decimated_stream_keeps_what_is_low_and_folds_nothing_onto_it():
    for factor in (2, 8, 32):
        rate = 6_000 * factor
        for frequency_hz, share, tolerance in [(80, 1.0, 1e-3), (220, 1.0, 1e-3)]:
            stream = tone(frequency_hz, 1.0, 0.5, rate)
            low = Decimator(factor, 1).process(stream)[600:, 0]
            assert np.sqrt(2 * np.mean(low**2)) == pytest.approx(share, abs=tolerance)
        folded = Decimator(factor, 1).process(tone(6_000 - 80, 1.0, 0.5, rate))[600:, 0]
        assert np.abs(folded).max() < 2e-4  # 80 dB, and the ripple beside it


@pytest.mark.parametrize("samplerate", RATES)
@pytest.mark.parametrize("frequency_hz", [20.0, 40.0, 80.0])
def test_the_meter_shows_what_actuator_and_formula_give(samplerate, frequency_hz):
    meter = ExposureMeter(BARE, samplerate, 1)
    amplitude = 0.5
    meter.process(tone(frequency_hz, amplitude, 6.0, samplerate))
    p = PAPER.actuator
    s = 2j * math.pi * frequency_hz
    impedance = p.resistance_ohm + s * p.inductance_h
    spring = p.moving_mass_kg * s**2 + p.damping_n_s_per_m * s + p.stiffness_n_per_m
    back = p.force_factor_n_per_a**2 * s
    acceleration = s**2 * p.force_factor_n_per_a * 2.5 * amplitude / (spring * impedance + back)
    expected = abs(acceleration * wk_response(np.array(frequency_hz))) / math.sqrt(2)
    # 1 %: the mean over the last second has ripple and e^-6 of what was not there yet.
    assert meter.exposure().running_m_s2 == pytest.approx(expected, rel=0.01)


def test_at_48_khz_it_is_as_good_as_computing_at_the_full_rate():
    rng = np.random.default_rng(3)
    drive = np.cumsum(rng.standard_normal(96_000))
    drive = np.diff(drive, prepend=0.0)[:, None] * 0.2
    drive = sosfilt(np.array([[1e-4, 2e-4, 1e-4, 1, -1.97, 0.9702]]), drive, axis=0)
    drive /= np.abs(drive).max()
    meter = ExposureMeter(BARE, 48_000, 1)
    meter.process(drive)
    volts = 2.5 * drive[:, 0]
    acceleration = LinearActuator(PAPER.actuator, 48_000).move(volts).acceleration_m_s2
    weighted = sosfilt(wk_sections(48_000), acceleration)
    expected = math.sqrt(np.mean(weighted**2))
    # The decimator is 3 frames late: that much of the end is missing.
    assert meter.exposure().rms_m_s2 == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("rig", [PAPER, CONSUMER], ids=["paper", "consumer"])
@pytest.mark.parametrize("samplerate", [6_000, 7_350, 48_000])
def test_the_seat_moves_as_that_of_the_adaptive_actuator_linear_model(rig, samplerate):
    noise = np.random.default_rng(4).standard_normal(samplerate // 2)
    volts = sosfilt(butter(4, 300.0, fs=samplerate, output="sos"), noise)
    source = rig.amplifier.source_impedance_ohm
    motion = SeatMotion(rig.actuator, rig.seat, samplerate, source, 2)
    both = volts[:, None].repeat(2, axis=1)
    got = np.concatenate([motion.move(part)[:, 1] for part in np.split(both, [100, 1_000])])
    adaptive = AdaptiveActuator(rig, samplerate, level=ModelLevel.LINEAR, seat=True)
    expected = adaptive.move(volts, (SEAT_ACCELERATION,)).seat_acceleration_m_s2
    # The adaptive has what the seat adds from nodes at 6 kHz.
    assert np.abs(got - expected).max() < 1e-4 * np.abs(expected).max()


def test_the_rigs_own_seat_is_taken_where_it_is_described_and_else_the_mass():
    drive = tone(40.0, 0.5, 2.0, 8_000)
    meters = [ExposureMeter(PAPER, 8_000, 1), ExposureMeter(BARE, 8_000, 1)]
    for meter in meters:
        meter.process(drive)
    assert [meter.knows_seat for meter in meters] == [True, False]
    seat, mass = (meter.exposure().rms_m_s2 for meter in meters)
    # Well above its resonance a seat of 2.4 kg gives way to 0.25 kg by their ratio, roughly.
    assert 0.05 < seat / mass < 0.2


@pytest.mark.exhaustive
@settings(max_examples=20)
@given(
    st.lists(st.integers(0, 12_000), max_size=10),
    st.sampled_from([np.float32, np.float64]),
)
def test_no_reading_depends_on_how_the_stream_is_cut(cuts, dtype):
    stream = np.random.default_rng(1).uniform(-1, 1, (12_000, 2)).astype(dtype)
    stream[77] = np.nan
    whole, split = ExposureMeter(PAPER, 16_000, 2), ExposureMeter(PAPER, 16_000, 2)
    before = stream.copy()
    assert whole.process(stream) is stream
    assert stream.tobytes() == before.tobytes()
    for block in np.split(stream, sorted(cuts)):
        split.process(block)
    assert split.exposure() == whole.exposure()


@settings(max_examples=30)
@given(st.lists(st.floats(), min_size=1, max_size=50))
def test_readings_are_finite_whatever_comes(samples):
    meter = ExposureMeter(PAPER, 8_000, 1)
    meter.process(np.resize(np.array(samples), (1_700, 1)))
    exposure = meter.exposure()
    assert all(
        math.isfinite(number)
        for number in (exposure.running_m_s2, exposure.a8_m_s2, exposure.vdv, exposure.extrapolated)
    )


def test_in_silence_nothing_is_added_and_no_number_turns_denormal():
    meter = ExposureMeter(PAPER, 8_000, 1)
    meter.process(tone(40.0, 0.5, 0.5, 8_000))
    meter.process(np.zeros((8_000 * 60, 1)))
    after = meter.exposure()
    meter.process(np.zeros((8_000 * 10, 1)))
    assert meter.exposure().vdv == after.vdv
    assert not meter._state.any()


def test_after_reset_a_new_day_begins():
    meter = ExposureMeter(PAPER, 8_000, 1)
    meter.process(tone(40.0, 0.5, 0.5, 8_000))
    meter.reset()
    assert meter.exposure() == NOTHING


def test_what_is_out_of_range_is_refused():
    with pytest.raises(UsageError, match="samplerate=4000"):
        ExposureMeter(PAPER, 4_000, 1)
    with pytest.raises(InternalError, match="shape"):
        ExposureMeter(PAPER, 8_000, 1).process(np.zeros((10, 2)))
