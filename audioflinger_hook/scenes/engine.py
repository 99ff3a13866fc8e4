"""A V8 engine: cranked, it catches, idles, is revved, and pulls away from left to right.

An engine sounds at multiples ("orders") of its working cycle, two turns of the crank. Eight
cylinders fire eight times a cycle, so order 8 and its multiples are loud; the uneven firing of the
two banks gives the burble between them.
"""

from __future__ import annotations

import math

import numpy as np

from audioflinger_hook.scenes.shaping import (
    band,
    curve,
    finished,
    pan,
    phase_of,
    ring,
    room,
    times_s,
)
from device.units import Float32Array, FloatArray

DURATION_S = 4.4

CATCH_S = 0.66  # the starter lets go, combustion takes over
PASS_S = 3.3  # the car is in front of the listener

# (seconds, turns of the crank a second); 15 is 900 rpm, 92 is 5500 rpm
CRANK_HZ = (
    (0.0, 3.2), (0.55, 3.8), (0.66, 6.0), (0.84, 34.0), (1.05, 22.0), (1.35, 15.0), (1.72, 15.0),
    (2.02, 66.0), (2.12, 64.0), (2.42, 19.0), (2.52, 20.0), (3.22, 88.0), (3.32, 54.0),
    (4.2, 95.0), (4.4, 96.0),
)  # fmt: skip

# (seconds, load): how hard the engine works, hence how loud and rough it is
LOAD = (
    (0.0, 0.0), (0.64, 0.0), (0.72, 0.9), (0.9, 0.5), (1.2, 0.28), (1.7, 0.26), (1.82, 0.9),
    (2.02, 0.85), (2.14, 0.3), (2.45, 0.25), (2.58, 0.9), (3.18, 1.0), (3.26, 0.4), (3.38, 1.0),
    (4.4, 0.95),
)  # fmt: skip

POSITION = ((0.0, -0.75), (2.5, -0.7), (PASS_S, 0.0), (4.1, 0.85), (4.4, 0.9))
DISTANCE_GAIN = ((0.0, 0.75), (2.5, 0.75), (PASS_S - 0.1, 1.0), (3.9, 0.42), (4.4, 0.1))

HIGHEST_ORDER = 64
# Resonances of exhaust and body: (frequency in Hz, decay to -60 dB in s, gain)
RESONANCES = ((92.0, 0.10, 1.1), (205.0, 0.07, 0.9), (470.0, 0.035, 0.5), (1150.0, 0.015, 0.35))


def engine(samplerate: int, rng: np.random.Generator, peak: float) -> Float32Array:
    """The engine, 4.4 s, float32 of shape (frames, 2), with its largest sample at `peak`."""
    time_s = times_s(DURATION_S, samplerate)
    load = curve(time_s, LOAD)

    doppler = 1.0 - 0.07 * np.tanh((time_s - PASS_S) / 0.35)
    # Noise below 9 Hz with a standard deviation near 1: no engine runs quite evenly.
    wander = band(rng.standard_normal(time_s.size), None, 9.0, samplerate)
    unsteady = 1.0 + 0.02 * (wander / np.std(wander)) * (1.2 - load)
    cycle_phase = phase_of(0.5 * curve(time_s, CRANK_HZ) * doppler * unsteady, samplerate)

    combustion = _orders(cycle_phase, rng) * (0.06 + load)
    roar = band(rng.standard_normal(time_s.size), 220.0, 3200.0, samplerate, order=1)
    combustion += 0.3 * roar * load * (0.35 + _pulses(cycle_phase, orders=8, sharpness=3))

    tone = 0.55 * combustion
    for frequency_hz, decay_s, gain in RESONANCES:
        # Pushed at its own frequency, a mode builds up to about d fs / 14 times the push.
        build_up = decay_s * samplerate / 14.0
        tone += gain / build_up * ring(combustion, frequency_hz, decay_s, samplerate)
    tone = np.tanh(1.4 * tone)
    tone += _starter(time_s, cycle_phase, samplerate, rng)

    placed = pan(tone * curve(time_s, DISTANCE_GAIN), curve(time_s, POSITION))
    placed = room(placed, samplerate, rng, decay_s=0.7, level=0.06)
    placed = band(placed, 28.0, None, samplerate)
    return finished(placed, samplerate, peak=peak, fade_in_s=0.02, fade_out_s=0.35)


def _orders(cycle_phase: FloatArray, rng: np.random.Generator) -> FloatArray:
    """The sum of the engine's orders, by repeated multiplication with one phasor (no sin each)."""
    phasor = np.exp(1j * cycle_phase)
    power = np.ones_like(phasor)
    total = np.zeros(cycle_phase.size)
    for order in range(1, HIGHEST_ORDER + 1):
        power *= phasor
        evenness = {1: 0.04, 2: 0.10, 4: 0.6, 8: 1.0}[math.gcd(order, 8)]
        weight = evenness * (order / 8.0) ** -0.9 * np.exp(2j * np.pi * rng.random())
        total += power.real * weight.real - power.imag * weight.imag
    return total


def _pulses(cycle_phase: FloatArray, *, orders: int, sharpness: int) -> FloatArray:
    """A train of `orders` pulses a cycle, each from 0 to 1; sharper with `sharpness`."""
    return (0.5 + 0.5 * np.cos(orders * cycle_phase)) ** sharpness


def _starter(
    time_s: FloatArray, cycle_phase: FloatArray, samplerate: int, rng: np.random.Generator
) -> FloatArray:
    """The starter motor: a whine that labours against each compression, and the chug of it."""
    on = curve(time_s, ((0.0, 0.0), (0.03, 1.0), (CATCH_S - 0.04, 1.0), (CATCH_S + 0.06, 0.0)))
    compression = _pulses(cycle_phase, orders=8, sharpness=2)
    whine_phase = phase_of(330.0 - 70.0 * compression, samplerate)
    whine = np.sin(whine_phase) + 0.5 * np.sin(2.0 * whine_phase) + 0.3 * np.sin(5.0 * whine_phase)
    chug = band(rng.standard_normal(time_s.size), 60.0, 700.0, samplerate, order=1)
    return on * (0.10 * whine * (0.5 + compression) + 0.9 * chug * compression**2)
