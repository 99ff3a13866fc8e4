"""Synthesised impacts: footsteps on gravel, and an explosion with falling debris."""

from __future__ import annotations  # numpy.random takes memory

import numpy as np

from audioflinger_hook.scenes.shaping import band, curve, finished, pan, phase, ring, room, times_s
from device.units import Float32Array, FloatArray

FOOTSTEPS_DURATION_S = 2.5
FIRST_STEP_S, STEP_INTERVAL_S, TOE_DELAY_S = 0.03, 0.42, 0.11

EXPLOSION_DURATION_S = 3.1

# The explosion's noise: (low Hz, high Hz, decay time to -60 dB in s, gain)
BLAST_BANDS = (
    (30.0, 110.0, 3.4, 1.4),
    (110.0, 350.0, 2.4, 0.9),
    (350.0, 1200.0, 1.6, 0.7),
    (1200.0, 4000.0, 0.9, 0.6),
    (4000.0, 12000.0, 0.45, 0.5),
)
DEBRIS_PIECES = 34


def footsteps(samplerate: int, rng: np.random.Generator, peak: float) -> Float32Array:
    """Return the sound of six footsteps of rising level, left and right, shape (frames, 2)."""
    frames = np.zeros((round(FOOTSTEPS_DURATION_S * samplerate), 2))
    for step in range(6):
        side = -0.55 if step % 2 == 0 else 0.55
        strength = (0.55 + 0.09 * step) * rng.uniform(0.92, 1.08)
        heel_s = FIRST_STEP_S + step * STEP_INTERVAL_S + rng.uniform(-0.012, 0.012)
        pitch = rng.uniform(0.94, 1.06)
        _add(frames, _step(samplerate, rng, pitch) * strength, side, heel_s, samplerate)
        toe = 0.35 * strength * _step(samplerate, rng, 1.25 * pitch)
        _add(frames, toe, side, heel_s + TOE_DELAY_S, samplerate)
    frames = room(frames, samplerate, rng, decay_s=0.35, level=0.05)
    return finished(frames, samplerate, peak=peak, fade_in_s=0.002, fade_out_s=0.15)


def explosion(samplerate: int, rng: np.random.Generator, peak: float) -> Float32Array:
    """Return the sound of an explosion with falling debris, 3.1 s, shape (frames, 2)."""
    time_s = times_s(EXPLOSION_DURATION_S, samplerate)

    # The pitch falls as the ball of gas expands. Saturation by tanh adds harmonics.
    boom_hz = curve(time_s, ((0.0, 240.0), (0.06, 150.0), (0.3, 86.0), (1.2, 58.0), (3.1, 52.0)))
    boom = np.sin(phase(boom_hz, samplerate)) * 10.0 ** (-3.0 * time_s / 2.2)
    boom = np.tanh(3.0 * boom)

    blast = np.zeros((time_s.size, 2))
    for low_hz, high_hz, decay_s, gain in BLAST_BANDS:
        if low_hz >= 0.4 * samplerate:
            continue
        noise = band(rng.standard_normal((time_s.size, 2)), low_hz, high_hz, samplerate, order=1)
        decay = 10.0 ** (-3.0 * time_s / decay_s)
        blast += gain * decay[:, None] * noise / np.std(noise)
    # Two slow level maxima imitate reflections from a distance.
    rolling = curve(
        time_s, ((0.0, 1.0), (0.3, 0.75), (0.62, 1.25), (1.0, 0.8), (1.4, 1.3), (2.0, 0.9))
    )
    blast *= rolling[:, None]

    crack = rng.standard_normal(time_s.size) * 10.0 ** (-3.0 * time_s / 0.03)
    frames = np.tanh(0.55 * (blast + pan(4.2 * boom + 3.0 * crack, 0.0)))
    frames += _debris(samplerate, rng)
    frames = room(frames, samplerate, rng, decay_s=1.8, level=0.10, high_hz=3000.0)
    frames = band(frames, 28.0, None, samplerate)
    return finished(frames, samplerate, peak=peak, fade_in_s=0.001, fade_out_s=0.9)


def _step(samplerate: int, rng: np.random.Generator, pitch: float) -> FloatArray:
    """Return one footstep, 0.25 s, shape (frames,): a thud of falling pitch, and gravel noise."""
    time_s = times_s(0.25, samplerate)
    thud_hz = pitch * curve(time_s, ((0.0, 170.0), (0.015, 105.0), (0.08, 72.0), (0.25, 62.0)))
    thud = np.sin(phase(thud_hz, samplerate)) * 10.0 ** (-3.0 * time_s / 0.2)
    sole = band(rng.standard_normal(time_s.size), 90.0, 500.0, samplerate, order=1)
    sole *= 10.0 ** (-3.0 * time_s / 0.07)

    # Gravel: band-passed random impulses, whose density rises in 10 ms and then falls.
    density = curve(time_s, ((0.0, 0.0), (0.01, 900.0), (0.06, 700.0), (0.16, 120.0), (0.22, 0.0)))
    grains = rng.standard_normal(time_s.size) * (rng.random(time_s.size) < density / samplerate)
    crunch = band(grains, 1400.0, 6500.0, samplerate, order=1)
    crunch /= np.max(np.abs(crunch)) + 1e-12
    return thud + 0.8 * sole + 0.42 * crunch


def _debris(samplerate: int, rng: np.random.Generator) -> FloatArray:
    """Return the sound of debris, whose impacts start at 0.5 s, shape (frames, 2)."""
    frames = np.zeros((round(EXPLOSION_DURATION_S * samplerate), 2))
    strike = np.zeros(round(0.22 * samplerate))
    strike[0] = 1.0
    for _ in range(DEBRIS_PIECES):
        start_s = 0.5 + 1.9 * rng.beta(1.3, 2.2)
        size = rng.uniform(0.25, 1.0)
        base_hz = 480.0 + 2200.0 * (1.0 - size) * rng.uniform(0.6, 1.2)
        sound = np.zeros(strike.size)
        for ratio, gain in ((1.0, 1.0), (1.83, 0.6), (2.61, 0.35)):
            sound += gain * ring(strike, ratio * base_hz, 0.05 + 0.10 * size, samplerate)
        level = 0.16 * size * (1.0 - 0.25 * (start_s - 0.5))
        _add(frames, level * sound, rng.uniform(-0.9, 0.9), start_s, samplerate)
    return frames


def _add(
    frames: FloatArray, mono: FloatArray, position: float, start_s: float, samplerate: int
) -> None:
    """Add `mono` to `frames` from `start_s` on, panned to `position` and cut at the end."""
    start = round(start_s * samplerate)
    stop = min(start + mono.size, frames.shape[0])
    frames[start:stop] += pan(mono[: stop - start], position)
