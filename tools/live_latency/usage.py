"""What a running daemon uses of the machine: processor time and memory, from /proc."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

SHARE = 0.1
"""Of a run, what is taken together at its beginning and its end: memory moves in steps."""


class ProcessUse:
    """What one process used, by samples of it. Not for threads of the audio path.

    One thread calls `sample` again and again; the rest tells of what was sampled.
    """

    def __init__(self) -> None:
        self._samples: list[tuple[float, float, float]] = []
        self._process_id: int | None = None

    def sample(self, process_id: int, now_s: float) -> None:
        """Look at the process now; another one than before begins anew."""
        if process_id != self._process_id:
            self._process_id = process_id
            self._samples.clear()
        folder = Path(f"/proc/{process_id}")
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
            pages = int((folder / "statm").read_text().split()[1])
        except (OSError, IndexError, ValueError):  # it has ended
            return
        used_s = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        self._samples.append((now_s, used_s, pages * os.sysconf("SC_PAGE_SIZE") / 1_024))

    @property
    def cpu_percent(self) -> float | None:
        """Of one core, all threads together, from the first sample to the last."""
        if len(self._samples) < 2:
            return None
        (first_s, used_before_s, _), (last_s, used_s, _) = self._samples[0], self._samples[-1]
        return 100.0 * (used_s - used_before_s) / max(1e-9, last_s - first_s)

    @property
    def memory_growth_kb(self) -> float | None:
        """How much more it holds in memory in the last tenth of the samples than in the first."""
        if len(self._samples) < 2:
            return None
        held_kb = np.array([sample[2] for sample in self._samples])
        some = max(1, int(SHARE * len(held_kb)))
        return float(np.median(held_kb[-some:]) - np.median(held_kb[:some]))
