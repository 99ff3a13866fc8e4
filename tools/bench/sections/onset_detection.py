"""Section on onsets: how many are detected, how soon, and how many are false.

It measures the detector by which the live form begins partials, tick by tick. Nobody has marked
the onsets of the recordings, so known ones are planted in them.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import gcd

import numpy as np
from scipy.signal import resample_poly

from audioflinger_hook.transform import FloatArray, TransformParameters
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.live.transform import LiveTransform
from tools.bench.report import Must, Row, Section
from tools.bench.sounds.onsets import (
    LEVELS_DB,
    PLANTED_DB,
    SPACING_S,
    STEADY_S,
    onset_train,
    planted,
    steady_sounds,
)
from tools.bench.sounds.signals import SAMPLERATE, demo_sound
from tools.bench.workbench import Workbench

REACH_S = 0.024
"""An onset is found if one is detected within this time of it."""
F1 = Must(">=", 0.95)
LONGEST_S = 3.0
"""Of a recording."""
STEADY_FROM_S = 0.1
"""The start of a steady sound is an onset; later ones are false."""


@dataclass(frozen=True)
class Found:
    """Counts of onsets: there, detected, and both; and the delay of each of these, s."""

    there: int
    detected: int
    hits: int
    late_s: tuple[float, ...]

    @property
    def precision(self) -> float:
        """Share of the detected ones that were there."""
        return self.hits / self.detected if self.detected else float("nan")

    @property
    def recall(self) -> float:
        """Share of those there that were detected."""
        return self.hits / self.there if self.there else float("nan")

    @property
    def f1(self) -> float:
        """The harmonic mean of both."""
        return 2.0 * self.hits / max(1, self.there + self.detected)

    def __add__(self, other: Found) -> Found:
        return Found(
            self.there + other.there,
            self.detected + other.detected,
            self.hits + other.hits,
            self.late_s + other.late_s,
        )


def onset_times_s(sound: FloatArray) -> FloatArray:
    """Return when onsets are detected in a sound (frames,) at 48 kHz, in seconds."""
    form = LiveTransform(LiveDesign.of(TransformParameters(), SAMPLERATE))
    onsets, detector = form.design.onsets, form._detector
    tick_frames, rest_ticks = form.design.grid.tick_frames, onsets.rest_ticks
    filtered = form._bandpass.process(sound)
    ticks = filtered.size // tick_frames
    past = onsets.short_frames - tick_frames
    joined = np.concatenate((np.zeros(past), filtered[: ticks * tick_frames]))
    windows = np.lib.stride_tricks.sliding_window_view(joined, onsets.short_frames)
    seen = detector.measure(
        windows[::tick_frames], filtered[: ticks * tick_frames].reshape(ticks, -1)
    )
    heard = [tick + 1 for tick in range(ticks) if detector.detect(seen, tick)]
    # A second detection within the rest is of the same onset.
    kept = [tick for tick, last in zip(heard, [-rest_ticks, *heard], strict=False)
            if tick - last >= rest_ticks]  # fmt: skip
    return np.array(kept, dtype=np.float64) * (tick_frames / SAMPLERATE)


def found(sound: FloatArray, onsets_s: FloatArray) -> Found:
    """Return how the detected onsets match the known ones; each counts once."""
    detected = onset_times_s(sound)
    free = np.ones(detected.size, dtype=bool)
    late = []
    for onset_s in onsets_s.tolist():
        away = np.where(free, np.abs(detected - onset_s), np.inf)
        if away.size and away.min() <= REACH_S:
            nearest = int(away.argmin())
            free[nearest] = False
            late.append(float(detected[nearest]) - onset_s)
    return Found(onsets_s.size, detected.size, len(late), tuple(late))


def onsets_found(bench: Workbench) -> Section:
    """Precision and recall of onsets, made and planted, and false detections."""
    made = found(*onset_train(bench.effort.onsets_made, seed=1))
    rows = [
        Row("made: F1", made.f1, must=F1),
        Row("made: precision", made.precision),
        Row("made: recall", made.recall),
        *_latency_rows("made", made),
    ]
    hidden = found(*planted(demo_sound().astype(np.float64).mean(axis=1), seed=2))
    recordings = bench.recordings[: bench.effort.compared_recordings]
    for item in recordings:
        mono = item.frames.astype(np.float64).mean(axis=1)
        hidden += found(*planted(_at_48_khz(mono, item.samplerate), 4))
    note = f"{hidden.there} onsets, {1 + len(recordings)} sounds"
    rows.append(Row("planted: recall", hidden.recall, must=F1, note=note))
    rows += _latency_rows("planted", hidden)
    for name, sound in steady_sounds().items():
        false = float((onset_times_s(sound) > STEADY_FROM_S).sum()) / STEADY_S
        rows.append(Row(f"false onsets: {name}", false, "a second"))
    return Section(
        "Onsets found",
        f"An onset must be detected within {1e3 * REACH_S:g} ms. Made: {bench.effort.onsets_made} "
        f"tones, clicks and bursts of noise of {LEVELS_DB[0]:g} to {LEVELS_DB[1]:g} dBFS, "
        f"{1e3 * SPACING_S[0]:g} ms to {SPACING_S[1]:g} s apart. Planted: the same, "
        f"{PLANTED_DB:g} dB over the demo scene and recordings. Their own onsets are not marked, "
        "so only recall is known. A false onset in a steady sound begins partials only where some "
        "are missing.",
        tuple(rows),
    )


def _latency_rows(name: str, of: Found) -> list[Row]:
    late_ms = 1e3 * np.array(of.late_s)
    return [
        Row(f"{name}: detection latency, median", float(np.median(late_ms)), "ms"),
        Row(f"{name}: detection latency, 95th percentile", float(np.percentile(late_ms, 95)), "ms"),
    ]


def _at_48_khz(mono: FloatArray, samplerate: int) -> FloatArray:
    mono = mono[: round(LONGEST_S * samplerate)]
    if samplerate == SAMPLERATE:
        return mono
    shared = gcd(SAMPLERATE, samplerate)
    return np.asarray(resample_poly(mono, SAMPLERATE // shared, samplerate // shared))
