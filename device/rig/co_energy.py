"""The actuator's energy functions: one object from which force, flux and inductance follow.

    W'(x, i) = Phi(x) i + L(x) i^2 / 2            V(x) = k x^2 / 2 + ...

W' is the magnetic co-energy (equation 9): the first term is the coil in the magnet's field, the
second the reluctance. Its derivatives describe the whole transducer: force dW'/dx, flux linkage
dW'/di, incremental inductance d^2W'/di^2. The mixed derivatives are equal, so the force gives the
motion exactly the energy that it takes from the electrical side. V is the energy in spring and
stops. Pure functions; any thread may call them.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from device.rig.parameters import ActuatorParameters, LargeSignalParameters
from device.rig.shapes import Arctangent, Hardening, Polynomial, Shape, Stops, Sum, Tanh
from device.units import FloatArray


@dataclass(frozen=True)
class CoEnergy:
    """W'(x, i) as data. magnet: Phi in Wb, Phi' = Bl in N/A; inductance: L in H, above 0."""

    magnet: Shape
    inductance: Shape

    def value(self, x: FloatArray, i: FloatArray) -> FloatArray:
        """W' in J."""
        return self.magnet.jet(x)[0] * i + self.inductance.jet(x)[0] * i * i / 2.0

    def force_n(self, x: FloatArray, i: FloatArray) -> FloatArray:
        """dW'/dx: the force on the moving mass, N."""
        return self.magnet.jet(x)[1] * i + self.inductance.jet(x)[1] * i * i / 2.0

    def flux_linkage_wb(self, x: FloatArray, i: FloatArray) -> FloatArray:
        """dW'/di: the flux linkage of the coil, Wb."""
        return self.magnet.jet(x)[0] + self.inductance.jet(x)[0] * i

    def incremental_inductance_h(self, x: FloatArray, i: FloatArray) -> FloatArray:
        """d^2W'/di^2, H; it does not depend on i, but has its shape."""
        return self.inductance.jet(x)[0] + 0.0 * i

    def current_a(self, x: FloatArray, flux_linkage_wb: FloatArray) -> FloatArray:
        """The current for a flux linkage, A: the inverse of dW'/di."""
        return (flux_linkage_wb - self.magnet.jet(x)[0]) / self.inductance.jet(x)[0]

    def stored_energy_j(self, x: FloatArray, i: FloatArray) -> FloatArray:
        """i dW'/di - W' (Legendre transform): the energy in the field, J."""
        return i * self.flux_linkage_wb(x, i) - self.value(x, i)

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
    """Derivatives of W' at (x, flux linkage), arrays of one shape.

    flux_slope is d^2W'/dx di, Wb/m or N/A; force_slope is d^2W'/dx^2 at constant current, N/m.
    """

    current_a: FloatArray
    force_n: FloatArray
    flux_slope: FloatArray
    inductance_h: FloatArray
    force_slope: FloatArray


@dataclass(frozen=True)
class Energies:
    """Everything but masses that stores energy in an actuator, and the loss of its stops.

    The potential V, in J, includes the stops. Their damping per speed is stop_loss_s_per_m times
    their force (Hunt and Crossley 1975), at either stop and in either direction.
    """

    co_energy: CoEnergy
    potential: Shape
    stops: Stops
    stop_loss_s_per_m: float


def linear_energies(p: ActuatorParameters) -> Energies:
    """Return those of the linear actuator: Phi = Bl x, L constant, V = k x^2 / 2, no stops."""
    return Energies(
        CoEnergy(
            Polynomial((0.0, p.force_factor_n_per_a)),
            Polynomial((p.inductance_h,)),
        ),
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
    magnet: Shape = Polynomial((0.0, p.force_factor_n_per_a))
    if loss > 0.0:
        magnet = Arctangent(p.force_factor_n_per_a, p.x_max_m * math.sqrt((1.0 - loss) / loss))
    return Energies(
        CoEnergy(magnet, Tanh(p.inductance_h, large.inductance_change, p.x_max_m)),
        Sum((Hardening(spring, rise), stops)),
        stops,
        large.stop_loss_s_per_m,
    )


def magnetic_divided(co_energy: CoEnergy, x0: float, x1: float) -> tuple[float, ...]:
    """Return flux and 1 / L at both ends of a step, each with its divided difference.

    The discrete gradient of the field's energy is made of them.
    """
    flux0, flux1 = co_energy.magnet.value(x0), co_energy.magnet.value(x1)
    l0, l1 = co_energy.inductance.value(x0), co_energy.inductance.value(x1)
    return (
        flux0,
        flux1,
        co_energy.magnet.divided(x0, x1),
        1.0 / l0,
        1.0 / l1,
        -co_energy.inductance.divided(x0, x1) / (l0 * l1),
    )


def stored_energy_j(energies: Energies, x: FloatArray, current_a: FloatArray) -> FloatArray:
    """Return the energy in spring, stops and field, J, at each excursion and current."""
    return np.asarray(energies.potential.jet(x)[0]) + energies.co_energy.stored_energy_j(
        x, current_a
    )
