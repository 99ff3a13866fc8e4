"""Motion of a simulated rig, computed by SciPy's `solve_ivp` as a reference."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from audioflinger_hook.transform import FloatArray
from device.rig import Rig

STIFF_PER_S = 1e5  # decay rate of the coil's current in 1/s from which a circuit is stiff

Rates = Callable[[float, list[float]], tuple[list[float], list[float]]]


def rates_of(rig: Rig, *, seat: bool = False) -> Rates:
    """Return a function that computes the right-hand side of the rig's equations of motion.

    Its arguments are the voltage and the state y, u, i, z, z'. Its results are the derivatives of
    the state, and y, y', i, u' and z''. Here y is the excursion, u the speed of the moving mass, i
    the current, and z the position of the frame (device/rig/equations.py).

    seat: whether the frame of the rig can move on the seat.
    """
    p, large = rig.actuator, rig.large_signal
    ohm = p.resistance_ohm + rig.amplifier.source_impedance_ohm
    derivatives = _derivatives(rig)
    frame = rig.seat if seat else None

    def rates(volt: float, state: list[float]) -> tuple[list[float], list[float]]:
        y, u, i, z, frame_speed = state
        w = u - frame_speed
        factor, henry, slope, spring = derivatives(y)
        force = (factor + 0.5 * slope * i) * i - spring - p.damping_n_s_per_m * w
        if large and abs(y) > large.stop_m:
            pressed = large.stop_n_per_m2 * (abs(y) - large.stop_m) ** 2
            force -= math.copysign(pressed, y) + large.stop_loss_s_per_m * pressed * w
        pushed = 0.0
        if frame:
            resisting = frame.stiffness_n_per_m * z + frame.damping_n_s_per_m * frame_speed
            pushed = -(force + resisting) / frame.mass_kg
        change = (volt - ohm * i - (factor + slope * i) * w) / henry
        a = force / p.moving_mass_kg
        return [w, a, change, frame_speed, pushed], [y, w, i, a, pushed]

    return rates


def _derivatives(rig: Rig) -> Callable[[float], tuple[float, float, float, float]]:
    p, large = rig.actuator, rig.large_signal
    factor, henry, stiffness = p.force_factor_n_per_a, p.inductance_h, p.stiffness_n_per_m
    rise = large.stiffness_rise if large else 0.0
    loss = large.force_factor_loss if large else 0.0
    change = large.inductance_change if large else 0.0

    def at(y: float) -> tuple[float, float, float, float]:
        share = y / p.x_max_m
        t = math.tanh(share)
        return (
            factor / (1.0 + loss / (1.0 - loss) * share * share),
            henry * (1.0 - change * t),
            henry * change / p.x_max_m * (t * t - 1.0),
            stiffness * (1.0 + rise * share * share) * y,
        )

    return at


def solved_motion(
    rig: Rig, samplerate: int, volts: FloatArray, *, seat: bool = False
) -> FloatArray:
    """Return y, y', i, u' and z'' (device/rig/equations.py) at each sample of `volts`, (5, frames).

    The voltage is linear between samples, and 0 before the first sample. The relative tolerance is
    1e-12, or 1e-10 if the coil's current decays very fast.

    seat: whether the frame of the rig can move on the seat.
    """
    rates = rates_of(rig, seat=seat)
    ohm = rig.actuator.resistance_ohm + rig.amplifier.source_impedance_ohm
    is_stiff = ohm / rig.actuator.inductance_h > STIFF_PER_S
    options: dict[str, Any] = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-16}
    if is_stiff:
        options = {"method": "Radau", "rtol": 1e-10, "atol": 1e-13}

    def along(t: float, state: Any, before_v: float, volt: float) -> list[float]:
        return rates(before_v + (volt - before_v) * t * samplerate, state.tolist())[0]

    state, before_v = np.zeros(5), 0.0
    shown = np.empty((5, len(volts)))
    for frame, volt in enumerate(volts.tolist()):
        each = solve_ivp(along, (0.0, 1.0 / samplerate), state, args=(before_v, volt), **options)
        state, before_v = each.y[:, -1], volt
        shown[:, frame] = rates(volt, state.tolist())[1]
    return shown
