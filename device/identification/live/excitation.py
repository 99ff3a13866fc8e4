"""What is played in one measurement: a mark, the sweep between its silences, the mark again.

The same mark before and after makes the two clocks comparable whatever the rig does to it: the
rig does the same to both.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from device.identification.sweep import Sweep
from device.units import FloatArray

MARK_S, GAP_S, REST_S = 0.25, 0.4, 0.2
"""Of a mark, of the silence behind the first one, and behind the last one."""


@dataclass(frozen=True)
class Excitation:
    """The samples of one measurement around `sweep`; full scale is 1.0."""

    sweep: Sweep

    @property
    def mark_frames(self) -> int:
        """Length of a mark."""
        return round(MARK_S * self.sweep.samplerate)

    @property
    def sweep_start(self) -> int:
        """The frame at which the sweep's first silence begins."""
        return self.mark_frames + round(GAP_S * self.sweep.samplerate)

    @property
    def second_mark(self) -> int:
        """The frame at which the second mark begins; the first one begins at 0."""
        return self.sweep_start + self.sweep.frames

    @property
    def frames(self) -> int:
        """Frames of all of it."""
        rest = round(REST_S * self.sweep.samplerate)
        return self.second_mark + self.mark_frames + rest

    @cached_property
    def samples(self) -> FloatArray:
        """(frames,) between ±level of the sweep; read only."""
        sweep = self.sweep
        whole = np.zeros(self.frames)
        time_s = np.arange(self.mark_frames) / sweep.samplerate
        rise_s = MARK_S / math.log(sweep.high_hz / sweep.low_hz)
        wave = np.sin(math.tau * sweep.low_hz * rise_s * np.expm1(time_s / rise_s))
        wave *= sweep.level * np.hanning(len(wave)) ** 0.25
        whole[: len(wave)] = wave
        whole[self.sweep_start : self.second_mark] = sweep.samples()
        whole[self.second_mark : self.second_mark + len(wave)] = wave
        whole.setflags(write=False)
        return whole
