"""Generates the tables in docs/results.md and docs/exports.md from docs/benchmarks.md."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BENCHMARKS = ROOT / "docs/benchmarks.md"
PROFILES = ("cinema", "game", "music", "paper")
METHODS = ("constant", "band-pass", "envelope", "centroid", "octave fold")
FREQUENCIES = "Principal frequencies"

DELAY = (
    ("on PipeWire, native engine", "Live latency", r"PipeWire [\d.]+, native, quantum 256"),
    ("on PipeWire, Python engine", "Live latency", r"PipeWire [\d.]+, 512 frames"),
    ("on PulseAudio, Python engine", "Live latency", r"PulseAudio [\d.]+, 512 frames"),
)
ACCURACY = (
    ("onset lag of tone bursts, mean", "Onset lag", "lag, mean"),
    ("onset lag, 95th percentile", "Onset lag", "lag, 95th percentile"),
    ("frequency of a steady tone, worst error", "Steady tones", "worst frequency error, 150 .*"),
    ("level of a steady tone, worst error", "Steady tones", "worst level error, 150 .*"),
    ("distortion and noise of a steady tone, worst", "Steady tones", r"worst THD\+N, 150 .*"),
    ("energy above 250 Hz, worst recording", "Energy above 250 Hz", "worst recording"),
    ("principal frequencies that the reference form finds too", FREQUENCIES, "precision, all .*"),
    ("the reference form's principal frequencies that are found", FREQUENCIES, "recall, all .*"),
)
QUALITY = (
    ("explosions over dialogue", "film: explosions over dialogue"),
    ("a quiet scene under the action", "film: quiet scene under action"),
    ("explosions that stand out", "film: explosions that stand out"),
    ("hiss relative to speech", "film: hiss against speech"),
    ("the first word after the hiss too strong by", "film: next word too strong by"),
    ("impacts over music that raise the level by 1.5 dB", "impacts over music that add 1.5 dB"),
    ("single sounds with a match under 70", "match under 70"),
    ("six classes told apart", "6 classes told apart"),
    ("sounds without vibration", "sounds not felt at all"),
    ("drums: delay of half of the peak, 95 %", "drums: half of the peak, 95th percentile"),
    ("drums: vibration's peak off the sound's, median", "drums: peak off the sound's, median"),
    ("steady chord: modulation at 4 to 16 Hz", "steady A-major chord: modulation at 4 to 16 Hz"),
)
EXPORTS = (
    ("lowest r", "envelope, lowest"),
    ("median r", "envelope, median"),
    ("sounds with r of 0.95 or more", "sounds of 0.95 or more"),
    ("onsets", "onsets in time"),
    ("largest error of an onset", "onset, largest error"),
)
FORMATS = ("partials", "vibration-xml", "hjif", "ahap", "haptic")


def results_tables() -> str:
    """Return tables of the main results, and a list of the limits that are not met."""
    page = BENCHMARKS.read_text()
    failed = re.findall(r"^  - not met: (.*)$", page, re.MULTILINE)
    parts = [
        *("## Delay and CPU", _delay(page)),
        "![Share of bursts that vibrate by a time](images/lag.png)",
        *("## Accuracy", _accuracy(page)),
        *("## Quality on real sounds, against other methods", _quality(page)),
        "![A film heard and felt; a drum, a swell and a chord, by profile](images/real_sounds.png)",
        "![CPU time of a second of each scene](images/cost.png)",
        *("## Limits that are not met", "\n".join(f"- {line}" for line in failed)),
    ]
    return "\n\n".join(parts) + "\n"


def exports_table() -> str:
    """Return a table of the accuracy of each parametric format."""
    page = BENCHMARKS.read_text()
    rows = [
        [f"`{name}`", *(figure(page, "Exports", row, name) for _, row in EXPORTS)]
        for name in FORMATS
    ]
    return _table(("format", *(shown for shown, _ in EXPORTS)), rows) + "\n"


def figure(page: str, section: str, row: str, column: str) -> str:
    """Return a cell of a table in `page`.

    row: regular expression for the name of the row.

    LookupError: there is no such cell.
    """
    body = page.partition(f"\n## {section}\n")[2].partition("\n## ")[0]
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in body.splitlines()]
    tables = [cells for cells in lines if cells]
    head: list[str] = []
    for place, cells in enumerate(tables):
        if place + 1 < len(tables) and set(tables[place + 1][0]) == {"-"}:
            head = cells
        elif head and re.fullmatch(row, cells[0]) and column in head:
            return cells[head.index(column)]
    raise LookupError(f"docs/benchmarks.md has no {row!r}, {column!r} in {section!r}")


def _table(head: tuple[str, ...], rows: list[list[str]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _delay(page: str) -> str:
    rows = []
    for shown, section, row in DELAY:
        native = "native engine" in shown
        cpu = figure(page, section, row, "CPU of the native engine" if native else "CPU")
        rows.append([shown, figure(page, section, row, "lag"), cpu])
    return _table(("profile `cinema`", "delay of the vibration", "CPU"), rows)


def _accuracy(page: str) -> str:
    return _table(
        ("live form, profile `paper`", "measured"),
        [[shown, figure(page, section, row, "live")] for shown, section, row in ACCURACY],
    )


def _quality(page: str) -> str:
    columns = ("sound", *PROFILES, *METHODS)
    rows = [
        [shown, *(figure(page, "On real sounds", re.escape(row), name) for name in columns)]
        for shown, row in QUALITY
    ]
    return _table(("", *columns), rows)
