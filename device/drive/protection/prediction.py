"""What a block of drive does to a stack of linear models of one actuator, by matrices.

Each model is the amplifier's band and equations (8)-(10) with a force linear in the current,
stepped exactly for a voltage that is straight between samples (chain.py). Half the square of the
first three states is the actuator's stored energy. All that is asked of a block is linear in the
state before it and in its drive: one matrix for each, made beforehand.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy.signal import sosfilt

from device.drive.protection.chain import Chain, rings
from device.rig import ActuatorParameters
from device.rig.actuator import LinearActuator, Quantity
from device.units import FloatArray

_WATCHED_HZ = 12_000.0
"""Excursion is looked at no less often than this; what lies between is bounded, see `slack`."""
_TAIL_POINTS = 48
_TAIL_PERIODS = 1.25
_DECAYED = 25.0
_HORIZON_FRAMES = 1 << 20


class Prediction:
    """Matrices of the models for one length of block; immutable. Any thread may use it.

    models: rigs that the actuator may be, the believed one first; samplerate: Hz; block_frames:
    1 or more; volts: at the actuator for full scale; source_impedance_ohm: of the amplifier;
    sections: of its band, (n, 6); excursion_m: the limit; current_models: of how many of the
    models the current is wanted.

    Excursion is in shares of the limit, less what it may be between two frames; current in A.
    Rows of `moved`: excursion at some frames of the block, the last among them, then `states` rows
    of the state at its end. For the drive of a block, (block_frames,), and the state before it:

    moved_by_drive: (models * rows, block_frames); moved_freely: (models, rows, states).
    current_by_drive: (current_models * block_frames, block_frames); current_freely:
    (current_models, block_frames, states).
    tail: (models, points, states), excursion from a state on with no drive.
    reach: (models, 1), the largest excursion that a drive within ±1 can ever cause from rest.
    swing: (models, 1), amplitude of a swing over the square root of twice its energy; swing_m is
    the believed model's in m. last_kick: (models, 1), such a root for a last output of 1.
    ring: (models, 1), the largest excursion that an amplifier's state of length 1 can cause.
    """

    def __init__(
        self,
        models: Sequence[ActuatorParameters],
        samplerate: float,
        block_frames: int,
        *,
        volts: float,
        source_impedance_ohm: float,
        sections: FloatArray,
        excursion_m: float,
        current_models: int = 1,
    ) -> None:
        self.models = tuple(models)
        self.block_frames = block_frames
        stride = max(1, int(samplerate // _WATCHED_HZ))
        slack_m, tail_slack_m = _slacks_m(self.models, excursion_m, volts, samplerate, stride)
        share = 1.0 / (excursion_m - slack_m)
        tail_share = 1.0 / (excursion_m - slack_m - tail_slack_m)
        chains = [
            Chain(model, samplerate, source_impedance_ohm, sections, volts) for model in self.models
        ]
        self.states = chains[0].states
        # Back from the last frame of the block.
        watched = np.arange(block_frames - 1, -1, -stride)[::-1]
        self.rows = len(watched) + self.states
        moved, moved_freely, current, current_freely = [], [], [], []
        tail = []
        for model, chain in zip(self.models, chains, strict=True):
            powers = _powers(chain.step, block_frames)
            impulse = np.array([power @ chain.drive for power in powers[:-1]])
            after = np.array(powers[1:])
            moved += [_convolution(impulse @ chain.x_row)[watched] * share, impulse[::-1].T]
            moved_freely.append(np.vstack([chain.x_row @ after[watched] * share, powers[-1]]))
            current.append(_convolution(impulse @ chain.i_row))
            current_freely.append(chain.i_row @ after)
            tail.append(_tail(model, chain, samplerate, block_frames) * tail_share)
        self.moved_by_drive: FloatArray = np.vstack(moved)
        self.moved_freely: FloatArray = np.array(moved_freely)
        self.current_by_drive: FloatArray = np.vstack(current[:current_models])
        self.current_freely: FloatArray = np.array(current_freely[:current_models])
        # Nothing where one model has fewer places than another.
        longest = max(map(len, tail))
        self.tail: FloatArray = np.array(
            [np.pad(rows, ((0, longest - len(rows)), (0, 0))) for rows in tail]
        )
        self.swing_m = 1.0 / math.sqrt(models[0].stiffness_n_per_m)
        self.swing = share / np.sqrt([[model.stiffness_n_per_m] for model in models])
        self.last_kick: FloatArray = np.array([[chain.last_kick] for chain in chains])
        self.reach: FloatArray = (share * volts) * np.array(
            [
                [_reach(model, samplerate, source_impedance_ohm, sections, "displacement_m")]
                for model in models
            ]
        )
        self.ring: FloatArray = (share * volts) * np.array(
            [[_ring(model, samplerate, source_impedance_ohm, sections)] for model in models]
        )


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
    the tail, too, as an amplifier may swing back, but there friction counts for nothing: where x is
    largest the speed is 0. What the tail has seen is seen again, more
    finely, in blocks to come: so it has to keep off by both.
    """
    worst_m, tail_m = 0.0, 0.0
    for model in models:
        spring = model.resonance_rad_s**2 * limit_m * (1.0 + 1.0 / model.q_total())
        coil = model.force_factor_n_per_a * volts / model.resistance_ohm / model.moving_mass_kg
        within_s = stride / samplerate / 2.0
        tail_s = max(1.0 / samplerate, 1.0 / model.resonance_hz / _TAIL_POINTS) / 2.0
        worst_m = max(worst_m, (spring + coil) * within_s**2 / 2.0)
        peak = model.resonance_rad_s**2 * limit_m + coil
        tail_m = max(tail_m, peak * tail_s**2 / 2.0)
    # Coarse at the lowest rates only: then half of the limit is left, and it is still kept.
    return min(worst_m, limit_m / 4.0), min(tail_m, limit_m / 4.0)


def _powers(step: FloatArray, count: int) -> list[FloatArray]:
    """The powers 0 to `count` of a matrix."""
    powers = [np.eye(len(step))]
    for _ in range(count):
        powers.append(step @ powers[-1])
    return powers


def _convolution(impulse: FloatArray) -> FloatArray:
    """(n, n): lower triangular; times a drive it is the response to it."""
    n = len(impulse)
    delay = np.arange(n)[:, None] - np.arange(n)
    return np.where(delay >= 0, impulse[np.abs(delay)], 0.0)


def _tail(p: ActuatorParameters, chain: Chain, samplerate: float, block_frames: int) -> FloatArray:
    """(points, states): x over one period of a free swing, in m; it is never larger afterwards.

    The coil's current, and the straight line down from the last output, act within its beginning.
    An amplifier swings back for longer, but only by a fifth of what the stop itself has thrown at
    the actuator within this period; and one whose corner is above the resonance is done by then.

    The distance of two points divides a block's length: a block later the same places are looked
    at again, and where nothing new has come they have the answer that they had.
    """
    wanted = max(1.0, samplerate / p.resonance_hz / _TAIL_POINTS)
    gap = max(d for d in range(1, block_frames + 1) if block_frames % d == 0 and d <= wanted)
    stride = np.linalg.matrix_power(chain.step, gap)
    rows = [chain.x_row]
    for _ in range(math.ceil(_TAIL_PERIODS * samplerate / p.resonance_hz / gap)):
        rows.append(rows[-1] @ stride)
    return np.array(rows)


def most_current_a(
    models: Sequence[ActuatorParameters],
    samplerate: float,
    source_impedance_ohm: float,
    sections: FloatArray,
) -> float:
    """The largest current that a drive within ±1 V can ever cause in any of the models, A."""
    return max(_reach(p, samplerate, source_impedance_ohm, sections, "current_a") for p in models)


def _slowest_hz(sections: FloatArray, samplerate: float) -> float:
    """The lowest corner of the sections, Hz; infinity where there is none."""
    poles = [math.sqrt(float(a2)) for a2 in sections[:, 5]]
    # A Butterworth pair shrinks by 1 / sqrt(2) of its corner, in rad/s.
    return min((-math.log(r) * samplerate * math.sqrt(2.0) / math.tau for r in poles),
               default=math.inf)  # fmt: skip


def _horizon(
    p: ActuatorParameters, samplerate: float, source_impedance_ohm: float, sections: FloatArray
) -> int:
    """Frames until e^-25 of whatever rings is left; 0 where that is too long to compute."""
    decay = math.pi * p.resonance_hz / p.q_total(source_impedance_ohm)
    slow = math.tau * _slowest_hz(sections, samplerate) / math.sqrt(2.0)
    # One rings after the other.
    frames = math.ceil(_DECAYED * samplerate * (1.0 / decay + 1.0 / slow))
    return frames if frames <= _HORIZON_FRAMES else 0


def _reach(
    p: ActuatorParameters,
    samplerate: float,
    source_impedance_ohm: float,
    sections: FloatArray,
    quantity: Quantity,
) -> float:
    """The largest |quantity| per volt of peak drive: the sum of the impulse response's magnitudes.

    Infinity where it has not decayed after some seconds: then every block is looked at.
    """
    frames = _horizon(p, samplerate, source_impedance_ohm, sections)
    if not frames:
        return math.inf
    impulse = np.zeros(frames)
    impulse[0] = 1.0
    if len(sections):
        impulse = sosfilt(sections, impulse)
    response = LinearActuator(p, samplerate, source_impedance_ohm).move(impulse, (quantity,))
    # e^-25 of it is left out.
    return float(np.abs(getattr(response, quantity)).sum()) * (1.0 + 1e-9)


def _ring(
    p: ActuatorParameters, samplerate: float, source_impedance_ohm: float, sections: FloatArray
) -> float:
    """The largest |x| that an amplifier's state of length 1 and no drive can cause, m per volt."""
    if not len(sections):
        return 0.0
    frames = _horizon(p, samplerate, source_impedance_ohm, sections)
    if not frames:
        return math.inf
    squares = np.zeros(frames)
    for volts in rings(sections, frames):
        actuator = LinearActuator(p, samplerate, source_impedance_ohm)
        squares += actuator.move(volts, ("displacement_m",)).displacement_m ** 2
    return math.sqrt(float(squares.max()))
