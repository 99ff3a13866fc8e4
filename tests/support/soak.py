"""The soaks of transform and identification: long runs whose records the bench shows."""

import gc
import sys
import time
from dataclasses import asdict

import numpy as np

from audioflinger_hook.transform import FloatArray, HapticTransform, TransformParameters
from audioflinger_hook.transform.design.synthesis import LiveGrid
from tests.support.memory import resident_bytes
from tests.support.random_rigs import SWEEP_S, found_of, identified
from tools import soak_record
from tools.bench.machine import cpu_model
from tools.bench.measures.vibration import sine_fit
from tools.bench.sounds.signals import SAMPLERATE, demo_sound, tone
from tools.records import now

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
