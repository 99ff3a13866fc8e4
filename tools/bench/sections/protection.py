"""Sections on protection of the actuator: excursions with and without protection, and CPU time."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from audioflinger_hook.transform import FloatArray
from device.drive.damping import choose_damping
from device.drive.protection.design import BLOCK_S
from device.rig import PAPER
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.electronics import Amplifier
from device.rig.parameters import Model, SeatParameters, vary
from device.units import amplitude_to_db
from tools.bench.cost import in_ffts, interleaved
from tools.bench.report import Must, Row, Section
from tools.bench.sounds.signals import SAMPLERATE
from tools.bench.workbench import Workbench
from tools.rig_driver import RigDriver

LOUD = replace(PAPER, amplifier=replace(PAPER.amplifier, gain=20.0, current_limit_a=math.inf))

XMAX = Must("<=", 1.0)
NON_LINEAR = Must("<=", 1.1)
BLOCK_US = Must("<=", 125.0)
BLOCK_FFTS = Must("<=", in_ffts(1e-6 * BLOCK_US.bound))
MASS, F0_SQUARED, FORCE_FACTOR = (0.9, 1.1), (0.81, 0.9, 1.0, 1.1, 1.21), (0.9, 1.1)
"""Factors of moving mass, stiffness and Bl, in all combinations."""
ENDS = (0.81, 1.21)  # factors of stiffness for the non-linear model
FREE = SeatParameters(mass_kg=0.57, stiffness_n_per_m=100.0, damping_n_s_per_m=0.0)
SEATS = (None, LOUD.seat, FREE)
BLOCKSIZE = 256
COST_S = 2.0
REPEATS = 5


def protection(_bench: Workbench) -> Section:
    """Measure excursions with and without protection, and the level of the protected signal."""
    rows = []
    for name, drive in drives().items():
        protector = RigDriver(LOUD, SAMPLERATE)
        tail = np.zeros(protector.latency_frames + SAMPLERATE // 10)
        out = protector.process(np.concatenate([drive, tail])[:, None])[:, 0].astype(np.float64)
        without = _excursion(drive)
        fixed = min(1.0 / without, 1.0 / max(1.0, float(np.abs(drive).max())))
        kept = math.sqrt(np.sum(out**2) / np.sum((fixed * drive) ** 2))
        rows += [
            Row(name, without, "Xmax", "without"),
            Row(name, _excursion(out), "Xmax", "governed", XMAX),
            Row(name, _excursion(out, linear=False), "Xmax", "non-linear model", NON_LINEAR),
            Row(name, amplitude_to_db(kept), "dB", "drive kept"),
        ]
    return Section(
        "Protection ahead of time",
        "The true rig deviates from the rig file that protection uses. The table shows the largest "
        "simulated excursion over all combinations of deviations, relative to Xmax, the excursion "
        "limit. Moving mass and Bl are 10 % lower or higher. The stiffness is 19 % lower to 21 % "
        "higher (f0 ±10 %). The frame is fixed, is on the rig's seat, or is a free board of 0.57 "
        "kg. The amplifier's voltage at full scale is 20 V. The columns *without* and *governed* "
        "are for the linear model without and with protection. The column *non-linear model* is "
        "with protection, for a rig whose spring becomes stiffer with excursion. The column *drive "
        "kept* shows the r.m.s. of the protected drive signal. This value is relative to the "
        "r.m.s. of the drive signal with a constant gain. This gain is the largest that keeps all "
        "excursions under Xmax, and the drive signal within full scale.",
        tuple(rows),
    )


def live_cost(bench: Workbench) -> Section:
    """Measure the CPU time of damping and of protection."""
    duration_s = min(COST_S, bench.effort.rig_timed_s)
    time_s = np.arange(round(duration_s * SAMPLERATE)) / SAMPLERATE
    tone = np.sin(2.0 * np.pi * 86.0 * time_s)
    damping = choose_damping(PAPER.actuator)[0].damping
    cases: list[tuple[str, int, RigDriver]] = []
    for channels in (1, 2):
        cases += [
            ("damping", channels, RigDriver(PAPER, SAMPLERATE, channels, damping=damping)),
            ("protection, nothing in reach", channels, RigDriver(PAPER, SAMPLERATE, channels)),
            ("protection, limiting", channels, RigDriver(LOUD, SAMPLERATE, channels)),
        ]
    works = [
        partial(_stream, processor, np.repeat(0.9 * tone[:, None], channels, axis=1))
        for _, channels, processor in cases
    ]
    rows = []
    for (name, channels, _), timing in zip(cases, interleaved(works, REPEATS), strict=True):
        of = f"{channels} channel" + "s" * (channels > 1)
        blocks, block = duration_s / BLOCK_S, f"a {1e3 * BLOCK_S:g} ms"
        limited = name.startswith("protection") and channels == 1
        us, ffts = (BLOCK_US, BLOCK_FFTS) if limited else (None, None)
        took_us, ffts_column = 1e6 * timing.median_s / blocks, f"{of}, FFTs {block}"
        rows += [
            Row(name, took_us, "µs", f"{of}, µs {block}", us, ffts_column=ffts_column),
            Row(name, timing.median_units / blocks, "FFTs", ffts_column, ffts),
        ]
    return Section(
        "Damping, protection and exposure live",
        "The table shows the CPU time of one thread for 2 ms of drive signal at 48 kHz, in blocks "
        f"of {BLOCKSIZE} frames. The drive signal is a tone of 86 Hz. Values are medians of "
        f"{REPEATS} interleaved repeats.",
        tuple(rows),
    )


def drives() -> dict[str, FloatArray]:
    """Return drive signals of 1 s, (frames,), by name."""
    time_s = np.arange(SAMPLERATE) / SAMPLERATE
    phase = 2.0 * np.pi * time_s
    rng = np.random.default_rng(0)
    music = sum(
        np.sin(frequency_hz * phase) * (np.sin(beat_hz * phase) > 0.3)
        for frequency_hz, beat_hz in zip(
            rng.uniform(30.0, 200.0, 5), rng.uniform(1.0, 6.0, 5), strict=True
        )
    )
    return {
        "a tone at 86 Hz": np.sin(86.0 * phase),
        "bursts at 88 Hz": np.where(time_s % 0.1 < 0.03, np.sin(88.0 * phase), 0.0),
        "a square wave at 85 Hz": np.sign(np.sin(85.0 * phase)),
        "a square wave at 30 Hz": np.sign(np.sin(30.0 * phase)),
        "a tone three times full scale": 3.0 * np.sin(85.0 * phase),
        "five tones that come and go": np.asarray(music),
    }


def _excursion(drive: FloatArray, *, linear: bool = True) -> float:
    """Return the largest excursion for all deviations from the rig file, relative to Xmax."""
    unlimited = replace(LOUD.amplifier, output_limit_v=1e9)
    volts = Amplifier(unlimited, SAMPLERATE).drive(LOUD.dac.full_scale_v * drive)
    which: Model = "linear" if linear else "nonlinear"
    largest = 0.0
    for factors in product(MASS, F0_SQUARED if linear else ENDS, FORCE_FACTOR):
        for seat in SEATS:
            true = replace(LOUD, actuator=vary(LOUD.actuator, *factors), seat=seat)
            model = AdaptiveActuator(true, SAMPLERATE, model=which, seat=seat is not None)
            motion = model.move(volts, ("displacement_m",))
            largest = max(largest, float(np.abs(motion.displacement_m).max()))
    return largest / LOUD.actuator.x_max_m


def _stream(processor: RigDriver, vibration: FloatArray) -> None:
    processor.reset()
    block = np.empty((BLOCKSIZE, vibration.shape[1]))
    for first in range(0, len(vibration) - BLOCKSIZE + 1, BLOCKSIZE):
        block[:] = vibration[first : first + BLOCKSIZE]
        processor.process(block)
