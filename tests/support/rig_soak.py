"""The rig's soak: 10^8 samples of a steady drive on each model, and whether energy creeps up."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np

from audioflinger_hook.transform import FloatArray
from device.rig import PAPER
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.co_energy import Energies, energies, linear_energies
from device.rig.equations import EXCURSION, SPEED, Equations
from device.rig.model_levels import ModelLevel
from device.rig.passive_step import PassiveStepper
from device.rig.step_maps import grid_of
from tests.support.co_energy import step_errors, stored_energy_j
from tools.bench.machine import cpu_model
from tools.bench.sounds.signals import SAMPLERATE
from tools.records import now
from tools.soak_record import (
    NO_CREEP,
    PASSIVE,
    PASSIVE_STEPPED,
    SAMPLES,
    STEPPED_SAMPLES,
    SoakRecord,
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


def soak_energy(level: ModelLevel, samples: int | None = None) -> SoakRecord:
    """What becomes of the energy of one model over so many samples; None: as the soak asks for.

    A bounded random drive of ten seconds in a loop, again and again: after the first loop each
    must reach the same largest energy. Then the drive stops, and the energy only falls.
    """
    wanted = samples or (STEPPED_SAMPLES if level is ModelLevel.STEPPED else SAMPLES)
    volts = steady_drive(min(LOOP_S, wanted / SAMPLERATE))
    errors: list[float] = []
    moved = _by_steps(_stepper(), errors) if level is ModelLevel.STEPPED else _by_adaptive(level)
    start_s = time.process_time()
    loops = SETTLED_LOOPS + -(-wanted // len(volts))
    peaks_j = np.array([moved(volts).max() for _ in range(loops)])[SETTLED_LOOPS:]
    creep = float(np.abs(peaks_j / peaks_j[0] - 1.0).max())
    rise = _largest_rise(moved(np.zeros(round(STILL_S * SAMPLERATE))), level)
    worst = max(errors, default=None)
    return SoakRecord(
        what=f"{level} model",
        date=now(),
        cpu=cpu_model(),
        stream_s=loops * len(volts) / SAMPLERATE,
        took_s=time.process_time() - start_s,
        passed=NO_CREEP.met(creep)
        and PASSIVE.met(rise)
        and (worst is None or PASSIVE_STEPPED.met(worst)),
        samples=loops * len(volts),
        energy_creep=creep,
        energy_rise=rise,
        energy_from_nowhere=worst,
    )


def steady_drive(duration_s: float) -> FloatArray:
    """Band noise that goes on from its end at its beginning, (frames,), V."""
    frames = round(duration_s * SAMPLERATE)
    frequencies_hz = np.fft.rfftfreq(frames, 1.0 / SAMPLERATE)
    inside = (frequencies_hz >= BAND_HZ[0]) & (frequencies_hz <= BAND_HZ[1])
    turns = np.random.default_rng(21).random(len(frequencies_hz))
    noise = np.fft.irfft(inside * np.exp(2j * math.pi * turns), frames)
    return np.asarray(LEVEL_V * noise / np.sqrt(np.mean(noise * noise)))


def _largest_rise(stored_j: FloatArray, level: ModelLevel) -> float:
    """After a drive's end, from node to node: the largest rise, of the energy before it.

    Between its nodes the non-linear model gives curves through them, which have no energy to keep.
    Until the first node the voltage still falls to 0.
    """
    spacing = grid_of(SAMPLERATE).widest if level is ModelLevel.NONLINEAR else 1
    nodes_j = stored_j[spacing - 1 :: spacing]
    before, after = nodes_j[:-1], nodes_j[1:]
    moving = before > STILL * nodes_j[0]
    return max(0.0, float((after[moving] / before[moving]).max() - 1.0))


def _by_adaptive(level: ModelLevel) -> Energy:
    e = _energies(level)
    adaptive = AdaptiveActuator(PAPER, SAMPLERATE, level=level)

    def moved(volts: FloatArray) -> FloatArray:
        motion = adaptive.move(volts, ("displacement_m", "velocity_m_s", "current_a"))
        stored_j = stored_energy_j(e, motion.displacement_m, motion.current_a)
        return stored_j + _kinetic_j(motion.velocity_m_s)

    return moved


def _by_steps(stepper: PassiveStepper, errors: list[float]) -> Energy:
    """As `Energy`; the worst energy-balance error of each call is added to the errors."""
    equations, e = stepper.equations, stepper.equations.energies
    last_v, last_state = 0.0, np.zeros((7, 1))

    def moved(volts: FloatArray) -> FloatArray:
        nonlocal last_v, last_state
        states = stepper.move(volts, last_v)
        whole = np.concatenate([last_state, states], axis=1)
        from_v = np.concatenate([[last_v], volts])
        errors.append(float(step_errors(equations, stepper.step_s, whole, from_v).max()))
        last_v, last_state = float(volts[-1]), states[:, -1:]
        return stored_energy_j(e, states[EXCURSION], states[5]) + _kinetic_j(states[SPEED])

    return moved


def _stepper() -> PassiveStepper:
    return PassiveStepper(
        Equations(PAPER.actuator, _energies(ModelLevel.STEPPED)), 1.0 / SAMPLERATE
    )


def _energies(level: ModelLevel) -> Energies:
    p = PAPER.actuator
    return linear_energies(p) if level is ModelLevel.LINEAR else energies(p, PAPER.large_signal)


def _kinetic_j(speed_m_s: FloatArray) -> FloatArray:
    return np.asarray(0.5 * PAPER.actuator.moving_mass_kg * speed_m_s * speed_m_s)
