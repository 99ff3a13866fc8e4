"""Rows for the report: the vibration of single sounds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform import FloatArray
from tools.bench.measures.classes import features, told_apart
from tools.bench.measures.felt import weighted
from tools.bench.measures.loudness import momentary_sone
from tools.bench.measures.match import PIECE_S, POOR, match, pieces_rms
from tools.bench.measures.vibration import energy_above_db, energy_under_db, steady_fit
from tools.bench.methods import Method
from tools.bench.report import Row
from tools.bench.sounds.films import from_onset
from tools.bench.sounds.real_sounds import RealSound
from tools.bench.sounds.signals import SAMPLERATE, tone

SILENCE_S = 0.5  # silence in s before and after each single sound
LOW_HZ, LOW_DB, LEAK_DB = 15.0, -24.0, -55.0
POOR_SHARE = 5.0
CLASSES = ("explosions", "shots", "engines", "footsteps", "speech", "music")
TONES_HZ, TONE_AMPLITUDES, TONE_S = (60.0, 8_000.0), (0.02, 0.2), 6.0
SETTLED_FROM_S, SETTLED_TO_S = 3.0, 5.5
THD_DB = -60.0
BEGIN_S, STEP_SHARE = 1.0, 0.02


@dataclass(frozen=True)
class Floor:
    """Lower limits for the results of a profile over all sounds.

    match: limit of the mean of `Single.match`.
    told: limit of the share of correctly classified sounds, in %.
    """

    match: float
    told: float


FLOORS = {"cinema": Floor(83.3, 48.4), "game": Floor(85.3, 51.7), "music": Floor(85.6, 52.1)}
"""Lower limits by profile."""


@dataclass(frozen=True)
class Single:
    """Measures of the vibration of one sound.

    match: how well the vibration follows the loudness of the sound; 100 is best.
    leak_db: energy above 250 Hz in dB relative to the total energy.
    low_db: energy below 15 Hz in dB relative to the total energy.
    features: six numbers for classification.
    """

    match: float
    leak_db: float
    low_db: float
    features: FloatArray


def single(method: Method, one: RealSound) -> Single:
    """Measure the vibration of a sound, with silence added before and after it."""
    silence = np.zeros(round(SILENCE_S * SAMPLERATE))
    vibration = method.vibration(np.concatenate((silence, one.sound, silence)))
    sone = momentary_sone(one.sound, PIECE_S)
    own = slice(silence.size, silence.size + one.sound.size)
    return Single(
        match(sone, pieces_rms(vibration[own], SAMPLERATE)),
        energy_above_db(vibration, SAMPLERATE),
        energy_under_db(vibration, SAMPLERATE, LOW_HZ),
        features(weighted(vibration, SAMPLERATE)[own], SAMPLERATE),
    )


def single_rows(
    methods: Sequence[Method], sounds: Sequence[RealSound], half: Sequence[RealSound]
) -> Iterator[Row]:
    """Yield summaries of the measures of all sounds, and the share of correctly classified sounds.

    half: sounds for which the share of matches under 70 is also given separately.
    """
    reported = np.isin([one.name for one in sounds], [one.name for one in half])
    for method in methods:
        name = method.name
        found = [single(method, one) for one in sounds]
        matches = np.array([one.match for one in found])
        title, must = f"match under {POOR:g}", method.must("<=", POOR_SHARE)
        yield Row(title, _poor(matches), "% of sounds", name, must)
        if not reported.all():
            yield Row(
                f"{title}, reported half", _poor(matches[reported]), "% of sounds", name, must
            )
        floor = None if reported.all() else FLOORS.get(name)
        must = method.must(">=", floor.match) if floor else None
        yield Row("match, mean", float(matches.mean()), "", name, must)
        yield _worst_row(
            "energy above 250 Hz, worst sound", [one.leak_db for one in found], sounds, method,
            LEAK_DB,
        )  # fmt: skip
        yield _worst_row(
            "energy under 15 Hz, worst sound", [one.low_db for one in found], sounds, method, LOW_DB
        )
        chosen = [(one.features, of.kind) for one, of in zip(found, sounds, strict=True)
                  if of.kind in CLASSES]  # fmt: skip
        if chosen:
            numbers, kinds = zip(*chosen, strict=True)
            told = told_apart(np.array(numbers), kinds)
            must = method.must(">=", floor.told) if floor else None
            yield Row(f"{len(CLASSES)} classes told apart", told, "%", name, must)


def _poor(matches: FloatArray) -> float:
    return 100.0 * float(np.mean(matches < POOR))


def _worst_row(
    title: str, found: Sequence[float], sounds: Sequence[RealSound], method: Method, limit: float
) -> Row:
    at = int(np.argmax(found))
    note = f"{method.name}: {sounds[at].name}" if method.limited else ""
    return Row(title, found[at], "dB", method.name, method.must("<=", limit), note=note)


def beginning_rows(methods: Sequence[Method], sounds: Sequence[RealSound]) -> Iterator[Row]:
    """Yield the number of vibrations whose first sample exceeds 2 % of their peak.

    Each sound starts at its largest sample.
    """
    parts = [from_loudest(one.sound) for one in sounds]
    for method in methods:
        count = sum(step_share(method.vibration(one)) > STEP_SHARE for one in parts)
        must = method.must("<=", 0.0)
        title = "files that begin with a step over 2 % of the peak"
        yield Row(title, float(count), f"of {len(parts)}", method.name, must)


def from_loudest(sound: FloatArray) -> FloatArray:
    """Return at most 1 s of a sound, starting at its largest sample."""
    return from_onset(sound[int(np.abs(sound).argmax()) :])[: round(BEGIN_S * SAMPLERATE)]


def step_share(vibration: FloatArray) -> float:
    """Return the magnitude of the first sample relative to the peak; 0 for silence."""
    peak = float(np.abs(vibration).max(initial=0.0))
    return abs(float(vibration[0])) / peak if peak else 0.0


def tone_rows(methods: Sequence[Method], count: int) -> Iterator[Row]:
    """Yield the worst THD+N of the vibration of steady tones.

    Slow changes of level do not count as distortion.
    """
    settled = slice(*(round(each * SAMPLERATE) for each in (SETTLED_FROM_S, SETTLED_TO_S)))
    for method in methods:
        found = {
            f"{method.name}: {hz:g} Hz at {amplitude:g}": steady_fit(
                method.vibration(tone(hz, amplitude, TONE_S))[settled], SAMPLERATE
            )
            for amplitude in TONE_AMPLITUDES
            for hz in np.geomspace(*TONES_HZ, count).round(1).tolist()
        }
        where = max(found, key=lambda each: found[each])
        must = method.must_of_whole("<=", THD_DB)
        note = where if must else ""
        yield Row("THD+N of a tone, worst", found[where], "dB", method.name, must, note=note)
