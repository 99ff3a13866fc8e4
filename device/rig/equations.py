"""The equations of motion, as a linear part and a remainder that vanishes at rest.

    y' = u - z'                           y: excursion, the moving mass against the frame
    m u' = F(y, lambda) - c y'            u: speed of the moving mass; F: dW'/dx - dV/dx
    lambda' = v - R i(y, lambda)          lambda: flux linkage of the coil
    M z'' = -F + c y' - cs z' - ks z      z: the frame, where the rig has a seat; else z' = 0

With s = (y, u, lambda[, z, z']) this is s' = A s + B v + E g(s): a linear part, and a remainder g
of two components, a force and a voltage. The linear actuator on the ground (actuator.py) knows its
answer S to the same voltage exactly. The difference d = s - S follows d' = A d + E g(S + d) without
the voltage; with a seat, the force of S pushes the frame. So only d is ever approximated.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from device.rig.co_energy import CoEnergyAt, Energies
from device.rig.parameters import ActuatorParameters, SeatParameters
from device.rig.small_matrices import SmallMatrix
from device.units import FloatArray

EXCURSION, SPEED, FLUX, FRAME, FRAME_SPEED = range(5)


class Remainder(NamedTuple):
    """g at some points of time, (points,) each, and the total current there."""

    force_n: FloatArray
    volts: FloatArray
    current_a: FloatArray


class Slopes(NamedTuple):
    """The derivatives of g by y, y' and lambda, (points,) each; the others are 0."""

    force_y: FloatArray
    force_w: FloatArray
    force_flux: FloatArray
    volts_y: FloatArray
    volts_flux: FloatArray


@dataclass
class Equations:
    """Linear part and remainder of one actuator with the amplifier's impedance in its circuit.

    `resistance_ohm` is that of source and coil at its present temperature; the linear part keeps
    the value at rest. One thread uses an object.
    """

    actuator: ActuatorParameters
    energies: Energies
    source_impedance_ohm: float = 0.0
    seat: SeatParameters | None = None

    def __post_init__(self) -> None:
        p, seat = self.actuator, self.seat
        self.linear_resistance_ohm = p.resistance_ohm + self.source_impedance_ohm
        self.resistance_ohm = self.linear_resistance_ohm
        self.states = 5 if seat else 3
        self.force_factor = p.force_factor_n_per_a
        self.inductance = p.inductance_h
        self.mass, self.damping = p.moving_mass_kg, p.damping_n_s_per_m
        self.stiffness = p.stiffness_n_per_m + self.force_factor**2 / self.inductance
        """N/m at constant flux: the coil's back-EMF through its inductance is a spring."""
        per_flux = self.force_factor / self.inductance
        r_l = self.linear_resistance_ohm / self.inductance
        m, c = self.mass, self.damping
        matrix: SmallMatrix = {
            (EXCURSION, SPEED): 1.0,
            (SPEED, EXCURSION): -self.stiffness / m,
            (SPEED, SPEED): -c / m,
            (SPEED, FLUX): per_flux / m,
            (FLUX, EXCURSION): r_l * self.force_factor,
            (FLUX, FLUX): -r_l,
        }
        if seat:
            big = seat.mass_kg
            matrix |= {
                (EXCURSION, FRAME_SPEED): -1.0,
                (SPEED, FRAME_SPEED): c / m,
                (FRAME, FRAME_SPEED): 1.0,
                (FRAME_SPEED, EXCURSION): self.stiffness / big,
                (FRAME_SPEED, SPEED): c / big,
                (FRAME_SPEED, FLUX): -per_flux / big,
                (FRAME_SPEED, FRAME): -seat.stiffness_n_per_m / big,
                (FRAME_SPEED, FRAME_SPEED): -(c + seat.damping_n_s_per_m) / big,
            }
        self.matrix = matrix
        self.shares = {SPEED: 1.0 / m} | ({FRAME_SPEED: -1.0 / seat.mass_kg} if seat else {})
        """E: how one newton of remainder changes each rate; a volt changes the flux only."""
        self._rows = [
            [(column, value) for (row, column), value in matrix.items() if row == r]
            for r in range(self.states)
        ]

    def relative_speed(self, state: FloatArray) -> FloatArray:
        """Return y' of states, (states, points)."""
        speed: FloatArray = state[SPEED]
        if self.seat is None:
            return speed
        return np.asarray(speed - state[FRAME_SPEED])

    def remainder(
        self, y: FloatArray, w: FloatArray, flux: FloatArray
    ) -> tuple[Remainder, "Evaluation"]:
        """Return g for excursion, its rate and flux, and what `slopes` needs of this evaluation."""
        e = self.energies
        at = e.co_energy.at(y, flux)
        spring = e.potential.jet(y)
        force = at.force_n - spring[1] + self.stiffness * y
        force -= (self.force_factor / self.inductance) * flux
        stop_force = None
        if e.stop_loss_s_per_m > 0.0 and float(np.max(np.abs(y), initial=0.0)) > e.stops.start:
            stop_force = np.abs(e.stops.jet(y)[1]) * e.stop_loss_s_per_m
            force -= stop_force * w
        volts = (self.linear_resistance_ohm / self.inductance) * (flux - self.force_factor * y)
        volts -= self.resistance_ohm * at.current_a
        return Remainder(force, volts, at.current_a), Evaluation(y, w, at, spring[2], stop_force)

    def slopes(self, done: "Evaluation") -> Slopes:
        """Return the derivatives of g at the same points."""
        at, e = done.at, self.energies
        per_flux = at.flux_slope / at.inductance_h
        force_y = at.force_slope - per_flux * at.flux_slope - done.spring_slope + self.stiffness
        force_w = 0.0 * done.y
        if done.stop_force is not None:
            force_w = -done.stop_force
            steep = e.stops.jet(done.y)[2] * e.stop_loss_s_per_m
            force_y = force_y - np.copysign(steep, done.y) * done.w
        linear = self.linear_resistance_ohm / self.inductance
        return Slopes(
            force_y,
            force_w,
            per_flux - self.force_factor / self.inductance,
            self.resistance_ohm * per_flux - linear * self.force_factor,
            linear - self.resistance_ohm / at.inductance_h,
        )

    def jacobian(self, slopes: Slopes) -> SmallMatrix:
        """Return d(A d + E g)/dd as a small matrix; entries are numbers or (points,)."""
        matrix = dict(self.matrix)
        touching = bool(np.any(slopes.force_w))
        for row, share in self.shares.items():
            for column, slope in ((EXCURSION, slopes.force_y), (FLUX, slopes.force_flux)):
                matrix[row, column] = matrix[row, column] + share * slope
            if touching:
                damped = share * slopes.force_w
                matrix[row, SPEED] = matrix[row, SPEED] + damped
                if self.seat:
                    matrix[row, FRAME_SPEED] = matrix[row, FRAME_SPEED] - damped
        matrix[FLUX, EXCURSION] = matrix[FLUX, EXCURSION] + slopes.volts_y
        matrix[FLUX, FLUX] = matrix[FLUX, FLUX] + slopes.volts_flux
        return matrix

    def linear_rate(self, d: FloatArray) -> FloatArray:
        """Return A d, (states, points)."""
        rate: FloatArray = np.empty_like(d)
        for row, entries in enumerate(self._rows):
            (column, value), *rest = entries
            np.multiply(d[column], value, out=rate[row])
            for column, value in rest:
                rate[row] += value * d[column]
        return rate

    def add_remainder(
        self, rate: FloatArray, g: Remainder | None, acceleration_m_s2: FloatArray | None
    ) -> FloatArray:
        """Add E g to a rate in place, and the push of the linear solution on the frame."""
        if g is not None:
            for row, share in self.shares.items():
                rate[row] += share * g.force_n
            rate[FLUX] += g.volts
        if self.seat is not None and acceleration_m_s2 is not None:
            rate[FRAME_SPEED] -= (self.mass / self.seat.mass_kg) * acceleration_m_s2
        return rate


class Evaluation(NamedTuple):
    """Intermediate results of one evaluation of g, for its derivatives."""

    y: FloatArray
    w: FloatArray
    at: CoEnergyAt
    spring_slope: FloatArray
    stop_force: FloatArray | None
