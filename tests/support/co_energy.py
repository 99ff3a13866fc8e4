"""What the energy functions of an actuator say, straight from their definition, and its energy."""

from __future__ import annotations

import numpy as np

from audioflinger_hook.transform import FloatArray
from device.rig.co_energy import CoEnergy, Energies
from device.rig.equations import Equations


def co_energy_j(w: CoEnergy, x: FloatArray, i: FloatArray) -> FloatArray:
    """Return W' = Phi(x) i + L(x) i^2 / 2, J."""
    return np.asarray(w.magnet.jet(x)[0] * i + w.inductance.jet(x)[0] * i * i / 2.0)


def flux_linkage_wb(w: CoEnergy, x: FloatArray, i: FloatArray) -> FloatArray:
    """Return dW'/di, Wb."""
    return np.asarray(w.magnet.jet(x)[0] + w.inductance.jet(x)[0] * i)


def stored_energy_j(e: Energies, x: FloatArray, i: FloatArray) -> FloatArray:
    """Return the energy in spring, stops and field, J: V + i dW'/di - W' (Legendre transform)."""
    field_j = i * flux_linkage_wb(e.co_energy, x, i) - co_energy_j(e.co_energy, x, i)
    return np.asarray(e.potential.jet(x)[0]) + field_j


def whole_energy_j(equations: Equations, states: FloatArray) -> FloatArray:
    """Return H of (y, u, lambda, z, z'), (5 or more, points), including the frame."""
    y, u, flux, z, zs = states[:5]
    e, seat = equations.energies, equations.seat
    linkage = flux - e.co_energy.magnet.jet(y)[0]
    stored_j = e.potential.jet(y)[0] + equations.mass * u * u / 2.0
    stored_j = stored_j + linkage * linkage / (2.0 * e.co_energy.inductance.jet(y)[0])
    if seat:
        stored_j = stored_j + (seat.stiffness_n_per_m * z * z + seat.mass_kg * zs * zs) / 2.0
    return np.asarray(stored_j)


def step_errors(
    equations: Equations, step_s: float, states: FloatArray, volts: FloatArray
) -> FloatArray:
    """Return the energy-balance error of each passive step, as a share of what it handled.

    The states, (5 or more, steps + 1), begin before the first step; volts, (steps + 1,), likewise.
    The error is what was let in and neither stored nor turned into heat. A step's mean current
    follows from its change of flux.
    """
    e, h, seat = equations.energies, step_s, equations.seat
    volt = 0.5 * (volts[:-1] + volts[1:])
    moved, _, flux, frame = np.diff(states[:4])
    current = (volt - flux / h) / equations.resistance_ohm
    middle = states[0, :-1] + moved / 2.0
    drag = equations.damping + e.stop_loss_s_per_m * np.abs(e.stops.jet(middle)[1])
    heat_w = equations.resistance_ohm * current**2 + drag * (moved / h) ** 2
    if seat:
        heat_w += seat.damping_n_s_per_m * (frame / h) ** 2
    stored_j, let_in_j = whole_energy_j(equations, states), h * volt * current
    errors_j = np.abs(let_in_j - h * heat_w - np.diff(stored_j))
    handled_j = np.maximum(np.maximum(stored_j[:-1], stored_j[1:]), np.abs(let_in_j))
    return np.asarray(errors_j / np.maximum(handled_j, 1e-300))
