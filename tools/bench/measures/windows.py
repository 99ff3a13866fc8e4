"""What the core finds in single windows, read from the glides of its partials."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from audioflinger_hook.core.structures import GLIDE_COLUMNS
from audioflinger_hook.transform import FloatArray
from audioflinger_hook.transform.arrays import IntArray
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.haptic import CoreStream

MOST = 512
"""More than a window has principal frequencies."""
FAINT = 1e-12
"""A first sample with which the hops of a sound begin, however silent it is."""
UNFILTERED = np.array((1.0, 0.0))


@dataclass(frozen=True)
class Found:
    """Principal frequencies: parallel arrays, ascending in row and frequency.

    amplitude: of vibration, in full scale.
    """

    row: IntArray
    audio_hz: FloatArray
    amplitude: FloatArray

    def __len__(self) -> int:
        return self.row.size


class WindowAnalysis:
    """The core's analysis of band-passed windows.

    The windows become one sound, each at the end of a hop. The design of the core then has no
    band-pass, no onsets and no averages, so each glide of that hop ends at a peak of the window.

    design: of the live form, without merging.
    every: whether all with r > C_th count, instead of those that vibrate.
    """

    def __init__(self, design: LiveDesign, *, every: bool) -> None:
        analysis = replace(design.analysis, partials_max=MOST, side_lobe=0.0)
        self._design = replace(
            design,
            input=replace(design.input, band_b=UNFILTERED, band_a=UNFILTERED, silence=0.0),
            onsets=replace(design.onsets, find_onsets=0),
            tracking=replace(design.tracking, steady_gain=1.0),
            analysis=analysis if every else design.analysis,
        )

    def __call__(self, windows: FloatArray) -> Found:
        """Return what is found in windows (rows, N)."""
        grid = self._design.grid
        frames = grid.hops_in_window * grid.hop_frames
        sound = np.zeros((len(windows), frames))
        sound[:, frames - grid.window_frames :] = windows
        sound[:, 0] += FAINT
        stream = CoreStream(self._design, 1, each=False)
        stream.take_glides()
        stream.process(sound.reshape(-1, 1))
        columns = dict(zip(GLIDE_COLUMNS, stream.take_glides().T, strict=True))
        row = columns["frame"].astype(np.intp) // frames - 1
        chosen = (columns["frame"] == (row + 1) * frames) & (columns["end_amplitude"] > 0.0)
        hz = np.array([self._design.mapping.audio_hz(one) for one in columns["end_hz"][chosen]])
        order = np.lexsort((hz, row[chosen]))
        return Found(row[chosen][order], hz[order], columns["end_amplitude"][chosen][order])
