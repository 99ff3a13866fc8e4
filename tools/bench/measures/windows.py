"""Principal frequencies that the native core finds in single windows of a signal."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from audioflinger_hook.core.structures import GLIDE_COLUMNS
from audioflinger_hook.transform import FloatArray
from audioflinger_hook.transform.arrays import IntArray
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.haptic import CoreStream

MOST = 512  # more than the number of principal frequencies of any window
FAINT = 1e-12  # added to each window's first sample, so that even a silent sound starts hops
UNFILTERED = np.array((1.0, 0.0))


@dataclass(frozen=True)
class Found:
    """Principal frequencies (prominent peaks of a spectrum) of several windows.

    The arrays have equal length and are sorted by window and frequency.

    row: index of the window.
    audio_hz: frequency in the sound.
    amplitude: amplitude of the vibration relative to full scale.
    """

    row: IntArray
    audio_hz: FloatArray
    amplitude: FloatArray

    def __len__(self) -> int:
        return self.row.size


class WindowAnalysis:
    """Analyses single windows of band-passed sound with the native core.

    The windows are joined to one sound, in which a hop ends at the end of each window. The core's
    band-pass, onset detection and averaging are switched off. At the end of each window, the
    frequencies of the vibration thus belong to peaks of this window.

    design: design of the live form; this design must not merge partials.
    every: whether to return all principal frequencies, or only those that cause vibration.
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
        """Return the principal frequencies of `windows`, (windows, frames)."""
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
