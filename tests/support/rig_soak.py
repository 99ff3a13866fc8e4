"""The rig's soak: 10^8 samples of a steady drive on each model, and whether energy creeps up."""

import math
import time
from collections.abc import Callable

import numpy as np

from audioflinger_hook.transform import FloatArray
from device.rig import PAPER
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.co_energy import Energies, energies
from device.rig.parameters import Model
from tools.bench.machine import cpu_model
from tools.bench.sounds.signals import SAMPLERATE
from tools.records import now
from tools.soak_record import NO_CREEP, PASSIVE, SAMPLES, SoakRecord

LOOP_S = 10.0
SETTLED_LOOPS = 1
"""The rig forgets within tenths of a second."""
BAND_HZ = (10.0, 400.0)
LEVEL_V = 10.0
"""Root mean square: it drives the `paper` rig to about Xmax and not into the stops."""
STILL_S = 1.0
STILL = 1e-12
"""Of the energy at the drive's end: below it the motion has died away."""

Energy = Callable[[FloatArray], FloatArray]
"""Moves on by some volts, (frames,), and gives the stored energy at each sample, J."""


def soak_energy(model: Model, samples: int = SAMPLES) -> SoakRecord:
    """What becomes of the energy of one model over so many samples: each loop of a random drive
    must reach the same largest energy, and after the drive it only falls."""
    volts = steady_drive(min(LOOP_S, samples / SAMPLERATE))
    moved, start_s = energy_of(model), time.process_time()
    loops = SETTLED_LOOPS + -(-samples // len(volts))
    peaks_j = np.array([moved(volts).max() for _ in range(loops)])[SETTLED_LOOPS:]
    creep = float(np.abs(peaks_j / peaks_j[0] - 1.0).max())
    rise = largest_rise(moved(np.zeros(round(STILL_S * SAMPLERATE))))
    return SoakRecord(
        what="linear model" if model == "linear" else "non-linear model",
        date=now(),
        cpu=cpu_model(),
        stream_s=loops * len(volts) / SAMPLERATE,
        took_s=time.process_time() - start_s,
        passed=NO_CREEP.met(creep) and PASSIVE.met(rise),
        samples=loops * len(volts),
        energy_creep=creep,
        energy_rise=rise,
    )


def steady_drive(duration_s: float) -> FloatArray:
    """Band noise that goes on from its end at its beginning, (frames,), V."""
    frames = round(duration_s * SAMPLERATE)
    frequencies_hz = np.fft.rfftfreq(frames, 1.0 / SAMPLERATE)
    inside = (frequencies_hz >= BAND_HZ[0]) & (frequencies_hz <= BAND_HZ[1])
    turns = np.random.default_rng(21).random(len(frequencies_hz))
    noise = np.fft.irfft(inside * np.exp(2j * math.pi * turns), frames)
    return np.asarray(LEVEL_V * noise / np.sqrt(np.mean(noise * noise)))


def largest_rise(stored_j: FloatArray) -> float:
    """Return the largest rise from sample to sample after a drive, of the energy before it."""
    before, after = stored_j[:-1], stored_j[1:]
    moving = before > STILL * stored_j[0]
    return max(0.0, float((after[moving] / before[moving]).max() - 1.0))


def stored_energy_j(e: Energies, x: FloatArray, i: FloatArray) -> FloatArray:
    """Return the energy in spring, stops and field, J: V + i dW'/di - W' = V + L i^2 / 2."""
    field_j = e.inductance(x)[0] * i * i / 2.0
    return np.asarray(e.spring(x)[0] + e.stops(x)[0] + field_j)


def energy_of(model: Model) -> Energy:
    p = PAPER.actuator
    e = energies(p, None if model == "linear" else PAPER.large_signal)
    actuator = AdaptiveActuator(PAPER, SAMPLERATE, model=model)

    def moved(volts: FloatArray) -> FloatArray:
        motion = actuator.move(volts, ("displacement_m", "velocity_m_s", "current_a"))
        speed_m_s = motion.velocity_m_s
        stored_j = stored_energy_j(e, motion.displacement_m, motion.current_a)
        return np.asarray(stored_j + 0.5 * p.moving_mass_kg * speed_m_s * speed_m_s)

    return moved
