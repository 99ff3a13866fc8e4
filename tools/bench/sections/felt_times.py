"""Rows for the report: delay of the vibration of impacts, and unwanted changes of vibration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from audioflinger_hook.transform import FloatArray
from tools.bench.measures.felt import weighted
from tools.bench.measures.impacts import Attack, attack, envelope, is_impact, onset_frame
from tools.bench.measures.steadiness import rises_of_its_own, warble
from tools.bench.methods import Method
from tools.bench.report import Row
from tools.bench.sections.felt_levels import VOLUMES_DB, Series
from tools.bench.sounds.real_sounds import RealSound, of_kinds
from tools.bench.sounds.signals import SAMPLERATE, pink_noise, tone

IMPACTS = {"drums": 12.0, "shots": 12.0, "explosions": 20.0}
"""Largest delay of half of the peak in ms, by class."""
BRIEF = ("drums", "shots")  # classes with reproducible peaks, which have one common median
PEAK_LIMIT_MS, NEARLY_ALL = 15.0, 87.5
BEFORE_S = 0.5
IMPACT_S = 3.0

A_MAJOR_HZ = (220.0, 277.18, 329.63)
CHORD_AMPLITUDE, NOISE_DB = 0.2, -20.0
STEADY_S, SETTLED_FROM_S = 10.0, 4.0
DRUM, CHORD = "drum, ", "chord, "  # prefixes of names of envelopes in the section's series
DRUM_STEP_S, DRUM_BEFORE_S, DRUM_S, CHORD_STEP_S = 0.001, 0.02, 0.2, 0.005
RISING = ("music", "engines", "speech")  # classes whose vibration should rise with the sound


def impact_rows(
    methods: Sequence[Method], sounds: Sequence[RealSound], series: Series
) -> Iterator[Row]:
    """Yield the delays from the sound of single impacts to their vibration.

    Each sound is measured at full volume and at -20 dB.

    series: the function adds the envelopes of one drum to it.
    """
    impacts = {
        kind: [
            each.sound
            for each in of_kinds(sounds, kind)
            if is_impact(each.sound, SAMPLERATE, brief=kind != "explosions")
        ]
        for kind in IMPACTS
    }
    found: dict[tuple[str, str], list[Attack | None]] = {}
    for kind, limit_ms in IMPACTS.items():
        played = [after_silence(sound) for sound in impacts[kind]]
        for method in methods:
            found[kind, method.name] = attacks = _attacks(method, played, BEFORE_S)
            yield from _lag_rows(kind, attacks, limit_ms, method)
    for method in methods:
        yield _peak_row([each for kind in BRIEF for each in found[kind, method.name]], method)
    drums = sorted(of_kinds(sounds, "drums"), key=lambda each: "kick" not in each.name.lower())
    if drums:
        series |= drum_series(methods, after_silence(drums[0].sound))


def _attacks(method: Method, played: Sequence[FloatArray], at_s: float) -> list[Attack | None]:
    return [
        attack(sound, method.vibration(sound, volume_db), SAMPLERATE, at_s)
        for sound in played
        for volume_db in VOLUMES_DB
    ]


def after_silence(sound: FloatArray) -> FloatArray:
    """Return at most 3 s of a sound, with 0.5 s of silence before and after it."""
    silence = np.zeros(round(BEFORE_S * SAMPLERATE))
    return np.concatenate((silence, sound[: round(IMPACT_S * SAMPLERATE)], silence))


def drum_series(methods: Sequence[Method], sound: FloatArray) -> Series:
    """Return the envelopes of a drum's sound and its vibrations around the onset, for each ms."""
    level = envelope(sound, SAMPLERATE)
    first = onset_frame(level, SAMPLERATE, BEFORE_S) - round(DRUM_BEFORE_S * SAMPLERATE)
    every = round(DRUM_STEP_S * SAMPLERATE)
    shown = slice(first, first + round(DRUM_S * SAMPLERATE), every)
    felt = {each.name: envelope(each.vibration(sound), SAMPLERATE) for each in methods}
    return {
        f"{DRUM}{name}": tuple(np.round(each[shown], 6).tolist())
        for name, each in ({"sound": level} | felt).items()
    }


def _lag_rows(
    kind: str, found: Sequence[Attack | None], limit_ms: float, method: Method
) -> Iterator[Row]:
    felt = [each for each in found if each]
    half = np.array([1e3 * each.half_lag_s for each in felt] or [np.nan])
    peak = np.array([1e3 * each.peak_lag_s for each in felt] or [np.nan])
    name = method.name
    p95, must = float(np.percentile(half, 95)), method.must("<=", limit_ms)
    if kind == "explosions":
        # The peak of a noise is random, so explosions have no defined peak time.
        share, must = 100.0 * float(np.mean(half <= limit_ms)), method.must(">=", NEARLY_ALL)
        yield Row(f"{kind}: half of the peak within {limit_ms:g} ms", share, "%", name, must)
    else:
        yield Row(f"{kind}: half of the peak, 95th percentile", p95, "ms", name, must)
        off = float(np.median(np.abs(peak)))
        yield Row(f"{kind}: peak off the sound's, median", off, "ms", name)
    yield Row(f"{kind}: felt as impacts", float(len(felt)), f"of {len(found)}", name)


def _peak_row(found: Sequence[Attack | None], method: Method) -> Row:
    after = np.array([1e3 * each.peak_lag_s for each in found if each] or [np.nan])
    must = method.must("<=", PEAK_LIMIT_MS)
    title = f"{' and '.join(BRIEF)}: peak after the sound's, median"
    return Row(title, float(np.median(after)), "ms", method.name, must)


def chord() -> FloatArray:
    """Return 10 s of an A-major chord of three sines, (frames,)."""
    return np.asarray(np.sum([tone(hz, CHORD_AMPLITUDE, STEADY_S) for hz in A_MAJOR_HZ], axis=0))


def steady_noise() -> FloatArray:
    """Return 10 s of steady pink noise, (frames,)."""
    noise = pink_noise(round(STEADY_S * SAMPLERATE), np.random.default_rng(7))
    return np.asarray(10.0 ** (NOISE_DB / 20.0) * np.sqrt(0.5) * noise)


def steady_rows(
    methods: Sequence[Method], sounds: Sequence[RealSound], series: Series
) -> Iterator[Row]:
    """Yield fluctuations of the perceived vibration that the sound does not have.

    For a steady chord and steady noise, the measure is the modulation depth. It is measured at full
    volume and at -20 dB, and the larger value counts. For music, engines and speech, the measure is
    the number of rises that only the vibration has, for each second of sound.

    series: the function adds the envelope of the chord's vibration to it.
    """
    steady = {"A-major chord": (chord(), 12.0), "pink noise": (steady_noise(), 25.0)}
    for name, (sound, limit) in steady.items():
        for method in methods:
            felt = [_settled(method, sound, volume_db) for volume_db in VOLUMES_DB]
            depth = 100.0 * max(warble(each, SAMPLERATE) for each in felt)
            title = f"steady {name}: modulation at 4 to 16 Hz"
            yield Row(title, depth, "%", method.name, method.must("<=", limit))
            if name == "A-major chord":
                shown = envelope(felt[0], SAMPLERATE)[
                    : 2 * SAMPLERATE : round(CHORD_STEP_S * SAMPLERATE)
                ]
                series[f"{CHORD}{method.name}"] = tuple(np.round(shown, 6).tolist())
    for kind in RISING:
        for method in methods:
            rises = [
                rises_of_its_own(each.sound, _weighted(method, each.sound), SAMPLERATE)
                for each in of_kinds(sounds, kind)
            ]
            mean = float(np.mean(rises)) if rises else float("nan")
            title = f"{kind}: rises of 6 dB a second that the sound has not"
            yield Row(title, mean, "", method.name, method.must("<=", 4.0))


def _settled(method: Method, sound: FloatArray, volume_db: float) -> FloatArray:
    return _weighted(method, sound, volume_db)[round(SETTLED_FROM_S * SAMPLERATE) :]


def _weighted(method: Method, sound: FloatArray, volume_db: float = 0.0) -> FloatArray:
    return weighted(method.vibration(sound, volume_db), SAMPLERATE)
