"""Random rigs for identification, and what their linear equations say of their mode.

Written from the equations of motion, apart from what identifies.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from device.identification.acceleration import Mode, identify_mode
from device.identification.output_error import Estimate
from device.identification.recording import Sweep
from device.identification.simulated_laboratory import SimulatedLaboratory
from device.rig import PAPER, ActuatorParameters, Rig
from device.rig.parameters import LargeSignalParameters, SeatParameters
from tools.soak_record import F0_ERROR, HELD, Q_ERROR, SNR_DB

SHARES = (0.05, 0.12)
"""Of Xmax, that the sweeps move."""
SWEEP_S = 5.0


def random_rig(seed: int) -> tuple[Rig, bool]:
    """A rig on the paper's instruments, and whether its seat is loaded: every other one is."""
    random = np.random.default_rng(seed)

    def between(low: float, high: float) -> float:
        return float(np.exp(random.uniform(math.log(low), math.log(high))))

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


def truth(rig: Rig, seat: bool, *, coil_open: bool = False) -> Truth:
    """Of the poles with the least damping above the seat's own."""
    a, s = rig.actuator, rig.seat
    assert s
    m, c, k = a.moving_mass_kg, a.damping_n_s_per_m, a.stiffness_n_per_m
    bl = 0.0 if coil_open else a.force_factor_n_per_a
    r = a.resistance_ohm + rig.amplifier.source_impedance_ohm
    inductance = a.inductance_h
    # x: mass, z: frame; y = x - z
    big, ks, cs = (s.mass_kg, s.stiffness_n_per_m, s.damping_n_s_per_m) if seat else (1e12, 0, 0)
    rate = np.array(
        [
            [0, 1, 0, 0, 0],
            [-k / m, -c / m, k / m, c / m, bl / m],
            [0, 0, 0, 1, 0],
            [k / big, c / big, -(k + ks) / big, -(c + cs) / big, -bl / big],
            [0, -bl / inductance, 0, bl / inductance, -r / inductance],
        ]
    )
    poles = np.linalg.eigvals(rate)
    poles = poles[poles.imag > 1e-3 * abs(poles)]
    mode = poles[np.argmax(np.abs(poles))]
    return Truth(abs(mode) / math.tau, abs(mode) / (-2.0 * mode.real))


def sweep_of(rig: Rig, share: float, bench: SimulatedLaboratory) -> Sweep:
    """15 to 400 Hz, moving that share of Xmax."""
    return bench.sweep_at_excursion(Sweep(low_hz=15.0, high_hz=400.0, duration_s=SWEEP_S), share)


def identified(seed: int, share: float) -> tuple[Mode, Truth]:
    """The mode of a random rig from one noisy sweep of the non-linear model, and the true one."""
    rig, seat = random_rig(seed)
    bench = SimulatedLaboratory(rig, seat=seat, snr_db=SNR_DB, seed=seed)
    recording = bench.measure(sweep_of(rig, share, bench), [("voltage", "acceleration")])[0]
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
        """Whether every limit is kept."""
        return (
            F0_ERROR.met(self.f0_error_percent)
            and Q_ERROR.met(self.q_error_percent)
            and HELD.met(self.f0_held_percent)
            and HELD.met(self.q_held_percent)
        )


def found_of(pairs: Sequence[tuple[Mode, Truth]]) -> Found:
    """Sum up what was identified of some rigs."""
    f0 = [(mode.f0_hz, true.f0_hz) for mode, true in pairs]
    q = [(mode.q, true.q) for mode, true in pairs]
    return Found(_largest_error(f0), _largest_error(q), _held(f0), _held(q))


def _largest_error(pairs: list[tuple[Estimate, float]]) -> float:
    return 100.0 * float(max(abs(found.value / true - 1.0) for found, true in pairs))


def _held(pairs: list[tuple[Estimate, float]]) -> float:
    return 100.0 * float(sum(found.low <= true <= found.high for found, true in pairs)) / len(pairs)
