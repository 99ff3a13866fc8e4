"""A synthesised chord: an arpeggio on a piano with sustained strings."""

from __future__ import annotations  # numpy.random takes memory

import numpy as np

from audioflinger_hook.scenes.shaping import band, curve, finished, pan, phase, ring, room, times_s
from device.units import Float32Array, FloatArray

DURATION_S = 3.1
RELEASE_S = 2.35  # time of release of the piano keys

# D major with ninth: (onset in s, frequency in Hz, velocity)
NOTES = (
    (0.00, 73.42, 1.00),  # D2
    (0.07, 110.00, 0.80),  # A2
    (0.14, 146.83, 0.80),  # D3
    (0.21, 220.00, 0.70),  # A3
    (0.28, 369.99, 0.70),  # F sharp 4
    (0.36, 659.26, 0.55),  # E5
    (0.95, 880.00, 0.40),  # A5
)
PAD_NOTES_HZ = (73.42, 146.83, 220.00, 369.99)

INHARMONICITY = 4e-4  # B of a stiff string: partial n has the frequency f n sqrt(1 + B n^2)


def chord(samplerate: int, rng: np.random.Generator, peak: float) -> Float32Array:
    """Return the chord, 3.1 s, shape (frames, 2), with `peak` as its largest absolute sample."""
    time_s = times_s(DURATION_S, samplerate)
    frames = np.zeros((time_s.size, 2))
    for onset_s, frequency_hz, velocity in NOTES:
        start = round(onset_s * samplerate)
        # Low notes are on the left, as for a pianist.
        position = np.clip(0.25 * np.log2(frequency_hz / 220.0), -0.6, 0.6)
        note = _piano(time_s.size - start, frequency_hz, velocity, samplerate, rng)
        frames[start:] += pan(note[:, 0], position - 0.2) + pan(note[:, 1], position + 0.2)
    frames *= curve(time_s, ((0.0, 1.0), (RELEASE_S, 1.0), (RELEASE_S + 0.4, 0.0)))[:, None]

    swell = curve(time_s, ((0.0, 0.0), (1.1, 1.0), (RELEASE_S, 0.9), (DURATION_S, 0.0)))
    frames += 0.55 * swell[:, None] * _pad(time_s.size, samplerate, rng)
    frames = room(frames, samplerate, rng, decay_s=1.4, level=0.10)
    return finished(frames, samplerate, peak=peak, fade_in_s=0.002, fade_out_s=0.5)


def _piano(
    frames: int, frequency_hz: float, velocity: float, samplerate: int, rng: np.random.Generator
) -> FloatArray:
    """Return one note of two slightly detuned strings, shape (frames, 2)."""
    hammer = np.zeros(frames)
    width = max(2, round(0.0015 * samplerate))
    hammer[:width] = np.hanning(width + 2)[1:-1]
    hammer *= velocity / hammer.sum()

    strings = np.zeros((frames, 2))
    for number in range(1, 13):
        partial_hz = frequency_hz * (number * np.sqrt(1.0 + INHARMONICITY * number**2))
        if partial_hz > min(7000.0, 0.4 * samplerate):
            break
        decay_s = 6.0 / (1.0 + 0.35 * (number - 1)) * (220.0 / (220.0 + frequency_hz)) ** 0.4
        # A hammer at 1/8 of the string's length excites all partials except every eighth.
        gain = abs(np.sin(np.pi * number / 8.0)) * number**-0.9
        for string, detune in enumerate((-0.0006, 0.0006)):
            pushed_hz = partial_hz * (1.0 + detune * rng.uniform(0.7, 1.3))
            strings[:, string] += gain * ring(hammer, pushed_hz, decay_s, samplerate)
    return strings


def _pad(frames: int, samplerate: int, rng: np.random.Generator) -> FloatArray:
    """Return the sound of detuned, low-passed strings at `PAD_NOTES_HZ`, shape (frames, 2)."""
    time_s = np.arange(frames) / samplerate
    pad = np.zeros((frames, 2))
    for frequency_hz in PAD_NOTES_HZ:
        for side, detune in enumerate((-0.0018, 0.0018)):
            vibrato = 1.0 + detune + 0.0015 * np.sin(2.0 * np.pi * 5.1 * time_s + rng.uniform(0, 6))
            phasor = np.exp(1j * phase(frequency_hz * vibrato, samplerate))
            power = np.ones_like(phasor)
            for number in range(1, 7):
                power *= phasor
                pad[:, side] += power.imag * number**-1.4 * (220.0 / frequency_hz) ** 0.3
    return 0.3 * band(pad, None, 1800.0, samplerate)
