"""Random rigs for identification, and what their linear equations say of their mode.

Written from the equations of motion, apart from what identifies.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from device.identification.acceleration import Mode, identify_mode
from device.identification.output_error import Estimate
from device.identification.recording import Sweep
from device.identification.simulated_laboratory import SimulatedLaboratory
from device.rig import PAPER, ActuatorParameters, Rig
from device.rig.parameters import LargeSignalParameters, SeatParameters
from device.units import FloatArray
from tools.soak_record import F0_ERROR, HELD, Q_ERROR, SNR_DB

SHARES = (0.05, 0.12)
"""Of Xmax, that the sweeps move."""
SWEEP_S = 5.0


def log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(random.uniform(math.log(low), math.log(high))))


def random_rig(seed: int) -> tuple[Rig, bool]:
    """A rig on the paper's instruments, and whether its seat is loaded: every other one is."""
    between = partial(log_uniform, np.random.default_rng(seed))
    mass, resistance = between(0.1, 0.5), between(3.0, 8.0)
    actuator = ActuatorParameters(
        moving_mass_kg=mass,
        resonance_hz=between(35.0, 120.0),
        q_mechanical=between(3.0, 15.0),
        force_factor_n_per_a=between(4.0, 12.0),
        resistance_ohm=resistance,
        inductance_h=resistance * between(0.1e-3, 0.4e-3),
        x_max_m=between(1e-3, 2e-3),
    )
    big = mass * between(5.0, 30.0)
    w = math.tau * between(6.0, 0.25 * actuator.resonance_hz)
    q = between(0.5, 2.0)
    rig = replace(
        PAPER,
        name=f"random {seed}",
        actuator=actuator,
        large_signal=LargeSignalParameters(stop_m=1.5 * actuator.x_max_m),
        seat=SeatParameters(big, big * w**2, big * w / q),
        amplifier=replace(PAPER.amplifier, gain=10.0),
    )
    return rig, seed % 2 == 1


@dataclass(frozen=True)
class Truth:
    """f0 and Q of the mode under voltage drive, by the eigenvalues of the linear equations."""

    f0_hz: float
    q: float


def linear_rates(a: ActuatorParameters, s: SeatParameters, ohm: float, bl: float) -> FloatArray:
    """Rates of the place and speed of a coil in its frame, its current, and those of the frame."""
    force = np.array([-a.stiffness_n_per_m, -a.damping_n_s_per_m, bl, 0.0, 0.0])
    ground = np.array([0.0, 0.0, 0.0, -s.stiffness_n_per_m, -s.damping_n_s_per_m])
    frame = (ground - force) / s.mass_kg
    current = np.array([0.0, -bl, -ohm, 0.0, 0.0]) / a.inductance_h
    coil, moved = force / a.moving_mass_kg - frame, np.eye(5)
    return np.array([moved[1], coil, current, moved[4], frame])


def truth(rig: Rig, seat: bool, *, coil_open: bool = False) -> Truth:
    """Of the poles with the least damping above the seat's own."""
    a, s = rig.actuator, rig.seat
    assert s
    bl = 0.0 if coil_open else a.force_factor_n_per_a
    ohm = a.resistance_ohm + rig.amplifier.source_impedance_ohm
    rate = linear_rates(a, s if seat else SeatParameters(1e12, 1e-9, 0.0), ohm, bl)
    poles = np.linalg.eigvals(rate)
    poles = poles[poles.imag > 1e-3 * abs(poles)]
    mode = poles[np.argmax(np.abs(poles))]
    return Truth(abs(mode) / math.tau, abs(mode) / (-2.0 * mode.real))


def identified(seed: int, share: float) -> tuple[Mode, Truth]:
    """The mode of a random rig from one noisy sweep of the non-linear model, and the true one."""
    rig, seat = random_rig(seed)
    bench = SimulatedLaboratory(rig, seat=seat, snr_db=SNR_DB, seed=seed)
    moving = bench.sweep_at_excursion(Sweep(low_hz=15.0, high_hz=400.0, duration_s=SWEEP_S), share)
    recording = bench.measure(moving, [("voltage", "acceleration")])[0]
    return identify_mode(recording, rig.actuator.x_max_m), truth(rig, seat)


@dataclass(frozen=True)
class Found:
    """What became of some rigs, in per cent: the largest errors, and how many intervals hold."""

    f0_error_percent: float
    q_error_percent: float
    f0_held_percent: float
    q_held_percent: float

    @property
    def passed(self) -> bool:
        found = F0_ERROR.met(self.f0_error_percent) and Q_ERROR.met(self.q_error_percent)
        return found and HELD.met(self.f0_held_percent) and HELD.met(self.q_held_percent)


def found_of(pairs: Sequence[tuple[Mode, Truth]]) -> Found:
    f0 = [(mode.f0_hz, true.f0_hz) for mode, true in pairs]
    q = [(mode.q, true.q) for mode, true in pairs]
    return Found(_largest_error(f0), _largest_error(q), _held(f0), _held(q))


def _largest_error(pairs: list[tuple[Estimate, float]]) -> float:
    return 100.0 * float(max(abs(found.value / true - 1.0) for found, true in pairs))


def _held(pairs: list[tuple[Estimate, float]]) -> float:
    return 100.0 * float(sum(found.low <= true <= found.high for found, true in pairs)) / len(pairs)
