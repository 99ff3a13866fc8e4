"""What the energy functions of an actuator say, straight from their definition."""

import numpy as np

from audioflinger_hook.transform import FloatArray
from device.rig.co_energy import Energies


def stored_energy_j(e: Energies, x: FloatArray, i: FloatArray) -> FloatArray:
    """Return the energy in spring, stops and field, J: V + i dW'/di - W' = V + L i^2 / 2."""
    field_j = e.inductance(x)[0] * i * i / 2.0
    return np.asarray(e.spring(x)[0] + e.stops(x)[0] + field_j)
