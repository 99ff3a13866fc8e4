"""What a block of drive does to several linear models of one actuator, as tables.

Half the square of the first three states is the actuator's stored energy.
"""

import math
from collections.abc import Sequence

import numpy as np
import scipy

from device.drive.protection.drive_model import LAST, DriveModel, rings
from device.rig import ActuatorParameters
from device.rig.actuator import LinearActuator, Quantity
from device.units import FloatArray

_WATCHED_HZ = 6_000.0
"""Excursion is computed at least this often; `_slacks_m` bounds it in between."""
_TAIL_POINTS = 32
_TAIL_PERIODS = 1.25
_DECAYED = 25.0
_HORIZON_FRAMES = 1 << 20


class Prediction:
    """What a block of drive does to the models, for one length of block. Immutable; for any thread.

    Excursion is a share of the limit, less what it may rise between two frames; current is in A.
    Impulse responses are stored last frame first, and matrices by their columns, as the core uses
    them: a state times a matrix is a sum of columns.

    models: rigs that the actuator may be; the believed one first.
    samplerate: rate in Hz.
    block_frames: length of a block, 1 or more.
    volts: at the actuator for full scale.
    source_impedance_ohm: of the amplifier.
    sections: of the amplifier's band, (n, 6).
    current_models: number of models whose current is limited.
    states: of one model. stride: frames between two whose excursion is computed, the last of a
        block among them; watched: their number. tail_points: of the free swing after a block.
    excursion_by_drive: (models, block_frames). excursion_by_state: (models, states, watched).
    state_by_drive: (models, states, block_frames). state_by_state: (models, states, states).
    current_by_drive: (1 + current_models, block_frames); the first is the current of a coil that
        nothing but its resistance holds back. Whatever the actuator is, its coil gets no warmer.
    current_by_state: (1 + current_models, states, block_frames).
    tail_by_state: (models, states, tail_points): excursion after a state without drive.
    reach: (models,): largest excursion from rest that a drive within ±1 can cause.
    swing: (models,), swing_m: amplitude of a swing over the root of twice its energy, as a share of
        the limit, and of the believed model in m.
    last_kick: (models,): such a root for a last output of 1.
    ring: (models,): largest excursion that a state of length 1 of the amplifier can cause.
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
        current_models: int = 0,
    ) -> None:
        self.models = tuple(models)
        self.stride = max(1, int(samplerate // _WATCHED_HZ))
        slack_m, tail_slack_m = _slacks_m(self.models, excursion_m, volts, samplerate, self.stride)
        share = 1.0 / (excursion_m - slack_m)
        tail_share = 1.0 / (excursion_m - slack_m - tail_slack_m)
        drives = [
            DriveModel(model, samplerate, source_impedance_ohm, sections, volts)
            for model in self.models
        ]
        self.states = drives[0].states
        # Counted back from the last frame of the block.
        frames = np.arange(block_frames - 1, -1, -self.stride)[::-1]
        self.watched = len(frames)
        excursion, by_state, state, advance, responses, tail = ([] for _ in range(6))
        for model, drive in zip(self.models, drives, strict=True):
            powers = _powers(drive.step, block_frames)
            impulse = np.array([power @ drive.drive for power in powers[:-1]])[::-1]
            after = np.array(powers[1:])
            excursion.append(impulse @ drive.x_row * share)
            by_state.append((drive.x_row @ after[frames] * share).T)
            state.append(impulse.T)
            advance.append(powers[-1].T)
            responses.append((impulse, after))
            tail.append(_tail(model, drive, samplerate, block_frames).T * tail_share)
        self.excursion_by_drive: FloatArray = np.array(excursion)
        self.excursion_by_state: FloatArray = np.array(by_state)
        self.state_by_drive: FloatArray = np.array(state)
        self.state_by_state: FloatArray = np.array(advance)
        unmoved_ohm = models[0].resistance_ohm + source_impedance_ohm
        heating = (*responses[0], volts / unmoved_ohm * np.eye(self.states)[LAST])
        limited = [
            (*response, drive.i_row)
            for response, drive in zip(responses[:current_models], drives, strict=False)
        ]
        rows = [heating, *limited]
        self.current_by_drive: FloatArray = np.array([impulse @ row for impulse, _, row in rows])
        self.current_by_state: FloatArray = np.array([(row @ after).T for _, after, row in rows])
        # Zeros where one model has fewer points than another.
        self.tail_points = max(rows.shape[1] for rows in tail)
        self.tail_by_state: FloatArray = np.array(
            [np.pad(rows, ((0, 0), (0, self.tail_points - rows.shape[1]))) for rows in tail]
        )
        self.swing_m = 1.0 / math.sqrt(models[0].stiffness_n_per_m)
        self.swing = share / np.sqrt([model.stiffness_n_per_m for model in models])
        self.last_kick: FloatArray = np.array([drive.last_kick for drive in drives])
        self.reach: FloatArray = (share * volts) * np.array(
            [
                _reach(model, samplerate, source_impedance_ohm, sections, "displacement_m")
                for model in models
            ]
        )
        self.ring: FloatArray = (share * volts) * np.array(
            [_ring(model, samplerate, source_impedance_ohm, sections) for model in models]
        )


def _slacks_m(
    models: Sequence[ActuatorParameters],
    limit_m: float,
    volts: float,
    samplerate: float,
    stride: int,
) -> tuple[float, float]:
    """Return by how much excursion may rise between computed frames of a block, and of the tail, m.

    Half a step from a computed frame that is at most half the acceleration times the time squared.
    The spring and the coil give the acceleration. Friction gives none in the tail, since the speed
    is 0 at the largest excursion. Later blocks compute the tail again at smaller steps, so that it
    needs both margins.
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
    # This only happens at the lowest rates; half of the limit is left then.
    return min(worst_m, limit_m / 4.0), min(tail_m, limit_m / 4.0)


def _powers(step: FloatArray, count: int) -> list[FloatArray]:
    """Return the powers 0 to `count` of a matrix."""
    powers = [np.eye(len(step))]
    for _ in range(count):
        powers.append(step @ powers[-1])
    return powers


def _tail(
    p: ActuatorParameters, drive: DriveModel, samplerate: float, block_frames: int
) -> FloatArray:
    """Return x over one period of a free swing in m, (points, states); later it is smaller.

    The coil's current and the last output act only at its start. An amplifier swings back for
    longer, but with a fifth of the effect. The distance of two points divides the length of a
    block: the next block computes the same points and gets the same values if nothing new came.
    """
    wanted = max(1.0, samplerate / p.resonance_hz / _TAIL_POINTS)
    gap = max(d for d in range(1, block_frames + 1) if block_frames % d == 0 and d <= wanted)
    stride = np.linalg.matrix_power(drive.step, gap)
    rows = [drive.x_row]
    for _ in range(math.ceil(_TAIL_PERIODS * samplerate / p.resonance_hz / gap)):
        rows.append(rows[-1] @ stride)
    return np.array(rows)


def most_current_a(
    models: Sequence[ActuatorParameters],
    samplerate: float,
    source_impedance_ohm: float,
    sections: FloatArray,
) -> float:
    """Return the largest current in A that a drive within ±1 V can cause in any of the models."""
    return max(_reach(p, samplerate, source_impedance_ohm, sections, "current_a") for p in models)


def _slowest_hz(sections: FloatArray, samplerate: float) -> float:
    """Return the lowest corner of the sections in Hz; infinity if there is none."""
    poles = [math.sqrt(float(a2)) for a2 in sections[:, 5]]
    # A Butterworth pair shrinks by 1 / sqrt(2) of its corner, in rad/s.
    return min((-math.log(r) * samplerate * math.sqrt(2.0) / math.tau for r in poles),
               default=math.inf)  # fmt: skip


def _horizon(
    p: ActuatorParameters, samplerate: float, source_impedance_ohm: float, sections: FloatArray
) -> int:
    """Return the frames until all ringing has fallen to e^-25; 0 if that is too long to compute."""
    decay = math.pi * p.resonance_hz / p.q_total(source_impedance_ohm)
    slow = math.tau * _slowest_hz(sections, samplerate) / math.sqrt(2.0)
    # The actuator rings after the amplifier.
    frames = math.ceil(_DECAYED * samplerate * (1.0 / decay + 1.0 / slow))
    return frames if frames <= _HORIZON_FRAMES else 0


def _reach(
    p: ActuatorParameters,
    samplerate: float,
    source_impedance_ohm: float,
    sections: FloatArray,
    quantity: Quantity,
) -> float:
    """Return the largest |quantity| per volt of peak drive: the sum of |impulse response|.

    Infinity if it decays too slowly; then every block is computed.
    """
    frames = _horizon(p, samplerate, source_impedance_ohm, sections)
    if not frames:
        return math.inf
    impulse = np.zeros(frames)
    impulse[0] = 1.0
    if len(sections):
        impulse = scipy.signal.sosfilt(sections, impulse)
    response = LinearActuator(p, samplerate, source_impedance_ohm).move(impulse, (quantity,))
    # The remaining e^-25 is not in the sum.
    return float(np.abs(getattr(response, quantity)).sum()) * (1.0 + 1e-9)


def _ring(
    p: ActuatorParameters, samplerate: float, source_impedance_ohm: float, sections: FloatArray
) -> float:
    """Return the largest |x| in m per volt after an amplifier's state of length 1 without drive."""
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
