"""Synthesised speech without meaning.

The source-filter model (G. Fant, "Acoustic Theory of Speech Production", 1960) filters harmonics
with the formants of the vocal tract. Consonants are band-passed noise.
"""

from __future__ import annotations  # numpy.random takes memory

from typing import NamedTuple

import numpy as np

from audioflinger_hook.scenes.shaping import band, curve, finished, pan, phase, room, times_s
from device.units import Float32Array, FloatArray

DURATION_S = 2.15

# Formants F1 to F4 of male vowels in Hz (after Peterson and Barney, 1952)
FORMANTS_HZ = {
    "a": (730.0, 1090.0, 2440.0, 3400.0),
    "e": (530.0, 1840.0, 2480.0, 3500.0),
    "i": (270.0, 2290.0, 3010.0, 3600.0),
    "o": (570.0, 840.0, 2410.0, 3300.0),
    "u": (300.0, 870.0, 2240.0, 3300.0),
}
BANDWIDTHS_HZ = (70.0, 90.0, 130.0, 200.0)

# Noise of consonants: (low Hz, high Hz, length in s, gain)
HISSES = {
    "s": (5000.0, 9000.0, 0.09, 0.30),
    "sh": (2000.0, 5500.0, 0.10, 0.34),
    "t": (3000.0, 7000.0, 0.022, 0.45),
    "k": (1300.0, 3200.0, 0.028, 0.45),
}


class Syllable(NamedTuple):
    """A syllable: a consonant of `HISSES`, or "" for none, then two vowels (may be the same)."""

    start_s: float
    length_s: float
    consonant: str
    vowels: tuple[str, str]
    pitch_hz: float
    stress: float


SYLLABLES = (
    Syllable(0.12, 0.20, "s", ("a", "e"), 128.0, 0.80),
    Syllable(0.36, 0.15, "t", ("o", "o"), 140.0, 0.70),
    Syllable(0.54, 0.26, "", ("a", "i"), 150.0, 1.00),
    Syllable(0.90, 0.14, "k", ("e", "e"), 124.0, 0.65),
    Syllable(1.08, 0.16, "", ("o", "u"), 118.0, 0.75),
    Syllable(1.38, 0.17, "sh", ("i", "a"), 132.0, 0.80),
    Syllable(1.58, 0.40, "t", ("a", "o"), 112.0, 1.00),
)

CONTROL_INTERVAL_S = 0.004  # interval at which the slowly varying formants are computed
HIGHEST_HARMONIC_HZ = 4800.0


def speech(samplerate: int, rng: np.random.Generator, peak: float) -> Float32Array:
    """Return seven syllables, 2.15 s, shape (frames, 2), with `peak` as largest absolute sample."""
    time_s = times_s(DURATION_S, samplerate)
    loudness = np.zeros(time_s.size)
    hiss = np.zeros(time_s.size)
    for syllable in SYLLABLES:
        stop_s = syllable.start_s + syllable.length_s
        start_s, middle_s = syllable.start_s, syllable.start_s + 0.6 * syllable.length_s
        swell = ((start_s - 0.012, 0.0), (start_s + 0.025, 1.0), (middle_s, 0.8))
        loudness += syllable.stress * curve(time_s, (*swell, (stop_s + 0.03, 0.0)))
        if syllable.consonant:
            hiss += _hiss(time_s, syllable, samplerate, rng)

    voiced = _voice(time_s, samplerate, rng) * loudness
    spoken = pan(voiced / np.max(np.abs(voiced)) + hiss, -0.12)
    spoken = room(spoken, samplerate, rng, decay_s=0.3, level=0.03)
    spoken = band(spoken, 70.0, None, samplerate)
    return finished(spoken, samplerate, peak=peak, fade_in_s=0.005, fade_out_s=0.08)


def _voice(time_s: FloatArray, samplerate: int, rng: np.random.Generator) -> FloatArray:
    """Return the vowels at constant loudness: harmonics filtered by formants, shape (frames,)."""
    pitch_points: list[tuple[float, float]] = []
    formant_points: list[tuple[float, tuple[float, float, float, float]]] = []
    for one in SYLLABLES:
        stop_s = one.start_s + one.length_s
        pitch_points += [(one.start_s, one.pitch_hz), (stop_s, 0.9 * one.pitch_hz)]
        for vowel, share in zip(one.vowels, (0.25, 0.85), strict=True):
            formant_points.append((one.start_s + share * one.length_s, FORMANTS_HZ[vowel]))
    jitter = band(rng.standard_normal(time_s.size), None, 25.0, samplerate)
    pitch_hz = curve(time_s, pitch_points) * (1.0 + 0.006 * jitter / np.std(jitter))
    phasor = np.exp(1j * phase(pitch_hz, samplerate))

    control_s = np.arange(0.0, DURATION_S + CONTROL_INTERVAL_S, CONTROL_INTERVAL_S)
    control_pitch_hz = np.interp(control_s, time_s, pitch_hz)
    formants_hz = [
        curve(control_s, [(at_s, tract[index]) for at_s, tract in formant_points])
        for index in range(len(BANDWIDTHS_HZ))
    ]

    voice = np.zeros(time_s.size)
    power = np.ones_like(phasor)
    for harmonic in range(1, int(HIGHEST_HARMONIC_HZ / np.min(control_pitch_hz)) + 1):
        power *= phasor
        frequency_hz = harmonic * control_pitch_hz
        # Glottis and lips attenuate by 6 dB per octave. The attenuation here is only 3 dB per
        # octave, to compensate for the missing formants above F4.
        gain = np.full(control_s.size, harmonic**-0.5)
        for centre_hz, bandwidth_hz in zip(formants_hz, BANDWIDTHS_HZ, strict=True):
            ratio = frequency_hz / centre_hz
            damping = frequency_hz * bandwidth_hz / centre_hz**2
            gain /= np.sqrt((1.0 - ratio**2) ** 2 + damping**2)
        gain[frequency_hz > min(HIGHEST_HARMONIC_HZ, 0.45 * samplerate)] = 0.0
        voice += np.interp(time_s, control_s, gain) * power.imag
    return voice


def _hiss(
    time_s: FloatArray, syllable: Syllable, samplerate: int, rng: np.random.Generator
) -> FloatArray:
    """Return the noise of a syllable's consonant, sampled at the times `time_s`."""
    low_hz, high_hz, length_s, gain = HISSES[syllable.consonant]
    noise = band(rng.standard_normal(time_s.size), low_hz, high_hz, samplerate)
    stop_s = syllable.start_s + 0.01
    start_s = stop_s - length_s
    rise_s, fall_s = start_s + min(0.004, 0.2 * length_s), start_s + 0.7 * length_s
    shape = curve(time_s, ((start_s, 0.0), (rise_s, 1.0), (fall_s, 0.8), (stop_s, 0.0)))
    return gain * syllable.stress * shape * noise / (3.0 * np.std(noise))
