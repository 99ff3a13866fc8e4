"""What the energy functions of an actuator say, straight from their definition."""

from __future__ import annotations

import numpy as np

from audioflinger_hook.transform import FloatArray
from device.rig.co_energy import CoEnergy, Energies


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
