"""Section on the simulated rig: how fast its linear model is, and how far from the exact motion."""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy.signal import lsim

from audioflinger_hook.transform import FloatArray
from device.rig import PAPER, ActuatorParameters
from device.rig.actuator import LinearActuator, Quantity
from device.rig.simulated_rig import SimulatedRig
from tools.bench.cost import in_ffts, interleaved
from tools.bench.report import Must, Row, Section, line
from tools.bench.sounds.signals import SAMPLERATE
from tools.bench.workbench import Workbench

REAL_TIME = Must(">=", 2_000.0)
ERROR = Must("<=", 1e-4)

DRIVE_HZ = (20.0, 46.6, 92.0, 128.2, 140.9, 182.0, 220.0)
"""From the bottom to the top of the vibration band, with the paper's five in between."""
DRIVE_V = 0.3
ERROR_S = 2.0
BLOCKSIZES = (256, 32_768)
REPEATS = 5
QUANTITIES: dict[Quantity, str] = {
    "displacement_m": "displacement",
    "current_a": "current",
    "acceleration_m_s2": "acceleration",
}


def linear_model(bench: Workbench) -> Section:
    """Speed and error of the linear model of the rig."""
    duration_s = bench.effort.rig_s
    volts = drive(duration_s)
    vibration = volts[:, None] / max(1.0, float(np.abs(volts).max()))
    actuator, whole = LinearActuator(PAPER.actuator, SAMPLERATE), SimulatedRig(PAPER, SAMPLERATE, 1)
    works = {f"the actuator, blocks of {b}": partial(_move, actuator, volts, b) for b in BLOCKSIZES}
    for b in BLOCKSIZES:
        works[f"the whole rig, blocks of {b}"] = partial(_write, whole, vibration, b)
    limited = f"the actuator, blocks of {BLOCKSIZES[-1]}"
    rows = []
    for name, timing in zip(works, interleaved(list(works.values()), REPEATS), strict=True):
        must, must_ffts = None, None
        if name == limited:
            must, must_ffts = REAL_TIME, Must("<=", in_ffts(1.0 / REAL_TIME.bound))
        speed, ffts = duration_s / timing.median_s, "a second, FFTs"
        rows.append(Row(name, speed, "", "x real time", must, ffts_column=ffts))
        rows.append(Row(name, timing.median_units / duration_s, "FFTs", ffts, must_ffts))
    return Section(
        "The simulated rig",
        "Seconds of signal that the linear model of the actuator computes in a second of CPU time "
        "at 48 kHz, the cost of a second of signal in FFTs, and the largest difference from the "
        "exact motion as a share of its peak. The whole rig has DAC, amplifier, actuator and peak "
        f"meters. The drive is {len(DRIVE_HZ)} sinusoids over the vibration band, from rest. "
        "`lsim` interpolates linearly between the same samples, so it differs by rounding; the "
        "exact motion is driven by the true sinusoids.",
        (*rows, *_error_rows()),
    )


def _move(actuator: LinearActuator, volts: FloatArray, blocksize: int) -> None:
    actuator.reset()
    for first in range(0, volts.size, blocksize):
        actuator.move(volts[first : first + blocksize], ("displacement_m", "acceleration_m_s2"))


def _write(rig: SimulatedRig, vibration: FloatArray, blocksize: int) -> None:
    rig.reset()
    for first in range(0, len(vibration), blocksize):
        rig.write(vibration[first : first + blocksize])


def _error_rows() -> list[Row]:
    volts = drive(ERROR_S)
    motion = LinearActuator(PAPER.actuator, SAMPLERATE).move(volts)
    held, exact = _lsim_motion(volts), exact_motion(volts.size)
    rows: list[Row] = []
    for quantity, name in QUANTITIES.items():
        moved = getattr(motion, quantity)
        peak = np.abs(exact[quantity]).max()
        errors: dict[str, float | None] = {
            f"against {column}": float(np.abs(moved - other[quantity]).max() / peak)
            for column, other in (("exact", exact), ("scipy.signal.lsim", held))
        }
        rows += line(f"error of {name}", errors, "", ERROR)
    return rows


def drive(duration_s: float, level_v: float = DRIVE_V) -> FloatArray:
    """Return the drive voltage at 48 kHz, (frames,): sinusoids that start at 0."""
    turns = 2.0 * np.pi * np.arange(round(duration_s * SAMPLERATE)) / SAMPLERATE
    return np.asarray(level_v * np.sum([np.sin(hz * turns) for hz in DRIVE_HZ], axis=0))


def state_space(p: ActuatorParameters) -> tuple[FloatArray, FloatArray]:
    """Return s' = A s + B v with s = (x, x', i), written from the equations of motion.

    These are not the actuator's own matrices, so that a mistake there shows here.
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


def lsim_states(p: ActuatorParameters, volts: FloatArray) -> FloatArray:
    """Return (frames, 3) states by scipy.signal.lsim, the voltage linear between samples."""
    rate, into = state_space(p)
    system = (rate, into[:, None], np.eye(3), np.zeros((3, 1)))
    return np.asarray(lsim(system, volts, np.arange(volts.size) / SAMPLERATE, interp=True)[2])


def _quantities(states: FloatArray, rate: FloatArray) -> dict[str, FloatArray]:
    """Return displacement, current and acceleration of states (frames, 3)."""
    return {
        "displacement_m": states[:, 0],
        "current_a": states[:, 2],
        "acceleration_m_s2": states @ rate[1],
    }


def _lsim_motion(volts: FloatArray) -> dict[str, FloatArray]:
    return _quantities(lsim_states(PAPER.actuator, volts), state_space(PAPER.actuator)[0])


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
