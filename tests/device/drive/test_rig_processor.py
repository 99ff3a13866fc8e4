"""Processing for a rig: none unless asked for; with a declared latency, or damped."""

import math
from dataclasses import replace

import numpy as np
import pytest

from device.drive.rig_processor import RigProcessor, damping_for, make_rig_processor
from device.errors import InternalError, UsageError
from device.rig import CONSUMER, PAPER
from device.rig.actuator import LinearActuator

RATE = 48_000
SOURCE_OHM = PAPER.amplifier.source_impedance_ohm


def tone(frequency_hz, seconds, level=0.5):
    wave = level * np.sin(math.tau * frequency_hz * np.arange(round(seconds * RATE)) / RATE)
    return wave.astype(np.float32)[:, None]


def through(processor, vibration):
    """All that leaves, from the beginning of the vibration on."""
    whole = np.concatenate([processor.process(vibration.copy()), processor.drain()])
    return whole[processor.latency_frames :]


def test_nothing_is_done_unless_somebody_asks_for_it():
    assert make_rig_processor("paper", RATE, 1) is None


def test_protection_leaves_usual_vibration_as_it_is_two_blocks_later():
    processor = make_rig_processor("paper", RATE, 1, protection="on")
    assert processor is not None
    assert processor.latency_frames == 192
    vibration = tone(90.0, 0.5)
    assert np.array_equal(through(processor, vibration), vibration)
    assert processor.protection().limited_blocks == 0
    assert processor.exposure().a8_m_s2 > 0.0


def test_damping_brings_protection_along_and_adds_no_delay_of_its_own():
    damped = make_rig_processor("paper", RATE, 1, damping="auto")
    assert damped is not None
    assert damped.latency_frames == 192
    burst = tone(90.0, 0.05)
    silence = np.zeros((RATE // 4, 1), np.float32)
    vibration = np.concatenate([burst, silence])

    def rings(drive):
        volts = drive[:, 0].astype(float) * PAPER.amplifier.gain
        motion = LinearActuator(PAPER.actuator, RATE, SOURCE_OHM).move(volts)
        within, after = np.split(motion.acceleration_m_s2, [len(burst)])
        return np.sum(after**2) / np.sum(within**2)

    # Against voltage drive, which damps by itself: 5.4 of the 12 dB against current drive are its.
    assert rings(through(damped, vibration)) < 0.3 * rings(vibration)


def felt_rms(drive):
    motion = LinearActuator(PAPER.actuator, RATE, SOURCE_OHM)
    volts = drive[:, 0].astype(float) * PAPER.amplifier.gain
    return math.sqrt(np.mean(motion.move(volts).acceleration_m_s2 ** 2))


def test_damping_makes_up_for_what_it_takes_and_says_what_remains():
    # Bursts at the resonance, quiet enough for the make-up.
    vibration = np.concatenate([tone(90.0, 0.05, 0.1), np.zeros((RATE // 5, 1), np.float32)] * 4)
    damped = RigProcessor(PAPER, RATE, 1, damped=True)
    assert damped.strength_db is None
    out = through(damped, vibration)
    assert 10.0 < damped.makeup_db < 20.0
    # Within a burst as strong; what rang on after it is missing: 6 dB of the energy.
    strength_db = 20 * math.log10(felt_rms(out) / felt_rms(vibration))
    assert -1.0 < strength_db < 0.5
    # Weighted by Wk at the seat, which counts the lower frequencies of a burst's edges more.
    assert damped.strength_db == pytest.approx(strength_db, abs=1.5)
    loud = RigProcessor(PAPER, RATE, 1, damped=True)
    through(loud, 10.0 * vibration)
    assert loud.protection().least_gain < 0.6
    assert loud.strength_db is not None
    assert damped.strength_db is not None
    assert loud.strength_db < damped.strength_db - 3.0
    plain = RigProcessor(PAPER, RATE, 1)
    through(plain, vibration)
    assert (plain.makeup_db, plain.strength_db) == (0.0, None)


def test_a_damped_drive_stays_within_full_scale_and_is_never_clipped():
    processor = RigProcessor(PAPER, RATE, 1, damped=True)
    vibration = np.sign(tone(90.0, 0.3, 1.0))
    out = through(processor, vibration)
    assert np.abs(out).max() <= 1.0 + 1e-6
    assert processor.protection().limited_blocks > 0
    at_limit = np.abs(out[:, 0]) > 0.9999
    assert not (at_limit[1:] & at_limit[:-1]).any()


def test_each_rig_has_its_own_damping_chosen_once():
    paper = damping_for(PAPER.actuator, SOURCE_OHM)
    assert damping_for(PAPER.actuator, SOURCE_OHM) is paper
    other = damping_for(CONSUMER.actuator, CONSUMER.amplifier.source_impedance_ohm)
    assert paper.ringing
    assert other.ringing
    # The coil's inductance raises both by a few percent.
    assert paper.ringing.frequency_hz == pytest.approx(PAPER.actuator.resonance_hz, rel=0.1)
    assert other.ringing.frequency_hz == pytest.approx(CONSUMER.actuator.resonance_hz, rel=0.1)


def test_after_reset_it_is_as_new():
    processor = RigProcessor(PAPER, RATE, 1, damped=True)
    vibration = tone(70.0, 0.3)
    first = processor.process(vibration.copy())
    counts = processor.protection(), processor.exposure()
    processor.reset()
    assert processor.process(vibration.copy()).tobytes() == first.tobytes()
    assert (processor.protection(), processor.exposure()) == counts


@pytest.mark.exhaustive
def test_a_cap_turns_down_what_would_exceed_the_days_dose_and_brings_protection_along():
    # A small shaker that hits hard: VDV passes its action value, 9.1, within seconds, not hours.
    hard = replace(
        CONSUMER,
        dac=replace(CONSUMER.dac, full_scale_v=1.8),
        actuator=replace(CONSUMER.actuator, x_max_m=0.1),
        amplifier=replace(CONSUMER.amplifier, output_limit_v=1e3, current_limit_a=1e3),
        large_signal=None,
        thermal=None,
        seat=None,
    )
    rate = 6_000
    vibration = 0.5 * np.sin(math.tau * 20.0 * np.arange(12 * rate) / rate)[:, None]
    doses = {}
    for cap in ("off", "action", "limit"):
        processor = RigProcessor(hard, rate, 1, exposure_cap=cap)
        for block in np.split(vibration.copy(), 120):
            processor.process(block)
        doses[cap] = processor.exposure()
        assert processor.exposure_cap == cap
        assert (processor.exposure_gain < 1.0) == (cap == "action")
        processor.reset()
        assert processor.exposure_gain == 1.0
    assert doses["off"].above_action
    assert doses["limit"] == doses["off"]  # far from it
    assert not doses["action"].above_action
    assert doses["action"].vdv > 0.85 * 9.1
    capped = make_rig_processor("paper", RATE, 1, exposure_cap="limit")
    assert capped is not None
    usual = tone(90.0, 0.5)
    assert np.array_equal(through(capped, usual), usual)
    assert capped.knows_seat


def test_what_cannot_be_is_refused_by_name():
    with pytest.raises(UsageError, match="'loud'"):
        make_rig_processor("loud", RATE, 1, protection="on")
    with pytest.raises(UsageError, match="samplerate=4000"):
        RigProcessor(PAPER, 4_000, 1)
    with pytest.raises(InternalError, match="shape"):
        RigProcessor(replace(PAPER, thermal=None), RATE, 2).process(np.zeros((10, 1)))
