"""The actuator's energy functions: one object from which force, flux and inductance follow.

    W'(x, i) = Phi(x) i + L(x) i^2 / 2            V(x) = k x^2 / 2 + ...

W' is the magnetic co-energy (equation 9): the coil in the magnet's field, and the reluctance. Its
derivatives describe the whole transducer: force dW'/dx, flux linkage dW'/di, incremental inductance
d^2W'/di^2. V is the energy in spring and stops.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from device.rig.parameters import ActuatorParameters, LargeSignalParameters
from device.rig.shapes import Arctangent, Hardening, Line, Shape, Stops, Sum, Tanh
from device.units import FloatArray


@dataclass(frozen=True)
class CoEnergy:
    """W'(x, i) as data. magnet: Phi in Wb, Phi' = Bl in N/A; inductance: L in H, above 0."""

    magnet: Shape
    inductance: Shape

    def at(self, x: FloatArray, flux_linkage_wb: FloatArray) -> "CoEnergyAt":
        """Return what the equations of motion and their derivatives need, in one pass."""
        flux, force_factor, force_factor_slope = self.magnet.jet(x)
        inductance, slope, curvature = self.inductance.jet(x)
        i = (flux_linkage_wb - flux) / inductance
        half_square = 0.5 * i * i
        flux_slope = force_factor + slope * i
        return CoEnergyAt(
            current_a=i,
            force_n=force_factor * i + slope * half_square,
            flux_slope=flux_slope,
            inductance_h=inductance,
            force_slope=force_factor_slope * i + curvature * half_square,
        )


class CoEnergyAt(NamedTuple):
    """Derivatives of W' at (x, flux linkage), arrays of one shape."""

    current_a: FloatArray
    force_n: FloatArray
    flux_slope: FloatArray  # d^2W'/dx di, Wb/m or N/A
    inductance_h: FloatArray
    force_slope: FloatArray  # d^2W'/dx^2 at constant current, N/m


@dataclass(frozen=True)
class Energies:
    """Everything but masses that stores energy in an actuator, and the loss of its stops."""

    co_energy: CoEnergy
    potential: Shape  # V, J, including the stops
    stops: Stops
    stop_loss_s_per_m: float  # damping per speed and force of a stop (Hunt and Crossley 1975)


def linear_energies(p: ActuatorParameters) -> Energies:
    """Return those of the linear actuator: Phi = Bl x, L constant, V = k x^2 / 2, no stops."""
    return Energies(
        CoEnergy(Line(p.force_factor_n_per_a), Tanh(p.inductance_h, 0.0, p.x_max_m)),
        Hardening(p.stiffness_n_per_m, 0.0),
        Stops(math.inf, 0.0),
        0.0,
    )


def energies(p: ActuatorParameters, large: LargeSignalParameters | None) -> Energies:
    """Return those of an actuator with its large-signal behaviour, or the linear ones.

    Bl falls as 1 / (1 + (x / reach)^2); k rises by its share times (x / Xmax)^2.
    """
    if large is None:
        return linear_energies(p)
    spring = p.stiffness_n_per_m
    rise = spring * large.stiffness_rise / p.x_max_m**2
    stops = Stops(large.stop_m, large.stop_n_per_m2)
    loss = large.force_factor_loss
    magnet: Shape = Line(p.force_factor_n_per_a)
    if loss > 0.0:
        magnet = Arctangent(p.force_factor_n_per_a, p.x_max_m * math.sqrt((1.0 - loss) / loss))
    return Energies(
        CoEnergy(magnet, Tanh(p.inductance_h, large.inductance_change, p.x_max_m)),
        Sum((Hardening(spring, rise), stops)),
        stops,
        large.stop_loss_s_per_m,
    )
