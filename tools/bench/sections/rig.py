"""Sections on the simulated rig: speed of its models, and their error compared with SciPy."""

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
"""Frequencies in Hz over the vibration band."""
DRIVE_V = 0.3
LEVEL_V = 6.5  # amplitude of each sinusoid; all together reach nine tenths of Xmax
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
COMPARED = 24  # one in 24 samples at 48 kHz is compared
LONGEST_S = 1.0
STATES = ("displacement_m", "velocity_m_s", "current_a")
SOLVED_S = 0.2  # length in s that slow methods solve; cost is proportional to length
OURS = "Runge-Kutta"


def linear_model(bench: Workbench) -> Section:
    """Measure the speed of the rig's linear model."""
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
        "The table shows how many seconds of a signal at 48 kHz the linear model computes in a "
        "second of CPU time. It also shows the cost of a second of signal in FFTs. Rows with *the "
        "whole rig* include DAC, amplifier, actuator and peak meters. The drive signal is a sum of "
        f"{len(DRIVE_HZ)} sinusoids in the vibration band; the rig starts at rest.",
        tuple(rows),
    )


def _speed_rows(name: str, speed: float, ffts: float, must: Must | None) -> list[Row]:
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
    """Return a drive voltage at 48 kHz, (frames,): seven sinusoids that start at phase 0.

    level_v: amplitude of each sinusoid in V.
    """
    turns = 2.0 * np.pi * np.arange(round(duration_s * SAMPLERATE)) / SAMPLERATE
    return np.asarray(level_v * np.sum([np.sin(hz * turns) for hz in DRIVE_HZ], axis=0))


@dataclass
class Method:
    """A method for solving the equations of the rig.

    curve: methods with the same value share a line of the picture.
    solve: function that returns the displacement in m at 48 kHz.
    duration_s: duration of the solved signal in s.
    repeats: number of timings.
    thinned: whether `solve` returns only every COMPARED-th sample.
    """

    curve: str
    name: str
    solve: Callable[[], FloatArray]
    duration_s: float
    repeats: int
    thinned: bool = False

    def run(self) -> None:
        """Solve the equations, and store the displacement at every COMPARED-th sample."""
        found = self.solve()
        self.found = found if self.thinned else found[::COMPARED]


def methods(bench: Workbench) -> list[Method]:
    """Return all compared methods: this project's models, SciPy's `lsim` and integrators."""
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
    """Measure CPU time and error of all models and integrators with the same drive signal."""
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
        "Several methods solve the non-linear equations of the actuator. For each method, the "
        "table shows how many seconds of signal it computes in a second of CPU time. It also shows "
        "the largest error of the displacement, relative to the peak displacement. The drive "
        "signal has the sinusoids of the previous section; its peak displacement is nine tenths of "
        "Xmax, the excursion limit. For the project's models, the drive signal is sampled at 48 "
        f"kHz. The integrators compute the first {SOLVED_S} s, and get the drive signal as a "
        "Python function of time. The reference is DOP853 with a tolerance of 1e-12. Methods are "
        f"timed alternately. Times are the shortest of {bench.effort.model_repeats} repeats for "
        f"Runge-Kutta, and of at most {bench.effort.integrator_repeats} repeats for other methods.",
        (*rows, _faster_row(series)),
        series=series,
        footnote="The column *times* shows the cost of the best of four integrators relative to "
        "the project's Runge-Kutta model, at the same error. The cost of an integrator at this "
        "error is interpolated between its measured points on logarithmic axes.",
    )


def _faster_row(series: dict[str, tuple[float, ...]]) -> Row:
    """Return the CPU time of the best integrator relative to the project's model at equal error."""
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
    """Return the displacement in m from SciPy's `lsim`; the voltage is linear between samples."""
    m, c, k = p.moving_mass_kg, p.damping_n_s_per_m, p.stiffness_n_per_m
    bl, r, inductance = p.force_factor_n_per_a, p.resistance_ohm, p.inductance_h
    rate = np.array(
        [[0.0, 1.0, 0.0], [-k / m, -c / m, bl / m], [0.0, -bl / inductance, -r / inductance]]
    )
    into = np.array([[0.0], [0.0], [1.0 / inductance]])
    system = (rate, into, np.array([[1.0, 0.0, 0.0]]), np.zeros((1, 1)))
    return np.asarray(lsim(system, volts, np.arange(volts.size) / SAMPLERATE, interp=True)[1])


def equations_of_motion(level_v: float) -> Callable[[float, Any], list[float]]:
    """Return a function for `solve_ivp` that gives the derivatives of the driven rig's state.

    level_v: amplitude of each sinusoid of the drive in V.
    """
    rates = rates_of(PAPER)
    turns = tuple(math.tau * hz for hz in DRIVE_HZ)

    def driven(t: float, state: Any) -> list[float]:
        volt = level_v * sum([math.sin(turn * t) for turn in turns])
        return rates(volt, state.tolist())[0]

    return driven


def _solved(method: str, level_v: float, duration_s: float, tolerance: float) -> FloatArray:
    times = np.arange(0, round(duration_s * SAMPLERATE), COMPARED) / SAMPLERATE
    solved = solve_ivp(
        equations_of_motion(level_v),
        (0.0, times[-1]),
        np.zeros(5),
        method,
        times,
        rtol=max(tolerance, 3e-14),
        atol=tolerance * np.array([1e-3, 1.0, 1.0, 1e-3, 1.0]),  # typical: 1 mm, 1 m/s, 1 A
    )
    return np.asarray(solved.y[0])


def compensate_interpolation(volts: FloatArray) -> FloatArray:
    """Return samples whose linear interpolation is close to the band-limited signal of `volts`.

    With the sample period T, linear interpolation attenuates a sinusoid of angular frequency w by
    the share (w T)^2 / 12. At 220 Hz and 48 kHz, this is 7e-5. Subtracting a twelfth of the second
    difference compensates the attenuation. The remaining error is (w T)^4 / 90, here 8e-9.
    """
    raised = volts.copy()
    raised[1:-1] -= (volts[2:] - 2.0 * volts[1:-1] + volts[:-2]) / 12.0
    return raised
