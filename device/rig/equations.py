"""The equations of motion, their linear part, and the seat as a linear filter of the volts.

    y' = u - z'                        y: excursion, the moving mass against the frame
    m u' = F(y, i) - c y'              u: speed of the moving mass; F: dW'/dx - dV/dx
    q' = v - R i - Phi'(y) y'          q = L(y) i: flux that the current makes; Phi: the magnet's
    M z'' = -F + c y' - cs z' - ks z   z: the frame, where the rig has a seat; else z' = 0

With s = (y, u, q[, z, z']), the linear part near rest is s' = A s + B v. What it leaves out is a
force on the moving mass, which the frame gets in the other direction, and a voltage in the coil.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from device.rig.actuator import first_order_hold
from device.rig.co_energy import Energies, linear_energies
from device.rig.parameters import ActuatorParameters, SeatParameters
from device.units import FloatArray

EXCURSION, SPEED, FLUX, FRAME, FRAME_SPEED = range(5)
FORCE, VOLTS = range(2)


@dataclass
class Equations:
    """Linear part and remainder of one actuator with the amplifier's impedance in its circuit.

    rate: A, (states, states). entry: (states, 2), where a force and a voltage that are left out
    act; its last column is B.
    """

    actuator: ActuatorParameters
    energies: Energies
    source_impedance_ohm: float = 0.0
    seat: SeatParameters | None = None

    def __post_init__(self) -> None:
        p, seat = self.actuator, self.seat
        self.resistance_ohm = p.resistance_ohm + self.source_impedance_ohm
        m = self.mass = p.moving_mass_kg
        c = self.damping = p.damping_n_s_per_m
        k = self.stiffness = p.stiffness_n_per_m
        self.force_factor, self.inductance = p.force_factor_n_per_a, p.inductance_h
        pull = self.force_factor / self.inductance
        states = 5 if seat else 3
        self.rate, self.entry = np.zeros((states, states)), np.zeros((states, 2))
        self.rate[EXCURSION, SPEED] = 1.0
        self.rate[SPEED, :3] = [-k / m, -c / m, pull / m]
        self.rate[FLUX, SPEED] = -self.force_factor
        self.rate[FLUX, FLUX] = -self.resistance_ohm / self.inductance
        self.entry[SPEED, FORCE] = 1.0 / m
        self.entry[FLUX, VOLTS] = 1.0
        if seat:
            big = seat.mass_kg
            for row in (EXCURSION, SPEED, FLUX):
                self.rate[row, FRAME_SPEED] = -self.rate[row, SPEED]
            self.rate[FRAME, FRAME_SPEED] = 1.0
            self.rate[FRAME_SPEED] = -m / big * self.rate[SPEED]
            self.rate[FRAME_SPEED, FRAME] = -seat.stiffness_n_per_m / big
            self.rate[FRAME_SPEED, FRAME_SPEED] -= seat.damping_n_s_per_m / big
            self.entry[FRAME_SPEED, FORCE] = -1.0 / big

    @property
    def scale(self) -> FloatArray:
        """Return (states,): half the sum of the squares of scale times s is the linear energy."""
        squares = [self.stiffness, self.mass, 1.0 / self.inductance]
        if self.seat:
            squares += [self.seat.stiffness_n_per_m, self.seat.mass_kg]
        return np.sqrt(squares)


def seat_sections(
    p: ActuatorParameters, seat: SeatParameters, samplerate: float, source_impedance_ohm: float
) -> FloatArray:
    """Return sections, (3, 6), from volts, linear between samples, to seat acceleration, m/s^2."""
    equations = Equations(p, linear_energies(p), source_impedance_ohm, seat)
    # In coordinates whose squares are energies, entries do not differ by factors of millions.
    scale = equations.scale
    rate, drive = scale[:, None] * equations.rate / scale, np.zeros(len(scale))
    drive[FLUX] = scale[FLUX]
    shown = equations.rate[FRAME_SPEED] / scale
    step, from_last, from_new = first_order_hold(rate, drive, 1.0 / samplerate)
    # The state takes the last volt only; the output takes the new one.
    entered = (step @ from_new + from_last)[:, None]
    through = np.array([[shown @ from_new]])
    zeros_poles_gain = scipy.signal.ss2zpk(step, entered, shown[None], through)
    return np.asarray(scipy.signal.zpk2sos(*zeros_poles_gain))
