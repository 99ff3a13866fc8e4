"""Bench on comparators: both forms of the transform beside other ways from sound to vibration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from audioflinger_hook.transform import FloatArray, TransformParameters
from tools.bench import baselines as comparators
from tools.bench.baselines import COMMAND
from tools.bench.baselines.watched import ComparatorFailed, watched
from tools.bench.cost import interleaved
from tools.bench.measures.similarity import (
    dominant_hz,
    envelope_correlation,
    felt_spectrum,
    level_db,
    spectral_distance,
    st_sim,
)
from tools.bench.measures.vibration import energy_above_db, onset_lag_s
from tools.bench.report import Missing, Row, Section, number
from tools.bench.sections.fidelity import (
    AUDIBLE_FROM_HZ,
    BURST_AMPLITUDE,
    BURST_HZ,
    BURST_ONSET_S,
    BURST_STREAM_S,
    REST_S,
)
from tools.bench.sounds.signals import SAMPLERATE, Recording, burst, chord, tone
from tools.bench.workbench import (
    LIVE,
    REFERENCE,
    SPEED_SUBJECTS,
    TWIN,
    Playback,
    Subject,
    Workbench,
)

TITLE = "Comparators"
BLOCKSIZE = 256
COST_S = 0.5
FELT_DB = -40.0
"""A burst is felt if its vibration is at least so strong against the burst, at 15 to 250 Hz."""
TONES_HZ = (1_000.0, 4_200.0)
TONE_AMPLITUDE, TONE_S = 0.3, 1.0
QUIETER_DB = (0.0, -20.0, -40.0)

COST = "cost of a second, blocks of 256"
COST_FFTS = f"{COST}, in FFTs"
LAG_MEAN, LAG_P95 = "onset lag, mean", "onset lag, 95th percentile"
BURSTS_FELT = "bursts felt"
CORRELATION = "envelope correlation, median recording"
LEAK, LEAK_MEDIAN = "energy above 250 Hz, worst recording", "energy above 250 Hz, median recording"
DISTANCE = "4.2 kHz against 1 kHz, spectral distance"
HIGH_LEVEL = "4.2 kHz, level of the vibration"
SLOPE = "level out over level in"
LIKE_SOUND = "ST-SIM to the sound's own low end"
LIKE_REFERENCE = "ST-SIM to the paper's vibration"
RECORDING_ROWS = (CORRELATION, LEAK, LEAK_MEDIAN, LIKE_SOUND, LIKE_REFERENCE)


@dataclass(frozen=True)
class _Criterion:
    """A row on which one way can beat another, and which end is better."""

    name: str
    better: Literal["less", "more"]


CRITERIA = (
    _Criterion(COST, "less"),
    _Criterion(LAG_MEAN, "less"),
    _Criterion(LAG_P95, "less"),
    _Criterion(BURSTS_FELT, "more"),
    _Criterion(CORRELATION, "more"),
    _Criterion(LEAK, "less"),
    _Criterion(LEAK_MEDIAN, "less"),
    _Criterion(DISTANCE, "more"),
    _Criterion(HIGH_LEVEL, "more"),
    _Criterion(LIKE_SOUND, "more"),
    _Criterion(LIKE_REFERENCE, "more"),
)
"""How loud out goes with loud in is no such row: more of it is truer, less of it is felt longer."""


def comparison(bench: Workbench) -> Section:
    """Every way from sound to vibration on the same sounds, and where a comparator wins."""
    others, missing = comparators.load()
    chosen = _spread(bench.recordings, bench.effort.compared_recordings)
    while True:
        try:
            rows = _rows((*bench.subjects, *map(watched, others)), bench, chosen)
            break
        except ComparatorFailed as error:  # all again without it: no row is of fewer sounds
            missing += (Missing(f"every row of the comparator {error.name}", str(error), COMMAND),)
            others = tuple(other for other in others if other.name != error.name)
    if not chosen:
        missing += tuple(bench.missing_recordings(f"{TITLE}: {name}") for name in RECORDING_ROWS)
    names = [subject.name for subject in others]
    return Section(
        TITLE,
        "Other ways from sound to vibration, each an implementation of our own in NumPy and not "
        "tuned, on the same sounds. Band-pass: 50 to 250 Hz as it is. Envelope: levelled, on a "
        "resonance at 150 Hz. Centroid: one sine at the centroid of 30 to 600 Hz. Octave fold: "
        f"two peaks halved until under 230 Hz. Lags are of the bursts felt, over {FELT_DB:g} dB "
        f"of the burst; high tones are looked for where one feels, at 15 to {AUDIBLE_FROM_HZ:g} "
        "Hz. ST-SIM is the likeness of patterns in time and frequency, 0 to 1: to the sound's own "
        "20 to 640 Hz, which favours whoever leaves the sound where it is, and to the reference "
        "form's vibration, which favours the transform. Level: a chord played quieter by 20 and 40 "
        "dB.",
        tuple(rows),
        missing,
        footnote=where_comparators_win(rows, names)
        + f" Recordings: {len(chosen)} of {len(bench.recordings)}.",
    )


def _rows(
    subjects: Sequence[Subject], bench: Workbench, recordings: Sequence[Recording]
) -> list[Row]:
    rows = _cost_rows((*subjects, *(way for way in SPEED_SUBJECTS if way.name == TWIN)), bench)
    for subject in subjects:
        rows += _onset_rows(subject, bench) + _high_tone_rows(subject) + _level_rows(subject)
    return rows + (_recording_rows(subjects, recordings) if recordings else [])


def where_comparators_win(rows: Sequence[Row], names: Sequence[str]) -> str:
    """Return a sentence that names every criterion on which a comparator beats the live form."""
    values = {(row.name, row.column): row for row in rows}
    won = []
    for criterion in CRITERIA:
        ours = values.get((criterion.name, LIVE))
        if ours is None or ours.value is None:
            continue
        sign = 1.0 if criterion.better == "more" else -1.0
        ahead = [
            (sign * row.value, row.column, row.value)
            for name in names
            if (row := values.get((criterion.name, name))) and row.value is not None
            if sign * row.value > sign * ours.value
        ]
        if ahead:
            shown = ", ".join(
                f"{name} {number(value)}" for _, name, value in sorted(ahead, reverse=True)
            )
            unit = f" {ours.unit}" if ours.unit else ""
            won.append(f"{criterion.name} ({shown} against {number(ours.value)}{unit})")
    if not won:
        return "No comparator beats the live form in any row where more or less is better."
    return "A comparator beats the live form in: " + "; ".join(won) + "."


def _cost_rows(subjects: Sequence[Subject], bench: Workbench) -> list[Row]:
    sound = chord(COST_S)
    playbacks = [Playback(subject, sound, BLOCKSIZE) for subject in subjects]
    timings = interleaved(
        [each.play for each in playbacks],
        [bench.effort.repeats_of(subject) for subject in subjects],
        [each.open for each in playbacks],
    )
    rows: list[Row] = []
    for subject, timing in zip(subjects, timings, strict=True):
        low, high = (1e3 * end(timing.seconds) / COST_S for end in (min, max))
        cost_ms = 1e3 * timing.median_s / COST_S
        rows.append(Row(COST, cost_ms, "ms", subject.name, low=low, high=high))
        units = float(round(timing.median_units / COST_S))
        rows.append(Row(COST_FFTS, units, "", subject.name))
    return rows


def _onset_rows(subject: Subject, bench: Workbench) -> list[Row]:
    """Return how soon bursts are felt, each at another place of the window."""
    count = bench.effort.compared_bursts
    window_s = TransformParameters().window_s
    places = np.random.default_rng(4).permutation(count) / count
    lags_ms = []
    for audio_hz, place in zip(np.geomspace(*BURST_HZ, count), places, strict=True):
        onset_s = BURST_ONSET_S + float(place) * window_s
        sound = burst(float(audio_hz), BURST_AMPLITUDE, onset_s, BURST_STREAM_S)
        vibration = subject.vibration(sound, SAMPLERATE)
        settled = vibration[
            round((onset_s + 0.1) * SAMPLERATE) : round((onset_s + 0.2) * SAMPLERATE)
        ]
        strength_db = level_db(float(felt_spectrum(settled, SAMPLERATE)[1].sum()))
        if strength_db - 20.0 * np.log10(BURST_AMPLITUDE) >= FELT_DB:
            lags_ms.append(1e3 * onset_lag_s(vibration, SAMPLERATE, onset_s))
    lags = np.array(lags_ms)
    mean, p95 = (float(lags.mean()), float(np.percentile(lags, 95))) if lags.size else (None, None)
    note = "" if lags.size else "none felt"
    return [
        Row(LAG_MEAN, mean, "ms", subject.name, note=note),
        Row(LAG_P95, p95, "ms", subject.name, note=note),
        Row(BURSTS_FELT, float(lags.size), f"of {count}", subject.name),
    ]


def _high_tone_rows(subject: Subject) -> list[Row]:
    """Return what becomes of 1 kHz and 4.2 kHz, and whether they are still two."""
    settled = [
        subject.vibration(tone(audio_hz, TONE_AMPLITUDE, TONE_S), SAMPLERATE)[-SAMPLERATE // 2 :]
        for audio_hz in TONES_HZ
    ]
    found = [dominant_hz(vibration, SAMPLERATE) for vibration in settled]
    rows = [
        Row(name, hz, "Hz", subject.name, note="" if hz is not None else "nothing")
        for name, hz in zip(("1 kHz, strongest at", "4.2 kHz, strongest at"), found, strict=True)
    ]
    distance = spectral_distance(settled[0], settled[1], SAMPLERATE)
    note = "" if distance is not None else "not felt both"
    power = float(felt_spectrum(settled[1], SAMPLERATE)[1].sum())
    against_db = level_db(power) - 20.0 * float(np.log10(TONE_AMPLITUDE))
    return [
        *rows,
        Row(DISTANCE, distance, "", subject.name, note=note),
        Row(HIGH_LEVEL, against_db, "dB", subject.name),
    ]


def _level_rows(subject: Subject) -> list[Row]:
    """Return how the vibration's level follows the sound's."""
    sound = chord(TONE_S)
    levels_db = np.array(
        [
            level_db(float(np.mean(vibration[SAMPLERATE // 2 :] ** 2)))
            for quieter_db in QUIETER_DB
            for vibration in [subject.vibration(sound * 10.0 ** (quieter_db / 20.0), SAMPLERATE)]
        ]
    )
    sounding = np.isfinite(levels_db)
    slope = None
    if sounding.sum() > 1:
        slope = float(np.polyfit(np.array(QUIETER_DB)[sounding], levels_db[sounding], 1)[0])
    rows = [Row(SLOPE, slope, "dB a dB", subject.name, note="" if slope is not None else "silent")]
    for quieter_db in QUIETER_DB[1:]:
        change_db = float(levels_db[QUIETER_DB.index(quieter_db)] - levels_db[0])
        rows.append(Row(f"sound at {quieter_db:g} dB, vibration", change_db, "dB", subject.name))
    return rows


def _spread(recordings: tuple[Recording, ...], count: int) -> list[Recording]:
    """Return so many recordings, evenly from first to last."""
    places = np.unique(np.linspace(0, len(recordings) - 1, count).round().astype(int))
    return [recordings[place] for place in places] if recordings else []


def _recording_rows(subjects: Sequence[Subject], recordings: Sequence[Recording]) -> list[Row]:
    """Return what is like what on recordings, with a second of silence after each."""
    measured: dict[str, list[dict[str, float]]] = {subject.name: [] for subject in subjects}
    for item in recordings:
        rate = item.samplerate
        rest = np.zeros((round(REST_S * rate), item.frames.shape[1]), item.frames.dtype)
        frames = np.concatenate((item.frames, rest))
        sound = frames.astype(np.float64).mean(axis=1)
        felt = {subject.name: subject.vibration(frames, rate) for subject in subjects}
        for name, vibration in felt.items():
            measured[name].append(
                {
                    CORRELATION: envelope_correlation(sound, vibration, rate),
                    LEAK: energy_above_db(vibration, rate, AUDIBLE_FROM_HZ),
                    LIKE_SOUND: st_sim(vibration, sound, rate),
                    LIKE_REFERENCE: st_sim(vibration, felt[REFERENCE], rate),
                }
            )
    rows: list[Row] = []
    for name, results in measured.items():
        for title, row, summary, unit in (
            (CORRELATION, CORRELATION, np.nanmedian, ""),
            (LEAK, LEAK, np.nanmax, "dB"),
            (LEAK_MEDIAN, LEAK, np.nanmedian, "dB"),
            (LIKE_SOUND, LIKE_SOUND, np.nanmedian, ""),
            (LIKE_REFERENCE, LIKE_REFERENCE, np.nanmedian, ""),
        ):
            pick: Callable[[FloatArray], float] = summary
            values = np.array([result[row] for result in results])
            value = None if np.isnan(values).all() else float(pick(values))
            rows.append(Row(title, value, unit, name, note="" if value is not None else "silence"))
    return rows
