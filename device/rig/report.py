"""Second by second: which rung a run through the ladder used, what it cost, and its true error.

for second in by_seconds(Ladder(PAPER, 48_000), volts, clock=time.thread_time, dearest=true):
    print(second.second, second.shares, second.cost_s, second.error)
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from device.rig.actuator import Motion
from device.rig.block_report import BlockReport
from device.rig.error_estimate import FLOOR
from device.rig.ladder import Ladder
from device.rig.parameters import ActuatorParameters
from device.rig.rungs import Rung
from device.units import FloatArray

_COMPARED = ("displacement_m", "acceleration_m_s2")


@dataclass(frozen=True)
class SecondReport:
    """One second of a run, the last one maybe shorter.

    second: from 0 on; frames; shares: of its time by rung, together 1, 0 for rungs it did not use;
    excursion_peak_m: at nodes; estimate: the largest of its blocks' errors as the ladder foretold
    it; error: the largest true one, None without a dearest rung; both as shares of a block's peak.
    cost_s: by the caller's clock, None without one.
    """

    second: int
    frames: int
    shares: dict[Rung, float]
    excursion_peak_m: float
    estimate: float
    error: float | None
    cost_s: float | None


def by_seconds(
    ladder: Ladder,
    volts: FloatArray,
    *,
    clock: Callable[[], float] | None = None,
    dearest: Ladder | None = None,
) -> list[SecondReport]:
    """What each second of (frames,) volts takes a ladder, from rest.

    The ladder is moved a second at a time. clock: what is read before and after, in s: CPU time of
    the thread, say. dearest: what the truth is, as a rule a ladder with Rung.NONLINEAR and finer
    nodes; it is moved by the same volts, and its time does not count. Both are reset first.
    """
    ladder.reset()
    if dearest:
        dearest.reset()
    seconds = []
    length = max(1, round(ladder.samplerate))
    for second, first in enumerate(range(0, len(volts), length)):
        part = volts[first : first + length]
        settled = sum(ladder.frames_by_rung.values())
        before_s = clock() if clock else 0.0
        motion = ladder.move(part)
        cost_s = clock() - before_s if clock else None
        new = [block for block in ladder.reports if block.frame >= settled]
        error = None
        if dearest:
            true = dearest.move(part)
            errors = block_errors(new, first, motion, true, ladder.rig.actuator)
            error = float(errors.max(initial=0.0))
        seconds.append(_second(second, len(part), new, error, cost_s))
    return seconds


def block_errors(
    blocks: Sequence[BlockReport],
    start: int,
    motion: Motion,
    true: Motion,
    actuator: ActuatorParameters,
) -> FloatArray:
    """The true error of each block, (blocks,): the larger one of excursion and acceleration.

    motion, true: what was computed and what is true from frame `start` on, with both quantities;
    what they have of a block counts. An error is the largest difference over the block's true
    peak, or over that of a hundredth of Xmax where it moves less.
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


def _second(
    second: int,
    frames: int,
    blocks: Sequence[BlockReport],
    error: float | None,
    cost_s: float | None,
) -> SecondReport:
    used = dict.fromkeys(Rung, 0)
    for block in blocks:
        used[block.rung] += block.frames
    reported = max(1, sum(used.values()))
    return SecondReport(
        second,
        frames,
        {rung: share / reported for rung, share in used.items()},
        max((block.excursion_peak_m for block in blocks), default=0.0),
        max((block.estimate for block in blocks), default=0.0),
        error,
        cost_s,
    )
