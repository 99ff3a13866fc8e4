"""Sections on the simulated rig: speed of the linear model; speed and error of all beside SciPy."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.signal import lsim

from audioflinger_hook.transform import FloatArray
from device.rig import PAPER, ActuatorParameters
from device.rig.actuator import LinearActuator
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.simulated_rig import SimulatedRig
from device.values import counted
from tools.bench.cost import in_ffts, interleaved
from tools.bench.measures.solved_motion import rates_of
from tools.bench.report import Must, Row, Section
from tools.bench.sounds.signals import SAMPLERATE
from tools.bench.workbench import Workbench

DRIVE_HZ = (20.0, 46.6, 92.0, 128.2, 140.9, 182.0, 220.0)
"""From the bottom to the top of the vibration band, with the paper's five in between."""
DRIVE_V = 0.3
LEVEL_V = 6.5
"""Of each sinusoid: together they drive the actuator to nine tenths of Xmax."""

LINEAR_REAL_TIME, REAL_TIME = Must(">=", 2_000.0), Must(">=", 100.0)
ERROR = Must("<=", 1e-4)
TIMES_FASTER = Must(">=", 30.0)
FFTS = "a second, FFTs"

BLOCKSIZES = (256, 32_768)
REPEATS = 5
REFINED = (0, 1, 2, 3)
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
INTEGRATORS = {
    "RK45": TOLERANCES, "DOP853": TOLERANCES, "LSODA": TOLERANCES, "Radau": TOLERANCES[:4],
}  # fmt: skip
"""Method and tolerances; Radau takes seconds at smaller ones."""
COMPARED = 24
"""Every 24th sample of 48 kHz is compared."""
LONGEST_S = 1.0
STATES = ("displacement_m", "velocity_m_s", "current_a")
SOLVED_S = 0.2
"""The slow methods solve the beginning only; their cost is proportional to the time."""
OURS = "Runge-Kutta"


def linear_model(bench: Workbench) -> Section:
    """Speed of the linear model of the rig."""
    duration_s = bench.effort.rig_s
    volts = drive(duration_s)
    vibration = volts[:, None] / max(1.0, float(np.abs(volts).max()))
    actuator, whole = LinearActuator(PAPER.actuator, SAMPLERATE), SimulatedRig(PAPER, SAMPLERATE, 1)
    works = {f"the actuator, blocks of {b}": partial(_move, actuator, volts, b) for b in BLOCKSIZES}
    for b in BLOCKSIZES:
        works[f"the whole rig, blocks of {b}"] = partial(_write, whole, vibration, b)
    rows = []
    for name, timing in zip(works, interleaved(list(works.values()), REPEATS), strict=True):
        limited = name == f"the actuator, blocks of {BLOCKSIZES[-1]}"
        ffts = timing.median_units / duration_s
        rows += _speed_rows(
            name, duration_s / timing.median_s, ffts, LINEAR_REAL_TIME if limited else None
        )
    return Section(
        "The simulated rig",
        "Seconds of signal at 48 kHz that the linear model computes in a second of CPU time, and "
        "the cost of a second in FFTs. The whole rig has DAC, amplifier, "
        f"actuator and peak meters. The drive is {len(DRIVE_HZ)} sinusoids over the vibration "
        "band, from rest.",
        tuple(rows),
    )


def _speed_rows(name: str, speed: float, ffts: float, must: Must | None) -> list[Row]:
    """Return a speed and the same as a cost in FFTs, both limited or not."""
    must_ffts = Must("<=", in_ffts(1.0 / must.bound)) if must else None
    return [
        Row(name, speed, "", "x real time", must, ffts_column=FFTS),
        Row(name, round(ffts), "FFTs", FFTS, must_ffts),
    ]


def _move(actuator: LinearActuator, volts: FloatArray, blocksize: int) -> None:
    actuator.reset()
    for first in range(0, volts.size, blocksize):
        actuator.move(volts[first : first + blocksize], ("displacement_m", "acceleration_m_s2"))


def _write(rig: SimulatedRig, vibration: FloatArray, blocksize: int) -> None:
    rig.reset()
    for first in range(0, len(vibration), blocksize):
        rig.write(vibration[first : first + blocksize])


def drive(duration_s: float, level_v: float = DRIVE_V) -> FloatArray:
    """Return the drive voltage at 48 kHz, (frames,): sinusoids that start at 0."""
    turns = 2.0 * np.pi * np.arange(round(duration_s * SAMPLERATE)) / SAMPLERATE
    return np.asarray(level_v * np.sum([np.sin(hz * turns) for hz in DRIVE_HZ], axis=0))


@dataclass
class Method:
    """One way to solve the non-linear equations.

    curve: methods that share a line of the picture. solve: returns the displacement in m at 48 kHz.
    duration_s: of that signal. thinned: whether it has every COMPARED-th sample only.
    """

    curve: str
    name: str
    solve: Callable[[], FloatArray]
    duration_s: float
    repeats: int
    thinned: bool = False

    def run(self) -> None:
        """Solve, and keep the displacement at every COMPARED-th sample."""
        found = self.solve()
        self.found = found if self.thinned else found[::COMPARED]


def methods(bench: Workbench) -> list[Method]:
    """Return our models, `lsim` and the integrators of SciPy."""
    whole_s = min(LONGEST_S, bench.effort.rig_s)
    volts = compensate_interpolation(drive(whole_s, LEVEL_V))
    short = volts[: round(SOLVED_S * SAMPLERATE)]

    def model(driven: FloatArray, **options: Any) -> Callable[[], FloatArray]:
        actuator = AdaptiveActuator(PAPER, SAMPLERATE, **options)

        def move() -> FloatArray:
            actuator.reset()
            return actuator.move(driven, STATES).displacement_m

        return move

    few = bench.effort.integrator_repeats
    found = []
    for refine in REFINED:
        solve = model(volts, model="nonlinear", refine=refine)
        found.append(Method(OURS, _steps(refine), solve, whole_s, bench.effort.model_repeats))
    name = "linear model"
    found.append(Method(name, name, model(volts, model="linear"), whole_s, few))
    linear = partial(linear_displacement, PAPER.actuator, short)
    found.append(Method("lsim", "lsim", linear, SOLVED_S, 1))
    for method, tolerances in INTEGRATORS.items():
        for each in tolerances:
            solve = partial(_solved, method, LEVEL_V, SOLVED_S, each)
            name = f"solve_ivp {method}, rtol {each:.0e}"
            found.append(Method(method, name, solve, SOLVED_S, few, thinned=True))
    return found


def _steps(refine: int) -> str:
    return f"{OURS}, {counted(2**refine, 'steps')} a sample"


def work_and_precision(bench: Workbench) -> Section:
    """Cost and error of each model and integrator, on the same equations and drive."""
    expected = _solved("DOP853", LEVEL_V, SOLVED_S, 1e-12)
    asked = methods(bench)
    timings = interleaved(
        [each.run for each in asked], [each.repeats for each in asked], warm=False
    )
    rows: list[Row] = []
    series: dict[str, tuple[float, ...]] = {}
    for method, timing in zip(asked, timings, strict=True):
        limited = method.name == _steps(0)
        cost = min(timing.seconds) / method.duration_s
        missed = np.abs(method.found[: len(expected)] - expected).max()
        error = float(missed / np.abs(expected).max())
        ffts = timing.median_units / method.duration_s
        rows += _speed_rows(method.name, 1.0 / cost, ffts, REAL_TIME if limited else None)
        rows.append(Row(method.name, error, "", "error", ERROR if limited else None))
        series[method.curve] = (*series.get(method.curve, ()), cost, error)
    return Section(
        "Work and precision",
        "Seconds of signal computed in a second of CPU time, and the largest error of the "
        "displacement over its peak, for the non-linear equations. The sinusoids of the section "
        "above drive them to nine tenths of Xmax. Our models get samples at 48 kHz; the "
        "integrators get the sinusoids as a function of plain Python floats and solve the first "
        f"{SOLVED_S} s. The reference is DOP853 at 1e-12. Methods are timed in turns; the least of "
        f"{bench.effort.model_repeats} and of {bench.effort.integrator_repeats} repeats counts.",
        (*rows, _faster_row(series)),
        series=series,
        footnote="How many times faster: an integrator's cost at the error of our model is "
        "interpolated on the log-log line through its points; the best of the four counts.",
    )


def _faster_row(series: dict[str, tuple[float, ...]]) -> Row:
    """Return how many times faster we are than the best integrator at equal error."""
    cost, error = series[OURS][:2]
    costs = {}
    for method in INTEGRATORS:
        theirs = np.log(np.reshape(series[method], (-1, 2)))
        theirs = theirs[theirs[:, 1].argsort()]
        costs[method] = math.exp(np.interp(math.log(error), theirs[:, 1], theirs[:, 0]))
    best = min(costs, key=lambda method: costs[method])
    name = f"faster than solve_ivp at equal error, {_steps(0)}"
    note = f"than {best} at {error:.1e}"
    return Row(name, costs[best] / cost, "", "times", TIMES_FASTER, note=note)


def linear_displacement(p: ActuatorParameters, volts: FloatArray) -> FloatArray:
    """Return the displacement in m by scipy.signal.lsim, the voltage linear between samples."""
    m, c, k = p.moving_mass_kg, p.damping_n_s_per_m, p.stiffness_n_per_m
    bl, r, inductance = p.force_factor_n_per_a, p.resistance_ohm, p.inductance_h
    rate = np.array(
        [[0.0, 1.0, 0.0], [-k / m, -c / m, bl / m], [0.0, -bl / inductance, -r / inductance]]
    )
    into = np.array([[0.0], [0.0], [1.0 / inductance]])
    system = (rate, into, np.array([[1.0, 0.0, 0.0]]), np.zeros((1, 1)))
    return np.asarray(lsim(system, volts, np.arange(volts.size) / SAMPLERATE, interp=True)[1])


def equations_of_motion(level_v: float) -> Callable[[float, Any], list[float]]:
    """Return (y, u, i, z, z')' of the driven rig in plain floats, fastest for integrators."""
    rates = rates_of(PAPER)
    turns = tuple(math.tau * hz for hz in DRIVE_HZ)

    def driven(t: float, state: Any) -> list[float]:
        volt = level_v * sum([math.sin(turn * t) for turn in turns])
        return rates(volt, state.tolist())[0]

    return driven


def _solved(method: str, level_v: float, duration_s: float, tolerance: float) -> FloatArray:
    """Return the displacement in m at every COMPARED-th sample by an integrator of SciPy."""
    times = np.arange(0, round(duration_s * SAMPLERATE), COMPARED) / SAMPLERATE
    solved = solve_ivp(
        equations_of_motion(level_v),
        (0.0, times[-1]),
        np.zeros(5),
        method,
        times,
        rtol=max(tolerance, 3e-14),
        atol=tolerance * np.array([1e-3, 1.0, 1.0, 1e-3, 1.0]),  # of a typical 1 mm, 1 m/s and 1 A
    )
    return np.asarray(solved.y[0])


def compensate_interpolation(volts: FloatArray) -> FloatArray:
    """Return (frames,) whose straight lines approximate the smooth signal through the samples.

    Straight lines lose (w T)^2 / 12 of a sinusoid, 7e-5 at 220 Hz and 48 kHz. A second difference
    restores that and leaves (w T)^4 / 360, 2e-9. It needs the whole signal in advance.
    """
    raised = volts.copy()
    raised[1:-1] -= (volts[2:] - 2.0 * volts[1:-1] + volts[:-2]) / 12.0
    return raised
