"""Energy of the non-linear model: what goes in is stored or becomes heat, by step and by run."""

from typing import NamedTuple

import numpy as np
import pytest

from device.rig import CONSUMER, PAPER
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.co_energy import energies
from device.rig.model_levels import ModelLevel
from device.rig.nonlinear_model import STEP_TOLERANCE
from device.units import FloatArray
from tests.device.rig.test_adaptive_actuator import band_noise, tones
from tests.device.rig.test_nonlinear_model import FS, drives, times_of
from tests.support.co_energy import stored_energy_j

EXHAUSTIVE = pytest.mark.exhaustive
FRAMES = 12_000
STEP = 16
"""Samples at 48 kHz of the widest step; narrower ones share its ends."""

CASES = {
    "band, 5 V": (PAPER, band_noise(5.0, FS, 0.25, 1)),
    "band, 20 V": (PAPER, band_noise(20.0, FS, 0.25, 2)),
    "band into the stops": (PAPER, band_noise(60.0, FS, 0.25, 3)),
    "consumer, band into the stops": (CONSUMER, band_noise(40.0, FS, 0.25, 1)),
    "tones, nine tenths of Xmax": (PAPER, tones(6.5, times_of(0.25))),
    **{name: (rig, volts[:FRAMES]) for name, (rig, volts) in drives().items() if name != "noise"},
}


class Balance(NamedTuple):
    """Energy from nowhere and energy handled by each step, and that through the whole run, J."""

    from_nowhere: FloatArray
    handled: FloatArray
    through: float

    @property
    def shares(self) -> FloatArray:
        """Each step's error over what it handled, without steps that handle next to nothing."""
        counted = self.handled > 1e-3 * self.handled.max()
        return np.asarray(np.abs(self.from_nowhere[counted]) / self.handled[counted])


def balance_of(rig, volts, step_tolerance, fine=4):
    """The voltage's straight lines at 48 kHz get `fine` points each, where the motion is known.

    Simpson's rule then has no corner inside. What a step handles is the larger of the energy stored
    at its ends and of what flows through the coil's ends.
    """
    p, e = rig.actuator, energies(rig.actuator, rig.large_signal)
    lines = np.interp(
        np.arange(1, len(volts) * fine + 1) / fine, np.arange(len(volts) + 1), [0.0, *volts]
    )
    model = AdaptiveActuator(
        rig, FS * fine, level=ModelLevel.NONLINEAR, step_tolerance=step_tolerance
    )
    motion = model.move(lines)
    y, w, i = motion.displacement_m, motion.velocity_m_s, motion.current_a
    ohm = p.resistance_ohm + rig.amplifier.source_impedance_ohm
    drag = p.damping_n_s_per_m + e.stop_loss_s_per_m * np.abs(e.stops.jet(y)[1])
    stored_j = stored_energy_j(e, y, i) + p.moving_mass_kg * w**2 / 2
    points = STEP * fine
    simpson_s = np.full(points + 1, 2.0)
    simpson_s[1::2], simpson_s[[0, -1]] = 4.0, 1.0
    simpson_s /= 3.0 * FS * fine

    def over_steps(power_w):
        return np.lib.stride_tricks.sliding_window_view(power_w, points + 1)[::points] @ simpson_s

    first = points - 1
    ends_j = stored_j[first::points]
    taken_j = over_steps((lines * i - ohm * i**2 - drag * w**2)[first:])
    through_j = over_steps(np.abs(lines * i)[first:])
    handled_j = np.maximum(np.maximum(ends_j[1:], ends_j[:-1]), through_j)
    return Balance(taken_j - np.diff(ends_j), handled_j, float(through_j.sum()))


@pytest.mark.parametrize("case", CASES)
def test_a_run_of_the_widest_steps_makes_no_energy(case):
    rig, volts = CASES[case]
    found = balance_of(rig, volts, STEP_TOLERANCE)
    assert abs(np.cumsum(found.from_nowhere)).max() <= 1e-6 * found.through


@pytest.mark.parametrize("case", CASES)
def test_a_fine_step_balances_its_energy_within_a_millionth(case):
    rig, volts = CASES[case]
    shares = balance_of(rig, volts, 1e-6).shares
    assert len(shares) > 500
    # Where hard stops are met, what a step handles turns round within a sample.
    assert shares.max() <= (1e-5 if case == "hard stops" else 1e-6)


# Their errors have either sign, so that a run is better than its steps.
@pytest.mark.parametrize("case", [name for name in CASES if "band" in name or "tones" in name])
def test_half_of_the_widest_steps_balance_within_1_5_millionths_and_none_is_off_by_40(case):
    rig, volts = CASES[case]
    shares = balance_of(rig, volts, STEP_TOLERANCE).shares
    assert np.median(shares) <= 1.5e-6
    assert shares.max() <= 4e-5


@EXHAUSTIVE
def test_white_noise_makes_no_more_energy_than_its_interpolation_is_off():
    # At 16 points a sample Simpson's rule is exact enough for corners of every sample.
    rig, volts = drives()["noise"]
    for step_tolerance, allowed in ((STEP_TOLERANCE, 1e-5), (1e-6, 1e-6)):
        found = balance_of(rig, volts[:4_800], step_tolerance, 16)
        assert abs(np.cumsum(found.from_nowhere)).max() <= allowed * found.through
