"""The equations of motion, as a linear part and a remainder that vanishes at rest.

    y' = u - z'                        y: excursion, the moving mass against the frame
    m u' = F(y, i) - c y'              u: speed of the moving mass; F: dW'/dx - dV/dx
    q' = v - R i - Phi'(y) y'          q = L(y) i: flux that the current makes; Phi: the magnet's
    M z'' = -F + c y' - cs z' - ks z   z: the frame, where the rig has a seat; else z' = 0

With s = (y, u, q[, z, z']) this is s' = A s + B v + E g(s): a linear part and a remainder g. The
remainder has two components, a force and a voltage. The linear actuator on the ground (actuator.py)
knows its answer S to the same voltage exactly. The difference d = s - S follows
d' = A d + E g(S + d), without the voltage. With a seat, the force of S pushes the frame, a third
component. So only d is ever approximated.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from device.rig.co_energy import Energies
from device.rig.parameters import ActuatorParameters, SeatParameters
from device.units import FloatArray

EXCURSION, SPEED, FLUX, FRAME, FRAME_SPEED = range(5)
FORCE, VOLTS, PUSH = range(3)


class Remainder(NamedTuple):
    """g at some points of time, and what else follows there, (points,) each."""

    force_n: FloatArray
    volts: FloatArray
    current_a: FloatArray
    resisting_n: FloatArray  # by spring and stops, without the linear spring


@dataclass
class Equations:
    """Linear part and remainder of one actuator with the amplifier's impedance in its circuit.

    `resistance_ohm` is that of source and coil at its present temperature; the linear part keeps
    the value at rest. rate is A, (states, states); entry is E, (states, components).
    """

    actuator: ActuatorParameters
    energies: Energies
    source_impedance_ohm: float = 0.0
    seat: SeatParameters | None = None

    def __post_init__(self) -> None:
        p, seat = self.actuator, self.seat
        self.linear_resistance_ohm = p.resistance_ohm + self.source_impedance_ohm
        self.resistance_ohm = self.linear_resistance_ohm
        self.mass, self.damping = p.moving_mass_kg, p.damping_n_s_per_m
        self.stiffness, self.force_factor = p.stiffness_n_per_m, p.force_factor_n_per_a
        self.inductance = p.inductance_h
        m, c, k = self.mass, self.damping, self.stiffness
        pull = self.force_factor / self.inductance
        self.rate = np.zeros((5, 5) if seat else (3, 3))
        self.entry = np.zeros((5, 3) if seat else (3, 2))
        self.rate[EXCURSION, SPEED] = 1.0
        self.rate[SPEED, :3] = [-k / m, -c / m, pull / m]
        self.rate[FLUX, SPEED] = -self.force_factor
        self.rate[FLUX, FLUX] = -self.linear_resistance_ohm / self.inductance
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
            self.entry[FRAME_SPEED, PUSH] = -1.0 / big

    @property
    def states(self) -> int:
        """3, or 5 with a seat."""
        return len(self.rate)

    @property
    def scale(self) -> FloatArray:
        """Return (states,): half the sum of the squares of scale times s is the linear energy."""
        squares = [self.stiffness, self.mass, 1.0 / self.inductance]
        if self.seat:
            squares += [self.seat.stiffness_n_per_m, self.seat.mass_kg]
        return np.sqrt(squares)

    def remainder(self, y: FloatArray, w: FloatArray, q: FloatArray) -> Remainder:
        """Return g for excursion, its rate and the current's flux, (points,) each."""
        e = self.energies
        flux = e.co_energy.magnet.jet(y)[0] + q
        at = e.co_energy.at(y, flux)
        current = q / at.inductance_h
        force_factor = e.co_energy.magnet.jet(y)[1]
        pressed = np.abs(e.stops.jet(y)[1]) * e.stop_loss_s_per_m
        resisting = e.potential.jet(y)[1] + pressed * w - self.stiffness * y
        force = at.force_n - (self.force_factor / self.inductance) * q - resisting
        volts = (self.linear_resistance_ohm / self.inductance) * q - self.resistance_ohm * current
        volts -= (force_factor - self.force_factor) * w
        return Remainder(force, volts, current, resisting)
