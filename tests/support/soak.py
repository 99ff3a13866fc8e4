"""Soaks of transform, identification and rig: long runs whose records the bench shows."""

import gc
import math
import sys
import time
from collections.abc import Callable
from dataclasses import asdict

import numpy as np

from audioflinger_hook.transform import FloatArray, HapticTransform, TransformParameters
from audioflinger_hook.transform.design.synthesis import LiveGrid
from device.rig import PAPER
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.co_energy import Energies, energies
from device.rig.parameters import Model
from tests.support.costs import resident_bytes
from tests.support.random_rigs import SWEEP_S, found_of, identified
from tools import soak_record
from tools.bench.machine import cpu_model
from tools.bench.measures.vibration import sine_fit
from tools.bench.sounds.signals import SAMPLERATE, demo_sound, tone
from tools.records import now
from tools.soak_record import NO_CREEP, PASSIVE, SAMPLES, SoakRecord

BLOCKSIZE, WARM_LOOPS = 4_096, 2
TONE_HZ = 440.0
"""A whole number of cycles a second: one second in a loop is a tone without end."""
TONE_AMPLITUDE = 0.3
SETTLED_AFTER_S = 2
WATCHED_S = 5


def soak_scene(hops: int = soak_record.HOPS) -> soak_record.SoakRecord:
    """Return what `hops` hops of the demo scene in a loop leave behind in memory.

    Whole loops of whole blocks, so that both readings come at the same place of the sound.
    """
    hop_frames = LiveGrid.at(TransformParameters(), SAMPLERATE).hop_frames
    start_s, transform, sound = time.process_time(), HapticTransform(SAMPLERATE, 2), demo_sound()
    blocks = np.split(sound, range(BLOCKSIZE, len(sound), BLOCKSIZE))[:-1]
    loop_frames = len(blocks) * BLOCKSIZE
    loops, held = -(-hops * hop_frames // loop_frames), []
    for times in (WARM_LOOPS, loops):
        for _ in range(times):
            for block in blocks:
                transform.process(block)
        gc.collect()
        held.append((resident_bytes(), sys.getallocatedblocks()))
    resident, objects = (after - before for before, after in zip(*held, strict=True))
    return soak_record.SoakRecord(
        what="demo scene in a loop",
        date=now(),
        cpu=cpu_model(),
        hops=loops * loop_frames // hop_frames,
        stream_s=loops * loop_frames / SAMPLERATE,
        took_s=time.process_time() - start_s,
        passed=soak_record.NO_GROWTH_KB.met(resident / 1024.0)
        and soak_record.NO_GROWTH_OBJECTS.met(objects),
        memory_growth_kb=resident / 1024.0,
        objects_left=objects,
    )


def soak_tone(hops: int = soak_record.HOPS) -> soak_record.SoakRecord:
    """Return how far a steady tone drifts in level and purity over `hops` hops."""
    hop_frames = LiveGrid.at(TransformParameters(), SAMPLERATE).hop_frames
    second = tone(TONE_HZ, TONE_AMPLITUDE, 1.0)[:, None]
    seconds = max(SETTLED_AFTER_S + 2 * WATCHED_S, -(-hops * hop_frames // SAMPLERATE))
    start_s = time.process_time()
    transform = HapticTransform(SAMPLERATE, 1)
    watched: list[FloatArray] = []
    for index in range(seconds):
        vibration = transform.process(second)[:, 0]
        at_start = SETTLED_AFTER_S <= index < SETTLED_AFTER_S + WATCHED_S
        if at_start or index >= seconds - WATCHED_S:
            watched.append(vibration)
    ends = np.concatenate(watched).reshape(2, -1)
    first, last = (sine_fit(end, SAMPLERATE) for end in ends)
    drift_db = abs(20.0 * float(np.log10(last.amplitude / first.amplitude)))
    return soak_record.SoakRecord(
        what=f"steady tone of {TONE_HZ:g} Hz",
        date=now(),
        cpu=cpu_model(),
        hops=seconds * SAMPLERATE // hop_frames,
        stream_s=float(seconds),
        took_s=time.process_time() - start_s,
        passed=soak_record.NO_DRIFT_DB.met(drift_db) and soak_record.PURITY.met(last.residual_db),
        level_drift_db=drift_db,
        thdn_start_db=first.residual_db,
        thdn_end_db=last.residual_db,
    )


def soak_identification(share: float, rigs: int = soak_record.RIGS) -> soak_record.SoakRecord:
    """What is found of many random rigs by sweeps of that share of Xmax."""
    start_s = time.process_time()
    found = found_of([identified(seed, share) for seed in range(rigs)])
    return soak_record.SoakRecord(
        what=f"sweeps at {share:g} Xmax",
        date=now(),
        cpu=cpu_model(),
        stream_s=rigs * SWEEP_S,
        took_s=time.process_time() - start_s,
        passed=found.passed,
        rigs=rigs,
        **asdict(found),
    )


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
