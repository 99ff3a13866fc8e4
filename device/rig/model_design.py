"""The numbers and tables by which compiled code moves a rig (native/rig_model.c).

The linear model is exact for a voltage that is a straight line between samples. The non-linear one
makes at least one step of fourth order a sample (Runge and Kutta). The flux may decay within less
than a sample, so each step contains that decay exactly. The scheme is ETDRK4 of Cox and Matthews,
Exponential time differencing for stiff systems (2002).
"""

import math
from dataclasses import astuple

import numpy as np

from device.rig.actuator import first_order_hold
from device.rig.co_energy import table_of
from device.rig.equations import Equations

FLOOR = 0.01
"""Errors are shares of a peak, or of this share of Xmax where the peak is less."""
MARGIN = 2.5
"""Estimated error of the linear model, over its first-order correction. The largest error of white
noise is between the samples at which the correction is known."""
LONGEST_STEP_S = 1.0 / 40_000.0

_SHORTEST_STEP_S = 0.25e-6
"""A stop that needs shorter ones holds like a wall."""
_TURN, _CONTACT_TURN = 0.35, 0.125
"""Of the fastest motion below the stops and in them, radians a step at most."""
_COARSE_HZ = 6_000.0
"""Rate at which the first-order correction is computed."""
_STATES = 5
STATE_NUMBERS = 2 * _STATES + 8
"""Length of the state of a rig; at rest it is 0."""


class ModelDesign:
    """Both models of one rig at one sample rate.

    arrays: numbers, the table of the energies, steps by level, and the linear maps over a sample
    and over some samples. refine: steps are halved so often.
    """

    def __init__(
        self, equations: Equations, samplerate: float, tolerance: float, refine: int = 0
    ) -> None:
        e, p, seat = equations, equations.actuator, equations.seat
        period_s = 1.0 / samplerate
        self.coarse = max(1, round(samplerate / _COARSE_HZ))
        longest_s = min(LONGEST_STEP_S, _TURN / _fastest_rad_s(e))
        first = max(0, math.ceil(math.log2(period_s / longest_s) - 1e-9)) + refine
        last = math.ceil(math.log2(period_s / _SHORTEST_STEP_S)) + refine
        levels = 1 + max(first, last)
        table, stops = table_of(e.energies, p.x_max_m), e.energies.stops
        least_m = FLOOR * p.x_max_m
        frame = astuple(seat) if seat else (0, 0, 0)
        contact_kg = e.mass * seat.mass_kg / (e.mass + seat.mass_kg) if seat else e.mass
        numbers = np.array(
            [
                e.mass, e.damping, e.stiffness, e.force_factor, e.inductance,
                e.resistance_ohm, e.resistance_ohm,  # of a warm and of a cold coil
                stops.start, stops.hardness, e.energies.stop_loss_s_per_m,
                contact_kg, _CONTACT_TURN / 2**refine,
                table.lowest_m, table.intervals_per_m, len(table.rows), *frame,
                least_m, least_m * p.resonance_rad_s**2, tolerance, MARGIN,
                period_s, levels, first, self.coarse,
            ],
            dtype=np.float64,
        )  # fmt: skip
        decay_per_s = e.resistance_ohm / e.inductance
        steps = [_step(decay_per_s, period_s / 2**level) for level in range(levels)]
        scale = e.scale
        maps = []
        for width, entry in ((1, e.entry[:, 1:]), (self.coarse, e.entry)):
            # In coordinates whose squares are energies, entries do not differ by millions.
            rate, scaled = scale[:, None] * e.rate / scale, scale[:, None] * entry
            holds = [first_order_hold(rate, one, width * period_s) for one in scaled.T]
            inputs = [np.column_stack([hold[k] for hold in holds]) for k in (1, 2)]
            parts = holds[0][0] * scale, *inputs
            maps.append(np.concatenate([(part / scale[:, None]).ravel() for part in parts]))
        self.arrays = (numbers, table.rows, np.array(steps), *maps)


def _fastest_rad_s(e: Equations) -> float:
    """Return the rate of the fastest motion that stays below the stops."""
    reach = np.linspace(-1.0, 1.0, 41) * e.actuator.x_max_m
    stiffness = np.abs(e.energies.spring.jet(reach)[2]).max()
    # The coil's voltage acts like a spring, or like a damper where its current settles sooner.
    spring = e.force_factor / math.sqrt(e.inductance * e.mass)
    damper = e.force_factor**2 / (e.resistance_ohm * e.mass)
    fastest = math.sqrt(stiffness / e.mass) + e.damping / e.mass + min(spring, damper)
    if e.seat:
        big = e.seat.mass_kg
        fastest *= 1.0 + e.mass / big
        fastest += math.sqrt(e.seat.stiffness_n_per_m / big) + e.seat.damping_n_s_per_m / big
    return fastest


def _step(decay_per_s: float, width_s: float) -> tuple[float, ...]:
    """Return a step, and what half of it and all of it do to the flux, as `Step` in C lists it."""
    whole, half_s = decay_per_s * width_s, 0.5 * width_s
    two, three = _phi(2, -whole), _phi(3, -whole)
    return (
        *(width_s, decay_per_s, 0.0, 0.0),
        math.exp(-0.5 * whole),
        half_s * _phi(1, -0.5 * whole),
        half_s * half_s * _phi(2, -0.5 * whole),
        math.exp(-whole),
        width_s * _phi(1, -whole),
        width_s * width_s * two,
        width_s * (2.0 * two - 4.0 * three),
        width_s * (4.0 * three - two),
    )


def _phi(order: int, z: float) -> float:
    """Return (exp(z) less the first terms of its series) / z^order; z is 0 or less."""
    if abs(z) < 1.0:
        return math.fsum(z**k / math.factorial(k + order) for k in range(20))
    found = math.exp(z)
    for k in range(order):
        found = (found - 1.0 / math.factorial(k)) / z
    return found
