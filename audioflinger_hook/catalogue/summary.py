"""The summary of a run: counts, the slowest and the strangest items, and the failed ones."""

from __future__ import annotations

import heapq
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from shutil import copyfile
from tempfile import NamedTemporaryFile
from typing import Any

from audioflinger_hook.catalogue.storage import Storage
from audioflinger_hook.catalogue.work import Outcome
from device.values import counted

LISTED = 10
"""Slowest and strangest items that are listed."""

STRANGE_LEAK_DB = -30.0
"""Energy above 250 Hz that even white noise does not reach."""

Ranked = tuple[float, int, str, str]
"""An item of a heap: rank, -count, the item's id, text."""


@dataclass
class Summary:
    """The result of a run so far; its size does not grow with the number of items.

    sound_s, worker_s: length of the rendered sounds, and the time of workers for them.
    exit_code: of the worst failure. slowest, strangest: heaps.
    """

    items: int = 0
    rendered: int = 0
    skipped: int = 0
    failed: int = 0
    sound_s: float = 0.0
    worker_s: float = 0.0
    exit_code: int = 0
    slowest: list[Ranked] = field(default_factory=list)
    strangest: list[Ranked] = field(default_factory=list)

    def add(self, outcome: Outcome) -> None:
        """Count an outcome."""
        self.items += 1
        setattr(self, outcome.state, getattr(self, outcome.state) + 1)
        self.exit_code = max(self.exit_code, outcome.exit_code)
        if outcome.state == "rendered":
            self.sound_s += outcome.record["frames"] / outcome.record["samplerate"]
            self.worker_s += outcome.seconds
            self._keep(self.slowest, outcome.seconds, outcome, f"{outcome.seconds:.2f} s")
        rank, reason = strangeness(outcome.record)
        if reason:
            self._keep(self.strangest, rank, outcome, reason)

    def document(self) -> dict[str, Any]:
        """Return the summary as a JSON document."""
        counts = ("items", "rendered", "skipped", "failed")
        return {
            **{name: getattr(self, name) for name in counts},
            "sound_s": round(self.sound_s, 3),
            "worker_s": round(self.worker_s, 3),
            "slowest": [
                {"id": name, "seconds": rank} for rank, _, name, _ in _descending(self.slowest)
            ],
            "strangest": [
                {"id": name, "reason": text} for *_, name, text in _descending(self.strangest)
            ],
        }

    def lines(self) -> list[str]:
        """Return the summary for people, line by line."""
        speed = self.sound_s / self.worker_s if self.worker_s else 0.0
        found = [
            f"{counted(self.items, 'items')}: {self.rendered} rendered "
            f"({self.sound_s / 3600.0:.2f} h of sound, {speed:.0f} x real time a worker), "
            f"{self.skipped} skipped, {self.failed} failed"
        ]
        for title, kept in (("slowest", self.slowest), ("strangest", self.strangest)):
            if kept:
                listed = ", ".join(f"{name} ({text})" for *_, name, text in _descending(kept)[:5])
                found.append(f"{title}: {listed}")
        return found

    def _keep(self, heap: list[Ranked], rank: float, outcome: Outcome, text: str) -> None:
        # Of equal ranks the first item counts more; -items makes entries different.
        entry = (rank, -self.items, outcome.item.id, text)
        if len(heap) < LISTED:
            heapq.heappush(heap, entry)
        else:
            heapq.heappushpop(heap, entry)


def strangeness(record: Mapping[str, Any]) -> tuple[float, str]:
    """Return how strange a result is, and why; the text is empty for an ordinary one."""
    if not record:
        return 0.0, ""
    if not record["peak"]:
        return 3.0, "silence"
    limited = record.get("limited_samples") or 0
    if limited:
        return 2.0 + limited / max(1, record["frames"]), f"{limited} samples clipped"
    leak_db = record.get("leak_above_250_hz_db")
    if leak_db is not None and leak_db > STRANGE_LEAK_DB:
        return 1.0 + leak_db / 1e3, f"{leak_db:.0f} dB above 250 Hz"
    return 0.0, ""


def _descending(heap: list[Ranked]) -> list[Ranked]:
    return sorted(heap, reverse=True)


class Failures:
    """The failed items as lines of a manifest, in a temporary file; a context manager."""

    def __init__(self) -> None:
        self._file = NamedTemporaryFile("w", encoding="ascii", prefix="cushion-")  # noqa: SIM115
        self.count = 0

    def add(self, outcome: Outcome) -> None:
        """Add an item that failed."""
        row = {**outcome.item.row(), "error": outcome.error, "exit_code": outcome.exit_code}
        self._file.write(json.dumps(row) + "\n")
        self.count += 1

    def save(self, storage: Storage, name: str) -> None:
        """Write the manifest, or delete that of an earlier run if no item has failed."""
        if not self.count:
            storage.delete(name)
            return
        self._file.flush()
        storage.put(name, lambda path: copyfile(self._file.name, path))

    def __enter__(self) -> Failures:
        return self

    def __exit__(self, *_error: object) -> None:
        self._file.close()
