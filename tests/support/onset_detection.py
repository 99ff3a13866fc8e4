"""Sounds with known onsets, and which of these the live form detects, how soon, and how falsely.

It runs the oracle's search for onsets, by which the live form begins partials.
"""

import numpy as np

from audioflinger_hook.transform import FloatArray, TransformParameters
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.input_stage import BandPass
from tests.oracle import settings_of
from tests.oracle.onsets import Onsets
from tools.bench.sounds.signals import SAMPLERATE, chord

REACH_S = 0.024
"""An onset is found if one is detected within this time of it."""
STEADY_FROM_S, STEADY_S = 0.1, 2.0
"""The start of a steady sound is an onset; later ones are false."""


def onset_times_s(sound: FloatArray) -> FloatArray:
    """Return when onsets are detected in a sound (frames,) at 48 kHz, in seconds."""
    s = settings_of(LiveDesign.of(TransformParameters(), SAMPLERATE))
    filtered = BandPass(s.band_b, s.band_a, s.denormal_guard).process(sound)
    ends = np.arange(s.tick_frames, filtered.size + 1, s.tick_frames)
    heard = (1 + np.flatnonzero(Onsets(s, filtered, ends).onset == np.arange(ends.size))).tolist()
    # A second detection within the rest is of the same onset.
    pairs = zip(heard, [-s.rest_ticks, *heard], strict=False)
    kept = [tick for tick, last in pairs if tick - last >= s.rest_ticks]
    return np.array(kept, dtype=np.float64) * float(s.tick_s)


def found(sound: FloatArray, onsets_s: FloatArray) -> tuple[list[float], int]:
    """Return the delay of each known onset that is detected, s, and how many are detected."""
    detected = onset_times_s(sound)
    free = np.ones(detected.size, dtype=bool)
    late_s = []
    for onset_s in onsets_s.tolist():
        away = np.where(free, np.abs(detected - onset_s), np.inf)
        if away.size and away.min() <= REACH_S:
            nearest = int(away.argmin())
            free[nearest] = False
            late_s.append(float(detected[nearest]) - onset_s)
    return late_s, detected.size


def onset_train(count: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return tones, clicks and bursts of noise amid silence, (frames,), and when each begins, s.

    Each sounds for a third to two thirds of the time to the next one.
    """
    rng = np.random.default_rng(seed)
    gaps_s = np.exp(rng.uniform(np.log(0.06), np.log(1.0), count))
    starts = np.round((0.3 + np.cumsum(gaps_s) - gaps_s) * SAMPLERATE).astype(int)
    sound = np.zeros(int(starts[-1]) + 2 * SAMPLERATE)
    for which, (start, gap_s) in enumerate(zip(starts.tolist(), gaps_s.tolist(), strict=True)):
        level = 10 ** (rng.uniform(-40.0, -6.0) / 20)
        wave = level * _wave(which, gap_s * rng.uniform(1 / 3, 2 / 3), rng)
        sound[start : start + wave.size] += wave
    return sound, starts / SAMPLERATE


def planted(sound: FloatArray, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return a sound (frames,) with onsets 10 dB over its 0.05 s around, and when they begin, s."""
    rng = np.random.default_rng(seed)
    mixed, starts_s, around = sound.copy(), [], round(0.05 * SAMPLERATE)
    for which, at_s in enumerate(np.arange(0.1, sound.size / SAMPLERATE - 0.15, 0.2)):
        start = round((float(at_s) + rng.uniform(0.0, 0.05)) * SAMPLERATE)
        near = sound[max(0, start - around) : start + around]
        level = max(1e-3, float(np.sqrt(np.mean(near**2)))) * 10 ** (10.0 / 20)
        wave = _wave(which, 0.05, rng)
        heard = max(wave.size, round(0.005 * SAMPLERATE))  # a click's level is that of 5 ms
        wave *= level / float(np.sqrt(np.sum(wave**2) / heard))
        mixed[start : start + wave.size] += wave
        starts_s.append(start / SAMPLERATE)
    return mixed, np.array(starts_s)


def _wave(kind: int, duration_s: float, rng: np.random.Generator) -> FloatArray:
    """Return a tone, a click of 1 ms, or a burst of noise, with a peak of about 1."""
    since_s = np.arange(round(duration_s * SAMPLERATE)) / SAMPLERATE
    swell = np.clip(since_s / 0.001, 0.0, 1.0) * np.clip((duration_s - since_s) / 0.005, 0.0, 1.0)
    if kind % 3 == 0:
        (frequency_hz,) = np.exp(rng.uniform(np.log(80.0), np.log(8_000.0), 1))
        return np.asarray(swell * np.sin(2.0 * np.pi * frequency_hz * since_s))
    if kind % 3 == 1:
        return rng.uniform(-1.0, 1.0, round(0.001 * SAMPLERATE))
    return np.asarray(swell * rng.uniform(-1.0, 1.0, since_s.size))


def steady_sounds() -> dict[str, FloatArray]:
    """Return sounds without an onset after their start, each (frames,), by name."""
    time_s = np.arange(round(STEADY_S * SAMPLERATE)) / SAMPLERATE

    def wave(phase: FloatArray) -> FloatArray:
        return np.asarray(0.3 * np.sin(2.0 * np.pi * phase))

    tones = [wave(hz * time_s) / 4.0 for hz in (60.0, 200.0, 1_000.0, 8_000.0)]
    vibrato = 1_000.0 * time_s + 4.0 / np.pi * np.sin(2.0 * np.pi * 6.0 * time_s)
    sounds = {
        "tones of 60 to 8 000 Hz": np.sum(tones, axis=0),
        "white noise": np.random.default_rng(3).uniform(-0.5, 0.5, time_s.size),
        "chord, its levels modulated": chord(STEADY_S)[:, 0].astype(np.float64),
        "chirp, an octave a second": wave(200.0 / np.log(2.0) * (2.0**time_s - 1.0)),
        "vibrato of 6 Hz": wave(vibrato),
    }
    for swell_hz in (4, 10, 30):
        swell = 0.5 + 0.5 * np.sin(2.0 * np.pi * swell_hz * time_s)
        sounds[f"level swelling from nothing at {swell_hz} Hz"] = wave(1_000.0 * time_s) * swell
    return sounds
