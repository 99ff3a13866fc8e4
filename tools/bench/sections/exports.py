"""Section "Exports": how well the exported files of each format reproduce the vibration."""

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
    """Measure how well models of players reproduce the vibration from exported files."""
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
        "A model of a player converts each exported file to vibration. This vibration is compared "
        f"with the vibration of the profile `{PROFILE}`, for the first {LONGEST_S:g} s of each "
        "sound. Rows with *envelope* show the correlation of the envelopes of both vibrations, "
        "which are smoothed with a window of 50 ms. The row *onsets in time* shows the share of "
        f"clear onsets that are shifted by at most {ONSET_MS:g} ms. A clear onset is a steep rise "
        "of the envelope from a low level.",
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
