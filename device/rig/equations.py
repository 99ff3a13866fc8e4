"""The equations of motion, their linear part, and a filter from volts to the seat's acceleration.

    y' = u - z'                        y: excursion, moving mass relative to the frame
    m u' = F(y, i) - c y'              u: speed of the moving mass; F: dW'/dx - dV/dx
    q' = v - R i - Phi'(y) y'          q = L(y) i: flux of the current; Phi: flux of the magnet
    M z'' = -F + c y' - cs z' - ks z   z: position of the frame of a rig with a seat; else z' = 0

With s = (y, u, q[, z, z']), the linear part near rest is s' = A s + B v. The non-linear remainder
is a force on the moving mass, an opposite force on the frame, and a voltage in the coil.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from device.rig.actuator import first_order_hold
from device.rig.co_energy import Energies, energies
from device.rig.parameters import ActuatorParameters, SeatParameters
from device.units import FloatArray

EXCURSION, SPEED, FLUX, FRAME, FRAME_SPEED = range(5)
FORCE, VOLTS = range(2)


@dataclass
class Equations:
    """Linear part and remainder of one actuator with the amplifier's impedance in its circuit.

    rate: A, (states, states). entry: (states, 2): how the remainder's force and voltage enter the
    states; its last column is B.
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
        """Factors, (states,). The linear model's energy is |scale * state|^2 / 2."""
        squares = [self.stiffness, self.mass, 1.0 / self.inductance]
        if self.seat:
            squares += [self.seat.stiffness_n_per_m, self.seat.mass_kg]
        return np.sqrt(squares)


def seat_sections(
    p: ActuatorParameters, seat: SeatParameters, samplerate: float, source_impedance_ohm: float
) -> FloatArray:
    """Return sections, (3, 6), from volts that are linear between samples to the seat's m/s^2."""
    equations = Equations(p, energies(p, None), source_impedance_ohm, seat)
    # Squared coordinates are energies, so that entries have similar magnitudes.
    scale = equations.scale
    rate, drive = scale[:, None] * equations.rate / scale, np.zeros(len(scale))
    drive[FLUX] = scale[FLUX]
    shown = equations.rate[FRAME_SPEED] / scale
    step, from_last, from_new = first_order_hold(rate, drive, 1.0 / samplerate)
    # The state depends on the previous voltage only, the output also on the new voltage.
    entered = (step @ from_new + from_last)[:, None]
    through = np.array([[shown @ from_new]])
    zeros_poles_gain = scipy.signal.ss2zpk(step, entered, shown[None], through)
    return np.asarray(scipy.signal.zpk2sos(*zeros_poles_gain))
