"""Bench on the simulated rig: how fast its linear rung is, and how far from the exact solution."""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy.signal import lsim

from audioflinger_hook.transform import FloatArray
from device.rig import PAPER, ActuatorParameters
from device.rig.actuator import LinearActuator, Quantity
from device.rig.simulated_rig import SimulatedRig
from tools.bench.cost import in_ffts, interleaved
from tools.bench.report import Must, Row, Section
from tools.bench.sounds.signals import SAMPLERATE
from tools.bench.workbench import Workbench

REAL_TIME = Must(">=", 2_000.0)
REAL_TIME_FFTS = Must("<=", in_ffts(1.0 / REAL_TIME.bound))
ERROR = Must("<=", 1e-4)

DRIVE_HZ = (20.0, 46.6, 92.0, 128.2, 140.9, 182.0, 220.0)
"""From the bottom to the top of the vibration band, the paper's five between them."""
DRIVE_V = 0.3
ERROR_S = 2.0
BLOCKSIZES = (256, 32_768)
REPEATS = 5

QUANTITIES: tuple[tuple[Quantity, str], ...] = (
    ("displacement_m", "displacement"),
    ("current_a", "current"),
    ("acceleration_m_s2", "acceleration"),
)


def linear_model(bench: Workbench) -> Section:
    """Speed and error of the linear electro-mechanical rung of the rig."""
    duration_s = bench.effort.rig_s
    volts = drive(duration_s)
    vibration = volts[:, None] / max(1.0, float(np.abs(volts).max()))
    actuator, twin = LinearActuator(PAPER.actuator, SAMPLERATE), SimulatedRig(PAPER, SAMPLERATE, 1)
    works = [partial(_move, actuator, volts, blocksize) for blocksize in BLOCKSIZES]
    works += [partial(_write, twin, vibration, blocksize) for blocksize in BLOCKSIZES]
    timings = interleaved(works, REPEATS)
    rows = []
    names = [f"the actuator, blocks of {b}" for b in BLOCKSIZES]
    names += [f"the whole rig, blocks of {b}" for b in BLOCKSIZES]
    for index, (name, timing) in enumerate(zip(names, timings, strict=True)):
        limited = index == len(BLOCKSIZES) - 1
        must, must_ffts = (REAL_TIME, REAL_TIME_FFTS) if limited else (None, None)
        speed, ffts_column = duration_s / timing.median_s, "a second, FFTs"
        rows.append(Row(name, speed, "", "x real time", must, ffts_column=ffts_column))
        rows.append(Row(name, timing.median_units / duration_s, "FFTs", ffts_column, must_ffts))
    rows += _error_rows()
    return Section(
        "The simulated rig",
        "The linear rung of the simulated actuator: how many seconds of signal it computes in a "
        "second of CPU time at 48 kHz, what a second of signal costs in FFTs, and the largest "
        "difference from the exact motion, as a share of its peak. The whole rig is DAC, "
        f"amplifier, actuator and its peaks. Drive: {len(DRIVE_HZ)} sinusoids over the vibration "
        "band, from rest. `lsim` takes straight lines between the same samples, so what differs "
        "there is arithmetic; the exact motion has the true sinusoids between them.",
        tuple(rows),
    )


def _move(actuator: LinearActuator, volts: FloatArray, blocksize: int) -> None:
    actuator.reset()
    for first in range(0, volts.size, blocksize):
        actuator.move(volts[first : first + blocksize], ("displacement_m", "acceleration_m_s2"))


def _write(twin: SimulatedRig, vibration: FloatArray, blocksize: int) -> None:
    twin.reset()
    for first in range(0, len(vibration), blocksize):
        twin.write(vibration[first : first + blocksize])


def _error_rows() -> list[Row]:
    volts = drive(ERROR_S)
    motion = LinearActuator(PAPER.actuator, SAMPLERATE).move(volts)
    held, exact = _lsim_motion(volts), exact_motion(volts.size)
    rows = []
    for quantity, name in QUANTITIES:
        moved = getattr(motion, quantity)
        peak = np.abs(exact[quantity]).max()
        for column, other in (("scipy.signal.lsim", held), ("exact", exact)):
            error = float(np.abs(moved - other[quantity]).max() / peak)
            rows.append(Row(f"error of {name}", error, "", f"against {column}", ERROR))
    return rows


def drive(duration_s: float) -> FloatArray:
    """Return the drive voltage, (frames,): sinusoids that start at 0."""
    time_s = np.arange(round(duration_s * SAMPLERATE)) / SAMPLERATE
    volts = np.zeros(time_s.size)
    for frequency_hz in DRIVE_HZ:
        volts += DRIVE_V * np.sin(2.0 * np.pi * frequency_hz * time_s)
    return volts


def state_space(p: ActuatorParameters) -> tuple[FloatArray, FloatArray]:
    """Return s' = A s + B v with s = (x, x', i), written from the equations of motion.

    On purpose not the actuator's own matrices: both can be wrong only separately.
    """
    m, c, k = p.moving_mass_kg, p.damping_n_s_per_m, p.stiffness_n_per_m
    bl, r, inductance = p.force_factor_n_per_a, p.resistance_ohm, p.inductance_h
    rate = np.array(
        [
            [0.0, 1.0, 0.0],
            [-k / m, -c / m, bl / m],
            [0.0, -bl / inductance, -r / inductance],
        ]
    )
    return rate, np.array([0.0, 0.0, 1.0 / inductance])


def _quantities(states: FloatArray, rate: FloatArray) -> dict[str, FloatArray]:
    """Return displacement, current and acceleration of states (frames, 3)."""
    return {
        "displacement_m": states[:, 0],
        "current_a": states[:, 2],
        "acceleration_m_s2": states @ rate[1],
    }


def _lsim_motion(volts: FloatArray) -> dict[str, FloatArray]:
    """Return the motion by scipy.signal.lsim, the voltage straight between the samples."""
    rate, into = state_space(PAPER.actuator)
    system = (rate, into[:, None], np.eye(3), np.zeros((3, 1)))
    time_s = np.arange(volts.size) / SAMPLERATE
    _, _, states = lsim(system, volts, time_s, interp=True)
    return _quantities(states, rate)


def exact_motion(frames: int) -> dict[str, FloatArray]:
    """Return the motion for the true sinusoids, in closed form.

    For v = sin(w t) from rest: s = Im[c e^(jwt) - e^(At) c] with c = (jw - A)^-1 B, and e^(At)
    from the eigenvectors of A.
    """
    rate, into = state_space(PAPER.actuator)
    time_s = np.arange(frames) / SAMPLERATE
    poles, modes = np.linalg.eig(rate)
    decay = np.exp(np.outer(time_s, poles))
    states = np.zeros((frames, 3))
    for frequency_hz in DRIVE_HZ:
        jw = 2j * np.pi * frequency_hz
        steady = np.linalg.solve(jw * np.eye(3) - rate, into)
        # e^(At) is real, so the imaginary part of e^(At) c is e^(At) of that of c.
        start = np.linalg.solve(modes, steady.imag.astype(complex))
        transient = (decay * start) @ modes.T
        wave = np.outer(np.exp(jw * time_s), steady)
        states += DRIVE_V * (wave.imag - transient.real)
    return _quantities(states, rate)
