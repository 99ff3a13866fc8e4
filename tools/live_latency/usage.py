"""CPU time and memory of running processes, from /proc."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

import numpy as np

Use = TypeVar("Use")

SHARE = 0.1  # share of the samples at the start, and at the end, whose median is compared


class ProcessUse:
    """CPU time and memory of one process, computed from the samples that `sample` takes."""

    def __init__(self) -> None:
        self._samples: list[tuple[float, float, float]] = []
        self._process_id: int | None = None

    def sample(self, process_id: int, now_s: float) -> None:
        """Take a sample. Earlier samples of another process are deleted."""
        if process_id != self._process_id:
            self._process_id = process_id
            self._samples.clear()
        folder = Path(f"/proc/{process_id}")
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
            pages = int((folder / "statm").read_text().split()[1])
        except (OSError, IndexError, ValueError):  # the process has ended
            return
        used_s = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        self._samples.append((now_s, used_s, pages * os.sysconf("SC_PAGE_SIZE") / 1_024))

    @property
    def cpu_percent(self) -> float | None:
        """CPU time of all threads in % of one core, from the first to the last sample."""
        if len(self._samples) < 2:
            return None
        (first_s, used_before_s, _), (last_s, used_s, _) = self._samples[0], self._samples[-1]
        return 100.0 * (used_s - used_before_s) / max(1e-9, last_s - first_s)

    @property
    def memory_growth_kb(self) -> float | None:
        """Median memory of the last tenth of the samples minus that of the first tenth, in kB."""
        if len(self._samples) < 2:
            return None
        held_kb = np.array([sample[2] for sample in self._samples])
        some = max(1, int(SHARE * len(held_kb)))
        return float(np.median(held_kb[-some:]) - np.median(held_kb[:some]))


def held_by_family(process_id: int) -> dict[int, tuple[str, float]]:
    """Return name and memory in MB of a process and each of its children, by process ID.

    Memory that several processes share is divided among them (PSS). Memory mapped from files of
    Python counts in full, because other Python programs would otherwise reduce the result.
    """
    return _of_family(process_id, lambda one: (_name(one), _held_mb(one)))


def used_by_family(process_id: int) -> dict[int, float]:
    """Return the CPU time in s of a process and each of its children, by process ID."""
    return _of_family(process_id, _used_s)


def _of_family(process_id: int, measure: Callable[[int], Use]) -> dict[int, Use]:
    children = [
        int(child)
        for thread in Path(f"/proc/{process_id}/task").iterdir()
        for child in (thread / "children").read_text().split()
    ]
    found: dict[int, Use] = {}
    for one in (process_id, *children):
        with suppress(FileNotFoundError, ProcessLookupError):  # a child has ended
            found[one] = measure(one)
    return found


def _used_s(process_id: int) -> float:
    threads = Path(f"/proc/{process_id}/task").iterdir()
    return sum(1e-9 * int((one / "schedstat").read_text().split()[0]) for one in threads)


def _name(process_id: int) -> str:
    return Path(f"/proc/{process_id}/comm").read_text().strip()


def _held_mb(process_id: int) -> float:
    held_kb, counts = 0, "Pss:"
    for line in Path(f"/proc/{process_id}/smaps").read_text().splitlines():
        key, _, rest = line.partition(" ")
        if "-" in key and not key.endswith(":"):  # the first line of a mapping
            counts = "Rss:" if "python" in rest else "Pss:"
        elif key == counts:
            held_kb += int(rest.split()[0])
    return held_kb * 1_024 / 1e6
