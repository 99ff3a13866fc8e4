"""What is done for a rig: nothing unless asked for; with a declared latency, or damped."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from device.drive.design import damping_for, drive_design
from device.drive.exposure import ACTION_A8_M_S2, DAY_S, DoseSums
from device.drive.safety import SafetyState
from device.errors import UsageError
from device.rig import CONSUMER, PAPER, Rig
from device.rig.actuator import LinearActuator
from tests.support.signals import tone
from tools.rig_driver import RigDriver

RATE = 48_000
SOURCE_OHM = PAPER.amplifier.source_impedance_ohm


DAMPING = damping_for(PAPER.actuator, SOURCE_OHM)
LOUD = replace(PAPER, amplifier=replace(PAPER.amplifier, gain=40.0, current_limit_a=math.inf))
DRIVEN: dict[str, tuple[Rig, dict[str, Any]]] = {
    "limited": (LOUD, {}),
    "damped": (PAPER, {"damping": DAMPING}),
    "capped": (PAPER, {"exposure_cap": "action"}),
}


def test_nothing_is_done_unless_somebody_asks_for_what_can_be():
    assert drive_design("paper", RATE) is None
    wanted: Any = {"damping": "auto", "exposure_cap": "limit"}
    asked, again = (drive_design("paper", RATE, **wanted) for _ in range(2))
    assert asked is not None
    assert asked is again
    assert (asked.damping, asked.exposure_cap) == (DAMPING, "limit")
    with pytest.raises(UsageError, match="'loud'"):
        drive_design("loud", RATE, protection="on")
    with pytest.raises(UsageError, match="samplerate=4000"):
        drive_design("paper", 4_000, protection="on")


def felt_rms(drive):
    motion = LinearActuator(PAPER.actuator, RATE, SOURCE_OHM)
    volts = drive[:, 0].astype(float) * PAPER.amplifier.gain
    return math.sqrt(np.mean(motion.move(volts).acceleration_m_s2 ** 2))


def test_damping_makes_up_for_what_it_takes_and_says_what_remains():
    # Bursts at the resonance, quiet enough for the make-up.
    burst = np.append(tone(90.0, 0.05, RATE, 0.1), np.zeros(RATE // 5))
    vibration = np.tile(burst, 4).astype(np.float32)[:, None]
    damped = RigDriver(PAPER, RATE, damping=DAMPING)
    assert damped.latency_frames == RigDriver(PAPER, RATE).latency_frames
    assert damped.strength_db is None
    out = damped.through(vibration)
    assert 10.0 < damped.makeup_db < 20.0
    # Within a burst as strong; what rang on after it is missing: 6 dB of the energy.
    strength_db = 20 * math.log10(felt_rms(out) / felt_rms(vibration))
    assert -1.0 < strength_db < 0.5
    # Weighted by Wk at the seat, which counts the lower frequencies of a burst's edges more.
    assert damped.strength_db == pytest.approx(strength_db, abs=1.5)
    loud = RigDriver(PAPER, RATE, damping=DAMPING)
    loud.through(10.0 * vibration)
    assert loud.protection().least_gain < 0.6
    assert loud.strength_db is not None
    assert damped.strength_db is not None
    assert loud.strength_db < damped.strength_db - 3.0
    plain = RigDriver(PAPER, RATE)
    plain.through(vibration)
    assert (plain.makeup_db, plain.strength_db) == (0.0, None)


@pytest.mark.parametrize("rig", [PAPER, CONSUMER])
def test_each_rig_has_its_own_damping_chosen_once(rig):
    source = rig.amplifier.source_impedance_ohm
    found = damping_for(rig.actuator, source)
    assert damping_for(rig.actuator, source) is found
    assert found.ringing
    # The coil's inductance raises it by a few percent.
    assert found.ringing.frequency_hz == pytest.approx(rig.actuator.resonance_hz, rel=0.1)


def test_after_reset_it_is_as_new():
    processor = RigDriver(PAPER, RATE, damping=DAMPING)
    vibration = tone(70.0, 0.3, RATE, 0.5)[:, None]
    first, readings = processor.process(vibration), processor.readings
    processor.reset()
    assert processor.process(vibration).tobytes() == first.tobytes()
    assert processor.readings == readings


@pytest.mark.parametrize("case", DRIVEN)
@settings(max_examples=10)
@given(
    cuts=st.lists(st.integers(0, 3_000), max_size=12),
    seed=st.integers(0, 2**32 - 1),
    dtype=st.sampled_from([np.float32, np.float64]),
)
def test_no_byte_and_no_reading_depends_on_how_the_stream_is_cut(case, cuts, seed, dtype):
    stream = np.random.default_rng(seed).uniform(-1.0, 1.0, (3_000, 2))
    stream[1_200:2_000] = 0.0
    stream[[50, 60]] = [[np.nan, 0.0], [np.inf, -np.inf]]
    stream = stream.astype(dtype)
    rig, options = DRIVEN[case]
    whole, split = (RigDriver(rig, 6_000, 2, **options) for _ in range(2))
    dose = DoseSums(1.0, 0.9 * ACTION_A8_M_S2**2 * DAY_S)
    for driver in (whole, split):
        driver.restore([SafetyState(20.0, 20.0, dose)] * 2)
    expected = whole.process(stream)
    blocks = [split.process(block) for block in np.split(stream, sorted(cuts))]
    assert np.concatenate(blocks).tobytes() == expected.tobytes()
    assert (split.readings, whole.protection().replaced_samples) == (whole.readings, 3)
    assert whole.protection().limited_blocks > 0
    assert (whole.exposure_gain < 1.0) == (case == "capped")
