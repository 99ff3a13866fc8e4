"""A synthesised V8 engine, which starts, idles, accelerates and passes from left to right.

The frequencies of an engine's sound are multiples ("orders") of the frequency of its working cycle,
which is two revolutions of the crankshaft. Eight cylinders fire in each cycle, so the orders 8,
16 and so on are loud. Uneven firing of the two cylinder banks produces the other orders.
"""

from __future__ import annotations  # numpy.random takes memory

import math

import numpy as np

from audioflinger_hook.scenes.shaping import band, curve, finished, pan, phase, ring, room, times_s
from device.units import Float32Array, FloatArray

DURATION_S = 4.4

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
    time_s = times_s(DURATION_S, samplerate)
    load = curve(time_s, LOAD)

    doppler = 1.0 - 0.07 * np.tanh((time_s - PASS_S) / 0.35)
    # Noise below 9 Hz modulates the speed of rotation.
    wander = band(rng.standard_normal(time_s.size), None, 9.0, samplerate)
    unsteady = 1.0 + 0.02 * (wander / np.std(wander)) * (1.2 - load)
    cycle_phase = phase(0.5 * curve(time_s, CRANK_HZ) * doppler * unsteady, samplerate)

    combustion = _orders(cycle_phase, rng) * (0.06 + load)
    roar = band(rng.standard_normal(time_s.size), 220.0, 3200.0, samplerate, order=1)
    combustion += 0.3 * roar * load * (0.35 + _pulses(cycle_phase, orders=8, sharpness=3))

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


def _pulses(cycle_phase: FloatArray, *, orders: int, sharpness: int) -> FloatArray:
    """Return a train of `orders` pulses per cycle with values from 0 to 1."""
    return (0.5 + 0.5 * np.cos(orders * cycle_phase)) ** sharpness


def _starter(
    time_s: FloatArray, cycle_phase: FloatArray, samplerate: int, rng: np.random.Generator
) -> FloatArray:
    """Return the starter motor's sound: a tone, lower at each compression, and noise pulses."""
    on = curve(time_s, ((0.0, 0.0), (0.03, 1.0), (CATCH_S - 0.04, 1.0), (CATCH_S + 0.06, 0.0)))
    compression = _pulses(cycle_phase, orders=8, sharpness=2)
    whine_phase = phase(330.0 - 70.0 * compression, samplerate)
    whine = np.sin(whine_phase) + 0.5 * np.sin(2.0 * whine_phase) + 0.3 * np.sin(5.0 * whine_phase)
    chug = band(rng.standard_normal(time_s.size), 60.0, 700.0, samplerate, order=1)
    return on * (0.10 * whine * (0.5 + compression) + 0.9 * chug * compression**2)
