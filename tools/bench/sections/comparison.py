"""Section "Baselines": the live and the reference form of the transform, and other methods.

All methods convert the same sounds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from audioflinger_hook.transform import FloatArray, TransformParameters
from tools.bench.baselines import BASELINES
from tools.bench.measures.similarity import (
    envelope_correlation,
    felt_spectrum,
    level_db,
    spectral_distance,
)
from tools.bench.measures.vibration import energy_above_db, onset_lag_s
from tools.bench.report import Row, Section, number
from tools.bench.sections.fidelity import (
    AUDIBLE_FROM_HZ,
    BURST_AMPLITUDE,
    BURST_HZ,
    BURST_ONSET_S,
    BURST_STREAM_S,
    REST_S,
)
from tools.bench.sounds.signals import SAMPLERATE, Recording, burst, chord, tone
from tools.bench.workbench import LIVE, Playback, Subject, Workbench, timed

TITLE = "Baselines"
BLOCKSIZE, WHOLE_BLOCKSIZE = 256, 32_768
COST_S = 0.5
FELT_DB = -40.0  # lowest level in dB of perceived vibration at 15 to 250 Hz, relative to the burst
TONES_HZ = (1_000.0, 4_200.0)
TONE_AMPLITUDE, TONE_S = 0.3, 1.0

COST = "cost of a second, blocks of 256"
COST_WHOLE = "cost of a second, blocks of 32768"
FFTS = ", in FFTs"
LAG_MEAN, LAG_P95 = "onset lag, mean", "onset lag, 95th percentile"
BURSTS_FELT = "bursts perceived"
CORRELATION = "envelope correlation, median recording"
LEAK, LEAK_MEDIAN = "energy above 250 Hz, worst recording", "energy above 250 Hz, median recording"
DISTANCE = "4.2 kHz against 1 kHz, spectral distance"
HIGH_LEVEL = "4.2 kHz, level of the vibration"

SUMMARIES: dict[str, tuple[str, Callable[[FloatArray], float], str]] = {
    CORRELATION: (CORRELATION, np.nanmedian, ""),
    LEAK: (LEAK, np.nanmax, "dB"),
    LEAK_MEDIAN: (LEAK, np.nanmedian, "dB"),
}

CRITERIA = {
    COST: -1, LAG_MEAN: -1, LAG_P95: -1, BURSTS_FELT: 1, CORRELATION: 1, LEAK: -1,
    LEAK_MEDIAN: -1, DISTANCE: 1, HIGH_LEVEL: 1,
}  # fmt: skip
"""Rows in which a baseline can be better; 1: larger values are better, -1: smaller values."""


def compared(bench: Workbench) -> Section:
    """Measure all methods on the same sounds; list rows where a baseline beats the live form."""
    chosen = _spread(bench.recordings, bench.effort.compared_recordings)
    rows = _rows((*bench.subjects, *BASELINES), bench, chosen)
    missing = () if chosen else (bench.missing_recordings(f"{TITLE}: rows on recordings"),)
    return Section(
        TITLE,
        "The baselines are other methods that compute vibration from sound. This project "
        "implemented them in NumPy, without tuning. The method *band-pass* passes 50 to 250 Hz "
        "unchanged. The method *envelope* works like Android's HapticGenerator: the envelope of "
        "the sound, with automatic gain, drives a resonance at 150 Hz. The method *centroid* "
        "computes one sine at the spectral centroid of the sound from 30 to 600 Hz. The method "
        "*octave fold* takes the highest spectral peak in each of two ranges, and halves both "
        "frequencies until they are under 230 Hz. Lags are measured only for bursts whose "
        f"vibration has a level over {FELT_DB:g} dB relative to the burst. The onset is measured "
        "in the envelope of the vibration. A filter with zero phase smooths the envelope, and "
        "spreads it to earlier times. If the vibration overshoots, as with *envelope*, the "
        "measured onset is therefore some ms too early. The level of the vibration of high tones "
        f"is measured from 15 to {AUDIBLE_FROM_HZ:g} Hz.",
        tuple(rows),
        missing,
        footnote=where_baselines_win(rows)
        + f" Recordings: {len(chosen)} of {len(bench.recordings)}.",
    )


def _rows(
    subjects: Sequence[Subject], bench: Workbench, recordings: Sequence[Recording]
) -> list[Row]:
    rows = _cost_rows(subjects, bench)
    for subject in subjects:
        rows += _onset_rows(subject, bench) + _high_tone_rows(subject)
    return rows + (_recording_rows(subjects, recordings) if recordings else [])


def where_baselines_win(rows: Sequence[Row]) -> str:
    """Return a text that lists the rows in which a baseline is better than the live form."""
    values = {(row.name, row.column): row for row in rows}
    won = []
    for name, sign in CRITERIA.items():
        ours = values.get((name, LIVE))
        if ours is None or ours.value is None:
            continue
        ahead = sorted(
            (
                (sign * row.value, row.column, row.value)
                for other in BASELINES
                if (row := values.get((name, other.name))) and row.value is not None
                if sign * row.value > sign * ours.value
            ),
            reverse=True,
        )
        if ahead:
            shown = ", ".join(f"{column} {number(value)}" for _, column, value in ahead)
            unit = f" {ours.unit}" if ours.unit else ""
            won.append(f"{name} ({shown} against {number(ours.value)}{unit})")
    if not won:
        return "No baseline beats the live form in any row where more or less is better."
    return "Rows in which a baseline beats the live form:\n\n" + "\n".join(
        f"- {row}" for row in won
    )


def _cost_rows(subjects: Sequence[Subject], bench: Workbench) -> list[Row]:
    sound = chord(COST_S)
    repeats = [bench.effort.repeats_of(subject) for subject in subjects]
    rows: list[Row] = []
    for name, blocksize in ((COST, BLOCKSIZE), (COST_WHOLE, WHOLE_BLOCKSIZE)):
        timings = timed([Playback(subject, sound, blocksize) for subject in subjects], repeats)
        for subject, timing in zip(subjects, timings, strict=True):
            low, high = (1e3 * end(timing.seconds) / COST_S for end in (min, max))
            cost_ms, ffts = 1e3 * timing.median_s / COST_S, timing.median_units / COST_S
            rows.append(Row(name, cost_ms, "ms", subject.name, low=low, high=high))
            rows.append(Row(name + FFTS, float(round(ffts)), "", subject.name))
    return rows


def _onset_rows(subject: Subject, bench: Workbench) -> list[Row]:
    count = bench.effort.compared_bursts
    window_s = TransformParameters().window_s
    places = np.random.default_rng(4).permutation(count) / count
    lags_ms = []
    for audio_hz, place in zip(np.geomspace(*BURST_HZ, count), places, strict=True):
        onset_s = BURST_ONSET_S + float(place) * window_s
        sound = burst(float(audio_hz), BURST_AMPLITUDE, onset_s, BURST_STREAM_S)
        vibration = subject.vibration(sound, SAMPLERATE)
        first, last = (round((onset_s + after_s) * SAMPLERATE) for after_s in (0.1, 0.2))
        strength_db = level_db(float(felt_spectrum(vibration[first:last], SAMPLERATE)[1].sum()))
        if strength_db - 20.0 * np.log10(BURST_AMPLITUDE) >= FELT_DB:
            lags_ms.append(1e3 * onset_lag_s(vibration, SAMPLERATE, onset_s))
    mean = float(np.mean(lags_ms)) if lags_ms else None
    p95 = float(np.percentile(lags_ms, 95)) if lags_ms else None
    note = "" if lags_ms else "none perceived"
    return [
        Row(LAG_MEAN, mean, "ms", subject.name, note=note),
        Row(LAG_P95, p95, "ms", subject.name, note=note),
        Row(BURSTS_FELT, float(len(lags_ms)), f"of {count}", subject.name),
    ]


def _high_tone_rows(subject: Subject) -> list[Row]:
    settled = [
        subject.vibration(tone(audio_hz, TONE_AMPLITUDE, TONE_S), SAMPLERATE)[-SAMPLERATE // 2 :]
        for audio_hz in TONES_HZ
    ]
    distance = spectral_distance(settled[0], settled[1], SAMPLERATE)
    note = "" if distance is not None else "not felt both"
    power = float(felt_spectrum(settled[1], SAMPLERATE)[1].sum())
    against_db = level_db(power) - 20.0 * float(np.log10(TONE_AMPLITUDE))
    return [
        Row(DISTANCE, distance, "", subject.name, note=note),
        Row(HIGH_LEVEL, against_db, "dB", subject.name),
    ]


def _spread(recordings: tuple[Recording, ...], count: int) -> list[Recording]:
    places = np.unique(np.linspace(0, len(recordings) - 1, count).round().astype(int))
    return [recordings[place] for place in places] if recordings else []


def _recording_rows(subjects: Sequence[Subject], recordings: Sequence[Recording]) -> list[Row]:
    measured: dict[str, list[dict[str, float]]] = {subject.name: [] for subject in subjects}
    for item in recordings:
        rate = item.samplerate
        rest = np.zeros((round(REST_S * rate), item.frames.shape[1]), item.frames.dtype)
        frames = np.concatenate((item.frames, rest))
        sound = frames.astype(np.float64).mean(axis=1)
        for subject in subjects:
            vibration = subject.vibration(frames, rate)
            measured[subject.name].append(
                {
                    CORRELATION: envelope_correlation(sound, vibration, rate),
                    LEAK: energy_above_db(vibration, rate, AUDIBLE_FROM_HZ),
                }
            )
    rows: list[Row] = []
    for name, results in measured.items():
        for title, (measure, summary, unit) in SUMMARIES.items():
            values = np.array([result[measure] for result in results])
            silent = bool(np.isnan(values).all())
            value = None if silent else float(summary(values))
            rows.append(Row(title, value, unit, name, note="silence" if silent else ""))
    return rows
