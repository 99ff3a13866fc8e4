"""The report of a run: counts; slowest, unusual and failed items; a page of pictures."""

import heapq
import json
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from pathlib import Path
from shutil import copyfileobj
from tempfile import TemporaryFile
from typing import IO, Any

from audioflinger_hook.catalogue.storage import Storage
from audioflinger_hook.catalogue.work import Outcome
from device.atomic_file import AtomicFile
from device.values import counted

LISTED = 10  # largest number of entries in each of the lists of slowest and of unusual items
STRANGE_LEAK_DB = -30.0  # more energy above 250 Hz is unusual; in dB relative to the total
PICTURES_MAX = 5_000  # largest number of pictures of normal results on the page
WIDTH, HEIGHT = 240, 48

_HEAD = files("audioflinger_hook.catalogue").joinpath("page_head.html").read_text(encoding="utf-8")

Ranked = tuple[float, int, str, str]  # entry of a heap: rank, -count, the item's id, text


@dataclass
class Summary:
    """The totals of a run. Its memory does not grow with the number of items.

    sound_s: duration of all rendered sounds in s. worker_s: sum of their rendering times in s.
    exit_code: largest exit code of the failed items, or 0.
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
        """Add an outcome to the totals."""
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
        return {
            **{name: getattr(self, name) for name in ("items", "rendered", "skipped", "failed")},
            "sound_s": round(self.sound_s, 3),
            "worker_s": round(self.worker_s, 3),
            "slowest": [{"id": one[2], "seconds": one[0]} for one in _descending(self.slowest)],
            "strangest": [{"id": one[2], "reason": one[3]} for one in _descending(self.strangest)],
        }

    def lines(self) -> list[str]:
        """Return the summary as lines of text."""
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
        # The number -items orders entries of equal rank, so that the earlier item is kept.
        heapq.heappush(heap, (rank, -self.items, outcome.item.id, text))
        if len(heap) > LISTED:
            heapq.heappop(heap)


def strangeness(record: Mapping[str, Any]) -> tuple[float, str]:
    """Return a score of how unusual a result is, and why; 0 and "" if it is normal."""
    if not record:
        return 0.0, ""
    if not record["peak"]:
        return 3.0, "silence"
    if limited := record.get("limited_samples") or 0:
        return 2.0 + limited / max(1, record["frames"]), f"{limited} samples clipped"
    leak_db = record.get("leak_above_250_hz_db")
    if leak_db is not None and leak_db > STRANGE_LEAK_DB:
        return 1.0 + leak_db / 1e3, f"{leak_db:.0f} dB above 250 Hz"
    return 0.0, ""


def _descending(heap: list[Ranked]) -> list[Ranked]:
    return sorted(heap, reverse=True)


class Failures(ExitStack):
    """Collects the failed items as a manifest, in a temporary file. A context manager."""

    def __init__(self) -> None:
        super().__init__()
        self._file: IO[bytes] = self.enter_context(TemporaryFile())  # noqa: SIM115

    def add(self, outcome: Outcome) -> None:
        """Add an item that failed."""
        row = {**outcome.item.row(), "error": outcome.error, "exit_code": outcome.exit_code}
        self._file.write(json.dumps(row).encode() + b"\n")

    def save(self, storage: Storage, name: str) -> None:
        """Store the manifest as `name`. If no item failed, delete an earlier run's manifest."""
        if not self._file.tell():
            storage.delete(name)
            return

        def copy(path: Path) -> None:
            self._file.seek(0)
            with path.open("wb") as file:
                copyfileobj(self._file, file)

        storage.put(name, copy)


class Page(ExitStack):
    """Collects the pictures of a run in temporary files. A context manager."""

    def __init__(self) -> None:
        super().__init__()
        self._ordinary: IO[bytes] = self.enter_context(TemporaryFile())  # noqa: SIM115
        self._strange: IO[bytes] = self.enter_context(TemporaryFile())  # noqa: SIM115
        self._pictures = self._left_out = 0

    def add(self, outcome: Outcome) -> None:
        """Add the picture of an item; only the first PICTURES_MAX normal results get one."""
        _, reason = strangeness(outcome.record)
        if reason or outcome.state == "failed":
            self._strange.write(_figure(outcome, reason).encode("utf-8", "replace"))
        elif self._pictures < PICTURES_MAX:
            self._pictures += 1
            self._ordinary.write(_figure(outcome, "").encode("utf-8", "replace"))
        else:
            self._left_out += 1

    def write(self, folder: Path, summary: Summary) -> Path:
        """Write index.html to the folder, which is created if missing; return the file's path."""
        folder.mkdir(exist_ok=True)
        path = folder / "index.html"
        with AtomicFile(path) as file:
            text = "".join(f"<p>{escape(line)}</p>\n" for line in summary.lines())
            file.write(f"{_HEAD}<h1>Vibration catalogue</h1>\n{text}".encode("utf-8", "replace"))
            for title, part in (("To look at", self._strange), ("All others", self._ordinary)):
                if not part.tell():
                    continue
                file.write(f'<h2>{title}</h2>\n<div class="items">\n'.encode())
                part.seek(0)
                while piece := part.read(1 << 20):
                    file.write(piece)
                file.write(b"</div>\n")
            if self._left_out:
                file.write(f"<p>{self._left_out} more items have no picture here.</p>\n".encode())
        return path


def _figure(outcome: Outcome, reason: str) -> str:
    name = escape(outcome.item.id)
    if outcome.state == "failed":
        return (
            f'<figure class="failed"><figcaption>{name}<small><b>failed</b>: '
            f"{escape(outcome.error)}</small></figcaption></figure>\n"
        )
    record = outcome.record
    length_s = record["frames"] / record["samplerate"]
    said = f"<b>{escape(reason)}</b>, " if reason else ""
    leak = record.get("leak_above_250_hz_db")
    figures = [f"{length_s:.1f} s", f"peak {record['peak']:.3f}"]
    figures += [f"leak {leak:.0f} dB"] if leak is not None else []
    exposure = record.get("exposure_a8_m_s2")
    figures += ["A(8) " + ("unknown" if exposure is None else f"{exposure:.2g} m/s²")]
    kind = ' class="strange"' if reason else ""
    return (
        f"<figure{kind}>{_picture(record.get('course') or [])}<figcaption>{name}"
        f"<small>{said}{', '.join(figures)}</small></figcaption></figure>\n"
    )


def _picture(course: Sequence[int]) -> str:
    """Return peaks over time as an SVG picture that is symmetric about a middle line."""
    middle = HEIGHT / 2
    step = WIDTH / max(1, len(course))
    bars = "".join(
        f"M{index * step:.1f} {middle - high:.1f}h{step:.1f}v{2 * high:.1f}h-{step:.1f}z"
        for index, peak in enumerate(course)
        if (high := middle * min(1.0, peak / 1e3)) > 0.0
    )
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" preserveAspectRatio="none"><path d="{bars}"/></svg>'
    )
