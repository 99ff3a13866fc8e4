"""The linear actuator as a system of three states, and its exact step from sample to sample.

Equations (8)-(10) of the paper for a force linear in the current, see actuator.py. Whatever needs
the poles or the step, filters, predictions and dampings alike, takes them from here. Pure
functions; any thread may call them.
"""

from typing import Literal, get_args

import numpy as np
from scipy.linalg import expm

from device.rig.parameters import ActuatorParameters
from device.units import FloatArray

Quantity = Literal["displacement_m", "velocity_m_s", "current_a", "acceleration_m_s2"]
QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)


def state_space(
    p: ActuatorParameters, source_impedance_ohm: float
) -> tuple[FloatArray, FloatArray, dict[Quantity, FloatArray]]:
    """s' = rate s + drive v, and the row that gives each quantity from s.

    s = (x sqrt(k), x' sqrt(m), i sqrt(L)): half its square is the stored energy. In these
    coordinates the exchange of energy is antisymmetric, which keeps the exponential well
    conditioned whatever the units.
    """
    m, c, k = p.moving_mass_kg, p.damping_n_s_per_m, p.stiffness_n_per_m
    bl, inductance = p.force_factor_n_per_a, p.inductance_h
    resistance = p.resistance_ohm + source_impedance_ohm
    w0 = p.resonance_rad_s
    coupling = bl / np.sqrt(m * inductance)
    rate = np.array(
        [
            [0.0, w0, 0.0],
            [-w0, -c / m, coupling],
            [0.0, -coupling, -resistance / inductance],
        ]
    )
    drive = np.array([0.0, 0.0, 1.0 / np.sqrt(inductance)])
    rows: dict[Quantity, FloatArray] = {
        "displacement_m": np.array([1.0 / np.sqrt(k), 0.0, 0.0]),
        "velocity_m_s": np.array([0.0, 1.0 / np.sqrt(m), 0.0]),
        "current_a": np.array([0.0, 0.0, 1.0 / np.sqrt(inductance)]),
        "acceleration_m_s2": rate[1] / np.sqrt(m),
    }
    return rate, drive, rows


def first_order_hold(
    rate: FloatArray, drive: FloatArray, period_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(P, A, B) of s[n] = P s[n-1] + A v[n-1] + B v[n], exact for v linear between samples.

    Van Loan, "Computing integrals involving the matrix exponential", 1978: one exponential of the
    state, the voltage and its slope a sample holds all three.
    """
    n = len(rate)
    whole = np.zeros((n + 2, n + 2))
    whole[:n, :n] = rate * period_s
    whole[:n, n] = drive * period_s
    whole[n, n + 1] = 1.0
    exponential = expm(whole)
    level, slope = exponential[:n, n], exponential[:n, n + 1]
    return exponential[:n, :n], level - slope, slope
