"""The equations of motion and their linear part.

    y' = u - z'                        y: excursion, the moving mass against the frame
    m u' = F(y, i) - c y'              u: speed of the moving mass; F: dW'/dx - dV/dx
    q' = v - R i - Phi'(y) y'          q = L(y) i: flux that the current makes; Phi: the magnet's
    M z'' = -F + c y' - cs z' - ks z   z: the frame, where the rig has a seat; else z' = 0

With s = (y, u, q[, z, z']), the linear part near rest is s' = A s + B v. What it leaves out is a
force on the moving mass, which the frame gets in the other direction, and a voltage in the coil.
"""

from dataclasses import dataclass

import numpy as np

from device.rig.co_energy import Energies
from device.rig.parameters import ActuatorParameters, SeatParameters
from device.units import FloatArray

EXCURSION, SPEED, FLUX, FRAME, FRAME_SPEED = range(5)
FORCE, VOLTS = range(2)


@dataclass
class Equations:
    """Linear part and remainder of one actuator with the amplifier's impedance in its circuit.

    `resistance_ohm` is that of source and coil at its present temperature; the linear part keeps
    the value at rest. rate is A, (states, states); entry, (states, 2), is where a force and a
    voltage that are left out act. The last column of entry is B.
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
        self.entry = np.zeros((5, 2) if seat else (3, 2))
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
