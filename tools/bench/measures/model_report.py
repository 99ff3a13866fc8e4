"""What each second of a run used: the models, their cost and the true error.

for second in report_seconds(actuator, volts, clock=time.thread_time, reference=finer):
    print(second.second, second.shares, second.cost_s, second.error)
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from device.rig.actuator import Motion
from device.rig.adaptive_actuator import AdaptiveActuator, BlockReport
from device.rig.model_levels import ModelLevel
from device.rig.model_selection import FLOOR
from device.rig.parameters import ActuatorParameters
from device.units import FloatArray

_COMPARED = ("displacement_m", "acceleration_m_s2")


@dataclass(frozen=True)
class SecondReport:
    """One second of a run; the last one may be shorter."""

    second: int  # from 0
    frames: int
    shares: dict[ModelLevel, float]  # of its time; the sum is 1
    excursion_peak_m: float  # at nodes
    estimate: float  # the largest predicted error of its blocks, as a share of the block's peak
    error: float | None  # the largest true error, None without a reference
    cost_s: float | None  # by the caller's clock, None without one


def report_seconds(
    actuator: AdaptiveActuator,
    volts: FloatArray,
    *,
    clock: Callable[[], float] | None = None,
    reference: AdaptiveActuator | None = None,
) -> list[SecondReport]:
    """Run an actuator from rest, one second at a time, and report each second.

    Parameters
    ----------
    actuator : AdaptiveActuator
        It is reset first.
    volts : FloatArray
        The drive, (frames,).
    clock : Callable[[], float] | None
        Read before and after each second, in s: the thread's CPU time, say.
    reference : AdaptiveActuator | None
        What counts as true, usually ModelLevel.NONLINEAR with finer nodes. It is reset first, and
        its time does not count.
    """
    actuator.reset()
    if reference:
        reference.reset()
    seconds = []
    length = max(1, round(actuator.samplerate))
    for second, first in enumerate(range(0, len(volts), length)):
        part = volts[first : first + length]
        settled = sum(actuator.frames_by_level.values())
        before_s = clock() if clock else 0.0
        motion = actuator.move(part)
        cost_s = clock() - before_s if clock else None
        new = [block for block in actuator.reports if block.frame >= settled]
        error = None
        if reference:
            errors = block_errors(new, first, motion, reference.move(part), actuator.rig.actuator)
            error = float(errors.max(initial=0.0))
        used = dict.fromkeys(ModelLevel, 0)
        for block in new:
            used[block.level] += block.frames
        reported = max(1, sum(used.values()))
        seconds.append(
            SecondReport(
                second,
                len(part),
                {level: share / reported for level, share in used.items()},
                max((block.excursion_peak_m for block in new), default=0.0),
                max((block.estimate for block in new), default=0.0),
                error,
                cost_s,
            )
        )
    return seconds


def block_errors(
    blocks: Sequence[BlockReport],
    start: int,
    motion: Motion,
    true: Motion,
    actuator: ActuatorParameters,
) -> FloatArray:
    """Return the true error of each block, (blocks,): the larger of excursion and acceleration.

    An error is the largest difference as a share of the block's true peak, or of the peak at 1 %
    of Xmax where the block moves less.

    Parameters
    ----------
    blocks : Sequence[BlockReport]
        The blocks to compare; only their frames inside the motions count.
    start : int
        The first frame of both motions.
    motion, true : Motion
        The computed and the true motion, with excursion and acceleration.
    actuator : ActuatorParameters
        For Xmax and the resonance.
    """
    floor_m = FLOOR * actuator.x_max_m
    floors = dict(zip(_COMPARED, (floor_m, floor_m * actuator.resonance_rad_s**2), strict=True))
    errors = np.zeros(len(blocks))
    for index, block in enumerate(blocks):
        part = slice(max(0, block.frame - start), block.frame + block.frames - start)
        for name, floor in floors.items():
            expected: FloatArray = getattr(true, name)[part]
            error = np.abs(getattr(motion, name)[part] - expected).max(initial=0.0)
            peak = max(float(np.abs(expected).max(initial=0.0)), floor)
            errors[index] = max(errors[index], float(error) / peak)
    return errors
