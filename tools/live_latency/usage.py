"""What a running daemon uses of the machine: processor time and memory, from /proc."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

import numpy as np

Use = TypeVar("Use")

SHARE = 0.1
"""Of a run, what is taken together at its beginning and its end: memory moves in steps."""


class ProcessUse:
    """What one process used, by samples of it. Not for threads of the audio path.

    One thread calls `sample` again and again; the attributes sum the samples up.
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


def held_by_family(process_id: int) -> dict[int, tuple[str, float]]:
    """Return name and memory in MB of a process and of each of its children, by number.

    A page that processes share counts by its share (PSS). But files of Python count whole: another
    program of Python, such as the one that measures, must not make them smaller.
    """
    return _of_family(process_id, lambda one: (_name(one), _held_mb(one)))


def used_by_family(process_id: int) -> dict[int, float]:
    """Return the seconds of a core that a process and each of its children have used so far."""
    return _of_family(process_id, _used_s)


def _of_family(process_id: int, measure: Callable[[int], Use]) -> dict[int, Use]:
    children = [
        int(child)
        for thread in Path(f"/proc/{process_id}/task").iterdir()
        for child in (thread / "children").read_text().split()
    ]
    found: dict[int, Use] = {}
    for one in (process_id, *children):
        with suppress(FileNotFoundError, ProcessLookupError):  # one that has ended
            found[one] = measure(one)
    return found


def _used_s(process_id: int) -> float:
    """Return what the scheduler counts, in nanoseconds, of all threads."""
    threads = Path(f"/proc/{process_id}/task").iterdir()
    return sum(1e-9 * int((one / "schedstat").read_text().split()[0]) for one in threads)


def _name(process_id: int) -> str:
    return Path(f"/proc/{process_id}/comm").read_text().strip()


def _held_mb(process_id: int) -> float:
    held_kb, counts = 0, "Pss:"
    for line in Path(f"/proc/{process_id}/smaps").read_text().splitlines():
        key, _, rest = line.partition(" ")
        if "-" in key and not key.endswith(":"):  # the first line of a mapping ends in its file
            counts = "Rss:" if "python" in rest else "Pss:"
        elif key == counts:
            held_kb += int(rest.split()[0])
    return held_kb * 1_024 / 1e6
