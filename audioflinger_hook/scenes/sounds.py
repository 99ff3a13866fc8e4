"""The sounds of the demo scene, except speech: a chord, an engine, footsteps and an explosion."""

from __future__ import annotations  # numpy.random takes memory

import math

import numpy as np

from audioflinger_hook.scenes.shaping import band, curve, finished, pan, phase, ring, room, times_s
from device.units import Float32Array, FloatArray

CHORD_DURATION_S = 3.1
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
    time_s = times_s(CHORD_DURATION_S, samplerate)
    frames = np.zeros((time_s.size, 2))
    for onset_s, frequency_hz, velocity in NOTES:
        start = round(onset_s * samplerate)
        # Low notes are on the left, as for a pianist.
        position = np.clip(0.25 * np.log2(frequency_hz / 220.0), -0.6, 0.6)
        note = _piano(time_s.size - start, frequency_hz, velocity, samplerate, rng)
        frames[start:] += pan(note[:, 0], position - 0.2) + pan(note[:, 1], position + 0.2)
    frames *= curve(time_s, ((0.0, 1.0), (RELEASE_S, 1.0), (RELEASE_S + 0.4, 0.0)))[:, None]

    swell = curve(time_s, ((0.0, 0.0), (1.1, 1.0), (RELEASE_S, 0.9), (CHORD_DURATION_S, 0.0)))
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


ENGINE_DURATION_S = 4.4

CATCH_S = 0.66  # time at which combustion starts and the starter motor stops
PASS_S = 3.3  # time at which the car is closest to the listener

# (seconds, revolutions of the crankshaft per second); 15 is 900 rpm, 92 is 5500 rpm
CRANK_HZ = (
    (0.0, 3.2), (0.55, 3.8), (0.66, 6.0), (0.84, 34.0), (1.05, 22.0), (1.35, 15.0), (1.72, 15.0),
    (2.02, 66.0), (2.12, 64.0), (2.42, 19.0), (2.52, 20.0), (3.22, 88.0), (3.32, 54.0),
    (4.2, 95.0), (4.4, 96.0),
)  # fmt: skip

# (seconds, load from 0 to 1); the load controls level and roughness
LOAD = (
    (0.0, 0.0), (0.64, 0.0), (0.72, 0.9), (0.9, 0.5), (1.2, 0.28), (1.7, 0.26), (1.82, 0.9),
    (2.02, 0.85), (2.14, 0.3), (2.45, 0.25), (2.58, 0.9), (3.18, 1.0), (3.26, 0.4), (3.38, 1.0),
    (4.4, 0.95),
)  # fmt: skip

POSITION = ((0.0, -0.75), (2.5, -0.7), (PASS_S, 0.0), (4.1, 0.85), (4.4, 0.9))
DISTANCE_GAIN = ((0.0, 0.75), (2.5, 0.75), (PASS_S - 0.1, 1.0), (3.9, 0.42), (4.4, 0.1))

HIGHEST_ORDER = 64
# Resonances of exhaust and car body: (frequency in Hz, decay time to -60 dB in s, gain)
RESONANCES = ((92.0, 0.10, 1.1), (205.0, 0.07, 0.9), (470.0, 0.035, 0.5), (1150.0, 0.015, 0.35))


def engine(samplerate: int, rng: np.random.Generator, peak: float) -> Float32Array:
    """Return the engine's sound, 4.4 s, (frames, 2), with `peak` as its largest absolute sample."""
    time_s = times_s(ENGINE_DURATION_S, samplerate)
    load = curve(time_s, LOAD)

    doppler = 1.0 - 0.07 * np.tanh((time_s - PASS_S) / 0.35)
    # Noise below 9 Hz modulates the speed of rotation.
    wander = band(rng.standard_normal(time_s.size), None, 9.0, samplerate)
    unsteady = 1.0 + 0.02 * (wander / np.std(wander)) * (1.2 - load)
    cycle_phase = phase(0.5 * curve(time_s, CRANK_HZ) * doppler * unsteady, samplerate)

    combustion = _orders(cycle_phase, rng) * (0.06 + load)
    roar = band(rng.standard_normal(time_s.size), 220.0, 3200.0, samplerate, order=1)
    combustion += 0.3 * roar * load * (0.35 + (0.5 + 0.5 * np.cos(8 * cycle_phase)) ** 3)

    tone = 0.55 * combustion
    for frequency_hz, decay_s, gain in RESONANCES:
        # At its frequency, a resonator amplifies by about decay_s * samplerate / 14.
        build_up = decay_s * samplerate / 14.0
        tone += gain / build_up * ring(combustion, frequency_hz, decay_s, samplerate)
    tone = np.tanh(1.4 * tone)
    tone += _starter(time_s, cycle_phase, samplerate, rng)

    placed = pan(tone * curve(time_s, DISTANCE_GAIN), curve(time_s, POSITION))
    placed = room(placed, samplerate, rng, decay_s=0.7, level=0.06)
    placed = band(placed, 28.0, None, samplerate)
    return finished(placed, samplerate, peak=peak, fade_in_s=0.02, fade_out_s=0.35)


def _orders(cycle_phase: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return the sum of all orders. Powers of one phasor save computing time."""
    phasor = np.exp(1j * cycle_phase)
    power = np.ones_like(phasor)
    total = np.zeros(cycle_phase.size)
    for order in range(1, HIGHEST_ORDER + 1):
        power *= phasor
        evenness = {1: 0.04, 2: 0.10, 4: 0.6, 8: 1.0}[math.gcd(order, 8)]
        weight = evenness * (order / 8.0) ** -0.9 * np.exp(2j * np.pi * rng.random())
        total += power.real * weight.real - power.imag * weight.imag
    return total


def _starter(
    time_s: FloatArray, cycle_phase: FloatArray, samplerate: int, rng: np.random.Generator
) -> FloatArray:
    """Return the starter motor's sound: a tone, lower at each compression, and noise pulses."""
    on = curve(time_s, ((0.0, 0.0), (0.03, 1.0), (CATCH_S - 0.04, 1.0), (CATCH_S + 0.06, 0.0)))
    compression = (0.5 + 0.5 * np.cos(8 * cycle_phase)) ** 2
    whine_phase = phase(330.0 - 70.0 * compression, samplerate)
    whine = np.sin(whine_phase) + 0.5 * np.sin(2.0 * whine_phase) + 0.3 * np.sin(5.0 * whine_phase)
    chug = band(rng.standard_normal(time_s.size), 60.0, 700.0, samplerate, order=1)
    return on * (0.10 * whine * (0.5 + compression) + 0.9 * chug * compression**2)


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
