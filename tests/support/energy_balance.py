"""The energy-balance error of the simulated rig: energy let in, less heat, less what is stored."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.transform import FloatArray
from device.rig import PAPER
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.co_energy import Energies, energies
from device.rig.equations import Equations
from device.rig.model_levels import ModelLevel
from device.rig.passive_step import PassiveStepper
from device.rig.step_maps import grid_of
from tests.support.co_energy import step_errors, stored_energy_j
from tools.bench.sounds.signals import SAMPLERATE

NOISE_V = 60.0
STEPS = 2_000
FINE = 4
"""Points on each of the voltage's straight lines at 48 kHz, for Simpson's rule between nodes."""
LEAST = 1e-6
"""Of the largest energy: where less is handled in a step, rounding is all there is."""


def worst_step_of_noise() -> float:
    """Return the energy-balance error of the step by step model on white noise."""
    p = PAPER.actuator
    equations = Equations(p, energies(p, PAPER.large_signal))
    volts = NOISE_V * np.random.default_rng(12).standard_normal(STEPS)
    states = PassiveStepper(equations, 1.0 / SAMPLERATE).move(volts, 0.0)
    states = np.concatenate([np.zeros((7, 1)), states], axis=1)
    volts = np.concatenate([[0.0], volts])
    return float(step_errors(equations, 1.0 / SAMPLERATE, states, volts).max())


def worst_step(volts: FloatArray, step_tolerance: float | None = None) -> float:
    """The non-linear rung's worst step from node to node, as a share of the energy.

    Of that stored before or after the step or let in: the largest one counts. volts: (frames,) at
    48 kHz.
    """
    p, e = PAPER.actuator, energies(PAPER.actuator, PAPER.large_signal)
    samplerate = SAMPLERATE * FINE
    lines = np.interp(
        np.arange(1, len(volts) * FINE + 1) / FINE,
        np.arange(len(volts) + 1),
        np.concatenate([[0.0], volts]),
    )
    motion = AdaptiveActuator(
        PAPER, samplerate, level=ModelLevel.NONLINEAR, step_tolerance=step_tolerance
    ).move(lines)
    x, w, i = motion.displacement_m, motion.velocity_m_s, motion.current_a
    stored_j = stored_energy_j(e, x, i) + 0.5 * p.moving_mass_kg * w * w
    let_in_w = lines * i
    # The first sample comes after the first node, at rest.
    spacing = grid_of(samplerate).widest
    nodes = np.arange(spacing - 1, len(lines), spacing)
    handled_j = np.maximum(stored_j[nodes[:-1]], stored_j[nodes[1:]])
    handled_j = np.maximum(handled_j, _over_steps(np.abs(let_in_w), nodes, samplerate))
    kept_j = _over_steps(let_in_w - _heat_w(e, x, w, i), nodes, samplerate)
    surplus_j = np.abs(kept_j - np.diff(stored_j[nodes]))
    some = handled_j > LEAST * stored_j.max()
    return float((surplus_j[some] / handled_j[some]).max())


def _heat_w(e: Energies, x: FloatArray, w: FloatArray, i: FloatArray) -> FloatArray:
    p = PAPER.actuator
    drag = p.damping_n_s_per_m + e.stop_loss_s_per_m * np.abs(e.stops.jet(x)[1])
    return np.asarray(p.resistance_ohm * i * i + drag * w * w)


def _over_steps(power_w: FloatArray, nodes: NDArray[np.intp], samplerate: int) -> FloatArray:
    """Energy from node to node, J, by Simpson's rule, which has no corner of the voltage inside."""
    spacing = int(nodes[1] - nodes[0])
    weights = np.ones(spacing + 1)
    weights[1:-1:2] = 4.0
    weights[2:-1:2] = 2.0
    windows = np.lib.stride_tricks.sliding_window_view(power_w, spacing + 1)
    return np.asarray(windows[nodes[:-1]] @ weights) / (3.0 * samplerate)
