import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, sosfilt, sosfreqz

from device.drive import exposure as ex
from device.drive.exposure import ACTION_A8_M_S2, ACTION_VDV, DAY_S, DoseSums, Exposure
from device.drive.safety import SafetyState
from device.rig import CONSUMER, PAPER
from device.rig.actuator import SEAT_ACCELERATION
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.equations import seat_sections
from tools.rig_driver import RigDriver

RATES = [8_000, 11_025, 16_000, 22_050, 32_000, 44_100, 48_000, 96_000, 192_000]
BAND_HZ = np.geomspace(0.5, 80.0, 200)
NOTHING = Exposure(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
BARE = replace(PAPER, seat=None)
# ISO 2631-1:1997, table 3: factors at third-octave centres, rounded to three digits.
WK = {0.5: 0.418, 1.0: 0.482, 2.0: 0.531, 4.0: 0.967, 5.0: 1.039, 8.0: 1.036, 12.5: 0.902}
WK |= {16.0: 0.768, 20.0: 0.636, 31.5: 0.405, 40.0: 0.314, 63.0: 0.186, 80.0: 0.132}


def tone(frequency_hz, amplitude, seconds, samplerate):
    time_s = np.arange(round(seconds * samplerate)) / samplerate
    return amplitude * np.sin(math.tau * frequency_hz * time_s)[:, None]


def wk_response(frequency_hz):
    """The complex factor of Wk at each frequency in Hz, from the formula of the standard."""
    s = 2j * np.pi * frequency_hz
    response = np.ones_like(s)
    for numerator, denominator, _ in ex.PARTS:
        response *= np.polyval(numerator, s) / np.polyval(denominator, s)
    return response


def test_the_formula_gives_the_table_of_the_standard():
    assert np.abs(wk_response(np.array([*WK]))) == pytest.approx([*WK.values()], abs=1e-3)


@pytest.mark.parametrize("samplerate", [2_000, 3_000, 6_000, *RATES])
def test_the_sections_are_within_one_percent_of_the_formula_from_half_a_hertz_to_80(samplerate):
    _, response = sosfreqz(ex.wk_sections(samplerate), BAND_HZ, fs=samplerate)
    error = np.abs(response / wk_response(BAND_HZ) - 1.0).max()  # phase counts, too
    assert error < 0.01
    # What is left of the bilinear transform's bent scale, where each part is exact at its own
    # frequency: (w T)^2 / 12 at 80 Hz.
    assert error < 1.05 * (math.tau * 80.0 / samplerate) ** 2 / 12


def dose_of(weighted, samplerate=1_000):
    """The exposure to weighted accelerations, (frames, channels), summed by NumPy."""
    sums = (np.sum(weighted**power, axis=0) / samplerate for power in (0, 2, 4))
    return Exposure.of([DoseSums(*each) for each in zip(*sums, strict=True)])


def test_a_sine_for_a_minute_by_hand_and_each_reading_is_of_the_channel_where_it_is_largest():
    # mean square 2, mean fourth power 3/8 * 16 = 6
    exposure = dose_of(tone(10.0, 2.0, 60.0, 1_000))
    assert exposure.time_s == pytest.approx(60.0)
    assert exposure.rms_m_s2 == pytest.approx(math.sqrt(2.0))
    assert exposure.a8_m_s2 == pytest.approx(math.sqrt(2.0 * 60.0 / DAY_S), rel=1e-9)
    assert exposure.vdv == pytest.approx((6.0 * 60.0) ** 0.25, rel=1e-9)
    # One channel hums with 1 m/s^2 for 60 s, the other knocks once with 100 for 1 ms: VDV 17.8.
    weighted = np.zeros((60_000, 2))
    weighted[:, 0], weighted[7, 1] = 1.0, 100.0
    hum, knock, both = dose_of(weighted[:, :1]), dose_of(weighted[:, 1:]), dose_of(weighted)
    assert (hum.a8_m_s2 > knock.a8_m_s2, hum.vdv < knock.vdv) == (True, True)
    assert (both.a8_m_s2, both.rms_m_s2, both.vdv) == (hum.a8_m_s2, hum.rms_m_s2, knock.vdv)
    assert (hum.above_action, both.above_action) == (False, True)


def test_values_of_the_directive_are_told_and_how_much_is_extrapolated():
    over = replace(NOTHING, a8_m_s2=0.5)
    assert (over.above_action, over.above_limit) == (True, False)
    assert not replace(NOTHING, a8_m_s2=0.49, vdv=9.0).above_action
    assert replace(NOTHING, vdv=21.0).above_limit
    shares = []
    for frequency_hz in (30.0, 180.0):
        driven = RigDriver(BARE, 6_000)
        driven.process(tone(frequency_hz, 0.2, 20.0, 6_000))
        shares.append(driven.exposure().extrapolated)
    assert shares[0] < 0.002  # 4th order: (30/80)^8, and what switching it on adds
    assert shares[1] > 0.99
    assert "99 % of it above 80 Hz, extrapolated" in str(replace(NOTHING, extrapolated=0.99))


def gain_after(a8_m_s2, vdv, cap):
    """The gain of a cap after a day of these, before anything is driven."""
    driven = RigDriver(PAPER, 8_000, exposure_cap=cap)
    driven.restore([SafetyState(20.0, 20.0, DoseSums(1.0, a8_m_s2**2 * DAY_S, vdv**4))])
    driven.process(np.zeros((1, 1)))
    return driven.exposure_gain


def test_the_cap_leaves_alone_what_is_under_half_of_the_limits():
    a8, vdv = 0.70 * ex.LIMIT_A8_M_S2, 0.8 * ex.LIMIT_VDV
    assert (gain_after(a8, vdv, "limit"), gain_after(2.0, 30.0, "off")) == (1.0, 1.0)
    assert (gain_after(2.0, vdv, "limit"), gain_after(a8, 30.0, "limit")) == (0.0, 0.0)
    # Half of the dose is free; of the other half, a quarter is left.
    by_a8 = gain_after(math.sqrt(0.875) * ACTION_A8_M_S2, 0.0, "action")
    by_vdv = gain_after(0.0, 0.875**0.25 * ACTION_VDV, "action")
    assert (by_a8, by_vdv) == pytest.approx((0.25**0.5, 0.25**0.25), rel=1e-3)


HARD_SHAKER = replace(
    replace(CONSUMER, large_signal=None, thermal=None, seat=None),
    dac=replace(CONSUMER.dac, full_scale_v=1.8),
    actuator=replace(CONSUMER.actuator, x_max_m=0.1),
    amplifier=replace(CONSUMER.amplifier, output_limit_v=1e3, current_limit_a=1e3),
)
"""A small shaker that hits hard: VDV passes its action value within seconds."""


def test_no_level_takes_a_day_over_its_limit_with_the_cap_and_the_gain_only_falls():
    rate = 6_000
    for level in (0.2, 0.5, 1.0):
        driven, gains = RigDriver(HARD_SHAKER, rate, exposure_cap="action"), []
        for second in np.split(tone(20.0, level, 60.0, rate), 60):
            driven.process(second)
            gains.append(driven.exposure_gain)
        assert not driven.exposure().above_action
        assert np.diff(gains).max() <= 0.0
        if level >= 0.5:
            assert driven.exposure().vdv > 0.85 * ACTION_VDV  # it did come near
            assert gains[-1] < 0.7


def test_a_decimated_stream_keeps_what_is_low_and_folds_nothing_onto_it():
    for factor in (2, 8, 32):
        rate, taps = 6_000 * factor, ex.decimation_taps(factor)
        for frequency_hz in (80, 220):
            low = np.convolve(tone(frequency_hz, 1.0, 0.5, rate)[:, 0], taps)[factor - 1 :: factor]
            assert np.sqrt(2 * np.mean(low[600:3_000] ** 2)) == pytest.approx(1.0, abs=1e-3)
        folded = np.convolve(tone(6_000 - 80, 1.0, 0.5, rate)[:, 0], taps)[factor - 1 :: factor]
        assert np.abs(folded[600:3_000]).max() < 2e-4  # 80 dB, and the ripple beside it


@pytest.mark.parametrize("samplerate", RATES)
@pytest.mark.parametrize("frequency_hz", [20.0, 40.0, 80.0])
def test_the_meter_shows_what_actuator_and_formula_give(samplerate, frequency_hz):
    meter, amplitude = RigDriver(BARE, samplerate), 0.5
    meter.process(tone(frequency_hz, amplitude, 6.0, samplerate))
    p, s = PAPER.actuator, 2j * math.pi * frequency_hz
    impedance = p.resistance_ohm + s * p.inductance_h
    spring = p.moving_mass_kg * s**2 + p.damping_n_s_per_m * s + p.stiffness_n_per_m
    back = p.force_factor_n_per_a**2 * s
    acceleration = s**2 * p.force_factor_n_per_a * 2.5 * amplitude / (spring * impedance + back)
    expected = abs(acceleration * wk_response(np.array(frequency_hz))) / math.sqrt(2)
    # 1 %: the mean over the last second has ripple and e^-6 of what was not there yet.
    assert meter.exposure().running_m_s2 == pytest.approx(expected, rel=0.01)
    assert meter.exposure().rms_m_s2 == pytest.approx(expected, rel=0.02)  # from rest on


@pytest.mark.parametrize("rig", [PAPER, CONSUMER], ids=["paper", "consumer"])
@pytest.mark.parametrize("samplerate", [6_000, 7_350, 48_000])
def test_the_seat_moves_as_that_of_the_adaptive_actuator_linear_model(rig, samplerate):
    noise = np.random.default_rng(4).standard_normal(samplerate // 2)
    volts = sosfilt(butter(4, 300.0, fs=samplerate, output="sos"), noise)
    source = rig.amplifier.source_impedance_ohm
    got = sosfilt(seat_sections(rig.actuator, rig.seat, samplerate, source), volts)
    adaptive = AdaptiveActuator(rig, samplerate, model="linear", seat=True)
    expected = adaptive.move(volts, (SEAT_ACCELERATION,)).seat_acceleration_m_s2
    # The sections have zeros at 0 Hz, which their conversion finds roughly at high rates.
    assert np.abs(got - expected).max() < 1e-4 * np.abs(expected).max()


def test_the_rigs_own_seat_is_taken_where_it_is_described_and_else_the_mass():
    drive = tone(40.0, 0.5, 2.0, 8_000)
    meters = [RigDriver(PAPER, 8_000), RigDriver(BARE, 8_000)]
    for meter in meters:
        meter.process(drive)
    assert [meter.knows_seat for meter in meters] == [True, False]
    seat, mass = (meter.exposure().rms_m_s2 for meter in meters)
    # Well above its resonance a seat of 2.4 kg gives way to 0.25 kg by their ratio, roughly.
    assert 0.05 < seat / mass < 0.2


def test_in_silence_nothing_is_added_and_no_number_turns_denormal():
    meter = RigDriver(PAPER, 8_000)
    meter.process(tone(40.0, 0.5, 0.5, 8_000))
    meter.process(np.zeros((8_000 * 60, 1)))
    after = meter.exposure()
    meter.process(np.zeros((8_000 * 100, 1)))  # e^-160 of the mean square
    assert (meter.exposure().vdv, meter.exposure().running_m_s2) == (after.vdv, 0.0)
