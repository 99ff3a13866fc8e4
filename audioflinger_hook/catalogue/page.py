"""The report of a run as one HTML page: a picture of the vibration for each item."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

from audioflinger_hook.catalogue.summary import Summary, strangeness
from audioflinger_hook.catalogue.work import Outcome
from device.atomic_file import AtomicFile

PICTURES_MAX = 5_000
"""Items with a picture; a browser shows no more with ease. Strange and failed ones come always."""

WIDTH, HEIGHT = 240, 48

_HEAD = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>Vibration catalogue</title>
<meta name="viewport" content="width=device-width">
<style>
:root { color-scheme: light dark; --line: #88888855; --wave: #2a6fb0; --bad: #c0392b; }
body { font: 15px/1.4 system-ui, sans-serif; margin: 1.5em; }
h1 { font-size: 1.3em } h2 { font-size: 1.1em }
.items { display: grid; grid-template-columns: repeat(auto-fill, minmax(250px, 1fr)); gap: .7em }
figure { margin: 0; padding: .4em; border: 1px solid var(--line); border-radius: 4px }
figcaption { overflow-wrap: anywhere } small { display: block; opacity: .75 }
svg { width: 100%; height: 48px; display: block } path { fill: var(--wave) }
.strange { border-color: var(--bad) } .strange b, .failed b { color: var(--bad) }
</style>
"""


class Page:
    """Collects pictures while a run goes on; memory does not grow. A context manager."""

    def __init__(self) -> None:
        self._ordinary: IO[bytes] = TemporaryFile()  # noqa: SIM115
        self._strange: IO[bytes] = TemporaryFile()  # noqa: SIM115
        self._pictures = 0
        self._left_out = 0

    def add(self, outcome: Outcome) -> None:
        """Add the picture of an item."""
        _, reason = strangeness(outcome.record)
        if reason or outcome.state == "failed":
            self._strange.write(_figure(outcome, reason).encode("utf-8", "replace"))
        elif self._pictures < PICTURES_MAX:
            self._pictures += 1
            self._ordinary.write(_figure(outcome, "").encode("utf-8", "replace"))
        else:
            self._left_out += 1

    def write(self, folder: Path, summary: Summary) -> Path:
        """Write the page to index.html in a folder, which is made if needed; return its path."""
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

    def __enter__(self) -> Page:
        return self

    def __exit__(self, *_error: object) -> None:
        self._ordinary.close()
        self._strange.close()


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
    figures += [f"A(8) {_exposure(record)}"]
    kind = ' class="strange"' if reason else ""
    return (
        f"<figure{kind}>{_picture(record.get('course') or [])}<figcaption>{name}"
        f"<small>{said}{', '.join(figures)}</small></figcaption></figure>\n"
    )


def _exposure(record: dict[str, Any]) -> str:
    value = record.get("exposure_a8_m_s2")
    return "unknown" if value is None else f"{value:.2g} m/s²"


def _picture(course: Sequence[int]) -> str:
    """Return the peaks over time as SVG, mirrored about the middle; full scale fills the height."""
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
