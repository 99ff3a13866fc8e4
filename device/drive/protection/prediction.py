"""What a block of drive does to several linear models of one actuator, as tables.

Half the square of the first three states is the actuator's stored energy.
"""

import math
from collections.abc import Sequence

import numpy as np

from device.drive.protection.drive_model import LAST, DriveModel
from device.units import FloatArray, Records

LANES = 8
"""The core reads groups of this many frames."""

_WATCHED_HZ = 6_000.0
"""Excursion is computed at least this often; `_slacks_m` bounds it in between."""
_TAIL_POINTS = 32
_TAIL_PERIODS = 1.25
_UNREACHABLE = 1e30
"""In place of infinity, for a reach that is not computed."""


def prediction_records(
    drives: Sequence[DriveModel], block_frames: int, excursion_m: float, current_models: int
) -> Records:
    """Return what a block of drive does to the models, by name; see `ProtectionDesign` of the core.

    Excursion is a share of the limit, less what it may rise between two frames; current is in A.
    Impulse responses are stored last frame first, and matrices by their columns, as the core uses
    them: a state times a matrix is a sum of columns. Zeros fill whole groups of `LANES`.

    drives: rigs that the actuator may be; the believed one first. block_frames: length of a block,
    1 or more. excursion_m: limit, either way. current_models: number whose current is limited.

    states: of one model. stride: frames between two whose excursion is computed, the last of a
        block among them; watched: their number. tail_points: of the free swing after a block.
    excursion_by_drive: (models, block_frames). excursion_by_state: (models, states, watched).
    state_by_drive: (models, states, block_frames). state_by_state: (models, states, states).
    current_by_drive: (currents, block_frames), currents = 1 + current_models; the first is of a
        coil that nothing but its resistance holds back. Whatever the actuator is, its coil gets no
        warmer.
    current_by_state: (currents, states, block_frames).
    tail_by_state: (models, states, tail_points): excursion after a state without drive.
    reach: (models,): largest excursion from rest that a drive within ±1 can cause.
    swing: (models,), swing_m: amplitude of a swing over the root of twice its energy, as a share of
        the limit, and of the believed model in m.
    last_kick: (models,): such a root for a last output of 1.
    ring: (models,): largest excursion that a state of length 1 of the amplifier can cause.
    """
    believed, states, volts = drives[0].model, drives[0].states, drives[0].volts
    stride = max(1, int(drives[0].samplerate // _WATCHED_HZ))
    slack_m, tail_slack_m = _slacks_m(drives, excursion_m, stride)
    share = 1.0 / (excursion_m - slack_m)
    tail_share = 1.0 / (excursion_m - slack_m - tail_slack_m)
    # Counted back from the last frame of the block.
    watched = np.arange(block_frames - 1, -1, -stride)[::-1]
    steps = [_responses(drive, block_frames) for drive in drives]
    unmoved_ohm = believed.resistance_ohm + drives[0].source_impedance_ohm
    rows = [volts / unmoved_ohm * np.eye(states)[LAST]]
    rows += [drive.i_row for drive in drives[:current_models]]
    currents = [(*step, row) for step, row in zip([steps[0], *steps], rows, strict=False)]
    tails = [_tail(drive, block_frames).T * tail_share for drive in drives]
    # Zeros where one model has fewer points than another.
    tail_points = max(tail.shape[1] for tail in tails)
    pairs = list(zip(drives, steps, strict=True))
    return {
        "models": len(drives),
        "states": states,
        "frames": block_frames,
        "watched": len(watched),
        "stride": stride,
        "tail_points": tail_points,
        "currents": len(currents),
        "excursion_by_drive": _padded([i @ drive.x_row * share for drive, (i, _) in pairs], LANES),
        "excursion_by_state": _padded(
            [(drive.x_row @ after[watched] * share).T for drive, (_, after) in pairs]
        ),
        "state_by_drive": _padded([impulse.T for impulse, _ in steps], LANES),
        "state_by_state": _padded([after[-1].T for _, after in steps]),
        "current_by_drive": _padded([impulse @ row for impulse, _, row in currents], LANES),
        "current_by_state": _padded([(row @ after).T for _, after, row in currents]),
        "tail_by_state": _padded(
            [np.pad(tail, ((0, 0), (0, tail_points - tail.shape[1]))) for tail in tails]
        ),
        "reach": _reachable(share * volts, [drive.reach("displacement_m") for drive in drives]),
        "swing": share / np.sqrt([drive.model.stiffness_n_per_m for drive in drives]),
        "swing_m": 1.0 / math.sqrt(believed.stiffness_n_per_m),
        "last_kick": np.array([drive.last_kick for drive in drives]),
        "ring": _reachable(share * volts, [drive.ring() for drive in drives]),
    }


def _padded(rows: Sequence[FloatArray], least: int = 0) -> FloatArray:
    """Return a table whose rows end in `least` zeros, and more until they fill whole groups."""
    table = np.array(rows)
    numbers = table.shape[-1]
    zeros = -(-(numbers + least) // LANES) * LANES - numbers
    return np.pad(table, [(0, 0)] * (table.ndim - 1) + [(0, zeros)])


def _reachable(factor: float, reaches: Sequence[float]) -> FloatArray:
    return np.minimum(factor * np.array(reaches), _UNREACHABLE)


def _responses(drive: DriveModel, count: int) -> tuple[FloatArray, FloatArray]:
    """Return the state after an impulse, last frame first, and the step's powers 1 to `count`."""
    powers = [np.eye(drive.states)]
    for _ in range(count):
        powers.append(drive.step @ powers[-1])
    impulse = np.array([power @ drive.drive for power in powers[:-1]])[::-1]
    return impulse, np.array(powers[1:])


def _slacks_m(drives: Sequence[DriveModel], limit_m: float, stride: int) -> tuple[float, float]:
    """Return by how much excursion may rise between computed frames of a block, and of the tail, m.

    Half a step from a computed frame that is at most half the acceleration times the time squared.
    The spring and the coil give the acceleration. Friction gives none in the tail, since the speed
    is 0 at the largest excursion. Later blocks compute the tail again at smaller steps, so that it
    needs both margins.
    """
    worst_m, tail_m = 0.0, 0.0
    for drive in drives:
        model, rate = drive.model, drive.samplerate
        spring = model.resonance_rad_s**2 * limit_m
        coil = model.force_factor_n_per_a * drive.volts / model.resistance_ohm
        coil /= model.moving_mass_kg
        within_s = stride / rate / 2.0
        tail_s = max(1.0 / rate, 1.0 / model.resonance_hz / _TAIL_POINTS) / 2.0
        braked = spring * (1.0 + 1.0 / model.q_total())
        worst_m = max(worst_m, (braked + coil) * within_s**2 / 2.0)
        tail_m = max(tail_m, (spring + coil) * tail_s**2 / 2.0)
    # This only happens at the lowest rates; half of the limit is left then.
    return min(worst_m, limit_m / 4.0), min(tail_m, limit_m / 4.0)


def _tail(drive: DriveModel, block_frames: int) -> FloatArray:
    """Return x over one period of a free swing in m, (points, states); later it is smaller.

    The coil's current and the last output act only at its start. An amplifier swings back for
    longer, but with a fifth of the effect. The distance of two points divides the length of a
    block: the next block computes the same points and gets the same values if nothing new came.
    """
    rate, hz = drive.samplerate, drive.model.resonance_hz
    wanted = max(1.0, rate / hz / _TAIL_POINTS)
    gap = max(d for d in range(1, block_frames + 1) if block_frames % d == 0 and d <= wanted)
    stride = np.linalg.matrix_power(drive.step, gap)
    rows = [drive.x_row]
    for _ in range(math.ceil(_TAIL_PERIODS * rate / hz / gap)):
        rows.append(rows[-1] @ stride)
    return np.array(rows)
