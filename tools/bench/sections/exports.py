"""Section on exports: how near what each format plays is to the vibration, on real sounds."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from tools.bench.report import Missing, Must, Row, Section
from tools.bench.sounds.real_sounds import SOUNDS_COMMAND, real_sounds
from tools.bench.sounds.signals import SAMPLERATE
from tools.bench.workbench import Workbench
from tools.exports.measures import Likeness
from tools.exports.renderers import RENDERERS
from tools.exports.round_trip import round_trip

TITLE = "Exports"
PROFILE = "cinema"
LONGEST_S = 10.0
ENVELOPE, ONSET_MS = 0.95, 5.0


def exports(bench: Workbench) -> Section:
    """Compare the envelopes and onsets of every parametric format with the vibration's."""
    sounds = real_sounds("report", bench.effort.exported)
    if not sounds:
        gone = Missing(f"every row of {TITLE}", "there are no sounds", SOUNDS_COMMAND)
        return Section(TITLE, "This could not be measured here.", (), (gone,))
    found: dict[str, list[Likeness]] = {name: [] for name in RENDERERS}
    with tempfile.TemporaryDirectory(prefix="cushion-bench-") as folder:
        for each in sounds:
            frames = each.sound[: round(LONGEST_S * SAMPLERATE), None].astype(np.float32)
            for name, alike in round_trip(frames, SAMPLERATE, PROFILE, Path(folder)).items():
                found[name].append(alike)
    return Section(
        TITLE,
        "Our renderer plays each file, and the result is compared with the vibration of "
        f"`{PROFILE}` that it was made from; the first {LONGEST_S:g} s of each sound. Envelope: "
        f"correlation over 50 ms. Onsets: share of clear ones that are within {ONSET_MS:g} ms.",
        tuple(row for name, alike in found.items() for row in _rows(name, alike)),
        footnote=f"Sounds: {len(sounds)}, fetched by {SOUNDS_COMMAND}.",
    )


def _rows(name: str, alike: list[Likeness]) -> list[Row]:
    envelopes = np.array([each.envelope for each in alike])
    late_ms = np.abs([ms for each in alike for ms in each.onset_errors_ms])
    rows = [
        Row("envelope, lowest", float(envelopes.min()), "", name, Must(">=", ENVELOPE)),
        Row("envelope, median", float(np.median(envelopes)), "", name, Must(">=", ENVELOPE)),
        Row(
            f"sounds of {ENVELOPE:g} or more", 100.0 * float(np.mean(envelopes >= ENVELOPE)), "%",
            name,
        ),
    ]  # fmt: skip
    if late_ms.size:
        share = 100.0 * float(np.mean(late_ms <= ONSET_MS))
        rows.append(Row("onsets in time", share, "%", name, Must(">=", 100.0)))
        rows.append(Row("onset, largest error", float(late_ms.max()), "ms", name))
    return rows
