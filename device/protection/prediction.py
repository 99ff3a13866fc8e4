"""What a block of drive does to a stack of linear models of one actuator, by matrices.

Each model is equations (8)-(10) with a force linear in the current, stepped exactly for a voltage
that is straight between samples (Van Loan 1978), as `device.rig.actuator` does it. Its state is
(x sqrt(k), x' sqrt(m), i sqrt(L), last volt), so that half the square of the first three is the
stored energy. All that is asked of a block is linear in the state before it and in its drive:
one matrix for each, made beforehand.
"""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from device.rig import ActuatorParameters
from device.rig.actuator import LinearActuator
from device.rig.linear_system import Quantity, first_order_hold, state_space
from device.units import FloatArray

STATES = 4
_WATCHED_HZ = 12_000.0
"""Excursion is looked at no less often than this; what lies between is bounded, see `slack`."""
_TAIL_POINTS = 48
_HORIZON_FRAMES = 1 << 18


class Prediction:
    """Matrices of the models for one length of block; immutable. Any thread may use it.

    models: rigs that the actuator may be, the believed one first; samplerate: Hz; block_frames:
    1 or more; volts: at the actuator for full scale; source_impedance_ohm: of the amplifier;
    excursion_m: the limit; current_models: of how many of the models the current is wanted.

    Excursion is in shares of the limit, less what it may be between two frames; current in A.
    Rows of `moved`: excursion at some frames of the block, the last among them, then STATES rows
    of the state at its end. For the drive of a block, (block_frames,), and the state before it:

    moved_by_drive: (models * rows, block_frames); moved_freely: (models, rows, STATES).
    current_by_drive: (current_models * block_frames, block_frames); current_freely:
    (current_models, block_frames, STATES).
    tail: (models, points, STATES), excursion from a state on with no drive.
    reach: (models, 1), the largest excursion that a drive within ±1 can ever cause from rest.
    swing: (models, 1), amplitude of a swing over the square root of twice its energy; swing_m is
    the believed model's in m.
    """

    def __init__(
        self,
        models: Sequence[ActuatorParameters],
        samplerate: float,
        block_frames: int,
        *,
        volts: float,
        source_impedance_ohm: float,
        excursion_m: float,
        current_models: int = 1,
    ) -> None:
        self.models = tuple(models)
        self.block_frames = block_frames
        stride = max(1, int(samplerate // _WATCHED_HZ))
        slack_m, tail_slack_m = _slacks_m(self.models, excursion_m, volts, samplerate, stride)
        share = 1.0 / (excursion_m - slack_m)
        tail_share = 1.0 / (excursion_m - slack_m - tail_slack_m)
        # Back from the last frame of the block.
        watched = np.arange(block_frames - 1, -1, -stride)[::-1]
        self.rows = len(watched) + STATES
        moved, moved_freely, current, current_freely, tail = [], [], [], [], []
        for model in self.models:
            step, drive, x_row, i_row = _step(model, samplerate, source_impedance_ohm)
            drive = drive * volts
            powers = _powers(step, block_frames)
            impulse = np.array([power @ drive for power in powers[:-1]])
            after = np.array(powers[1:])
            moved += [_convolution(impulse @ x_row)[watched] * share, impulse[::-1].T]
            moved_freely.append(np.vstack([x_row @ after[watched] * share, powers[-1]]))
            current.append(_convolution(impulse @ i_row))
            current_freely.append(i_row @ after)
            tail.append(_tail(model, step, samplerate, x_row) * tail_share)
        self.moved_by_drive: FloatArray = np.vstack(moved)
        self.moved_freely: FloatArray = np.array(moved_freely)
        self.current_by_drive: FloatArray = np.vstack(current[:current_models])
        self.current_freely: FloatArray = np.array(current_freely[:current_models])
        self.tail: FloatArray = np.array(tail)
        self.swing_m = 1.0 / math.sqrt(models[0].stiffness_n_per_m)
        self.swing = share / np.sqrt([[model.stiffness_n_per_m] for model in models])
        reach_m = [
            _reach(model, samplerate, source_impedance_ohm, "displacement_m") for model in models
        ]
        self.reach = share * volts * np.array(reach_m)[:, None]


def _slacks_m(
    models: Sequence[ActuatorParameters],
    limit_m: float,
    volts: float,
    samplerate: float,
    stride: int,
) -> tuple[float, float]:
    """How much larger excursion may be between watched frames of a block, and of the tail, m.

    Half a step away from a watched one it is larger by half of the acceleration times that time
    squared at most. At the limit the spring gives most of the acceleration, the coil the rest; in
    the tail the coil gives none. What the tail has seen is seen again, more finely, in blocks to
    come: so it has to keep off by both.
    """
    worst_m, tail_m = 0.0, 0.0
    for model in models:
        spring = model.resonance_rad_s**2 * limit_m * (1.0 + 1.0 / model.q_total())
        coil = model.force_factor_n_per_a * volts / model.resistance_ohm / model.moving_mass_kg
        within_s = stride / samplerate / 2.0
        tail_s = max(1.0 / samplerate, 1.0 / model.resonance_hz / _TAIL_POINTS) / 2.0
        worst_m = max(worst_m, (spring + coil) * within_s**2 / 2.0)
        tail_m = max(tail_m, spring * tail_s**2 / 2.0)
    # Coarse at the lowest rates only: then half of the limit is left, and it is still kept.
    return min(worst_m, limit_m / 4.0), min(tail_m, limit_m / 4.0)


@lru_cache(maxsize=64)  # as in actuator.py
def _step(
    p: ActuatorParameters, samplerate: float, source_impedance_ohm: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(STATES, STATES) and (STATES,): S[n] = step S[n-1] + drive v[n]; what x and i are of S."""
    rate, drive, rows = state_space(p, source_impedance_ohm)
    last = STATES - 1
    step = np.zeros((STATES, STATES))
    step[:last, :last], step[:last, last], from_new = first_order_hold(
        rate, drive, 1.0 / samplerate
    )
    x_row, i_row = (np.append(rows[name], 0.0) for name in ("displacement_m", "current_a"))
    return step, np.append(from_new, 1.0), x_row, i_row


def _powers(step: FloatArray, count: int) -> list[FloatArray]:
    """The powers 0 to `count` of a matrix."""
    powers = [np.eye(STATES)]
    for _ in range(count):
        powers.append(step @ powers[-1])
    return powers


def _convolution(impulse: FloatArray) -> FloatArray:
    """(n, n): lower triangular; times a drive it is the response to it."""
    n = len(impulse)
    delay = np.arange(n)[:, None] - np.arange(n)
    return np.where(delay >= 0, impulse[np.abs(delay)], 0.0)


def _tail(
    p: ActuatorParameters, step: FloatArray, samplerate: float, x_row: FloatArray
) -> FloatArray:
    """(points, STATES): x over one period of a free swing; it is never larger afterwards.

    The coil's current, and the straight line down from the last volt, act within its beginning.
    """
    frames = max(1, math.ceil(samplerate / p.resonance_hz / (1.25 * _TAIL_POINTS)))
    stride = np.linalg.matrix_power(step, frames)
    rows = [x_row]
    for _ in range(math.ceil(1.25 * _TAIL_POINTS)):
        rows.append(rows[-1] @ stride)
    return np.array(rows)


def most_current_a(
    models: Sequence[ActuatorParameters], samplerate: float, source_impedance_ohm: float
) -> float:
    """The largest current that a drive within ±1 V can ever cause in any of the models, A."""
    return max(_reach(p, samplerate, source_impedance_ohm, "current_a") for p in models)


def _reach(
    p: ActuatorParameters, samplerate: float, source_impedance_ohm: float, quantity: Quantity
) -> float:
    """The largest |quantity| per volt of peak drive: the sum of the impulse response's magnitudes.

    Infinity where it has not decayed after some seconds: then every block is looked at.
    """
    decay = math.pi * p.resonance_hz / p.q_total(source_impedance_ohm) / samplerate
    frames = math.ceil(25.0 / decay)
    if frames > _HORIZON_FRAMES:
        return math.inf
    impulse = np.zeros(frames)
    impulse[0] = 1.0
    response = LinearActuator(p, samplerate, source_impedance_ohm).move(impulse, (quantity,))
    # e^-25 of it is left out.
    return float(np.abs(getattr(response, quantity)).sum()) * (1.0 + 1e-9)
