"""Section on work and precision: what each model of the rig costs for what error, beside SciPy."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from audioflinger_hook.transform import FloatArray
from device.rig import PAPER
from device.rig.actuator import LinearActuator, Motion
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.co_energy import energies
from device.rig.model_levels import ModelLevel
from tools.bench.cost import in_ffts, interleaved, thread_seconds
from tools.bench.report import Must, Row, Section, number
from tools.bench.sections.rig import DRIVE_HZ, drive, lsim_states, state_space
from tools.bench.sounds.signals import SAMPLERATE
from tools.bench.workbench import Effort, Workbench

REAL_TIME, ERROR = Must(">=", 60.0), Must("<=", 1e-4)
REAL_TIME_FFTS = Must("<=", in_ffts(1.0 / REAL_TIME.bound))
TIMES_FASTER = Must(">=", 15.0)

LEVEL_V = 6.5
"""Of each sinusoid: together they drive the actuator to nine tenths of Xmax."""
LOW_LEVEL_V = 0.1
NODES_HZ = (1_500.0, 2_000.0, 3_000.0, 6_000.0, 12_000.0)
DEFAULT_NODES_HZ = 6_000.0
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
INTEGRATORS = {
    "RK45": TOLERANCES, "DOP853": TOLERANCES, "LSODA": TOLERANCES, "Radau": TOLERANCES[:4],
}  # fmt: skip
"""Method and tolerances; Radau takes seconds at smaller ones."""
COMPARED = 24
"""Every 24th sample of 48 kHz is compared."""
LONGEST_S = 1.0
SOLVED_S = 0.2
"""The integrators solve the beginning only; their cost is proportional to the time."""
STATES = ("displacement_m", "velocity_m_s", "current_a")


@dataclass(frozen=True)
class Point:
    """Cost and error of one method.

    cost: CPU seconds for a second of signal; error: largest error of the displacement over its
    peak; ffts: the cost in FFTs, where they were timed.
    """

    cost: float
    error: float
    ffts: float | None = None


def work_and_precision(bench: Workbench) -> Section:
    """Cost and error of each model and integrator, on the same equations and drive."""
    effort = bench.effort
    duration_s = min(LONGEST_S, effort.rig_s)
    expected = reference(LEVEL_V, SOLVED_S)
    rows = _simpler_rows(duration_s)
    ours, theirs = _nonlinear_points(effort, duration_s, expected)
    for nodes_hz, point in ours.items():
        name = f"non-linear model, {number(nodes_hz)} nodes a second"
        rows += _point_rows(name, point, nodes_hz == DEFAULT_NODES_HZ)
    series = {"non-linear model": list(ours.values())}
    for name, point in _other_points(duration_s, expected).items():
        rows += _point_rows(name, point, False)
        series[name] = [point]
    for method, points in theirs.items():
        for tolerance, point in zip(INTEGRATORS[method], points, strict=True):
            rows += _point_rows(f"solve_ivp {method}, rtol {tolerance:.0e}", point, False)
    return Section(
        "Work and precision",
        "Seconds of signal computed in a second of CPU time, and the largest error of the "
        "displacement over its peak, for the non-linear equations. The sinusoids of the section "
        "above drive them to nine tenths of Xmax. Our models get samples at 48 kHz; the "
        "integrators get the sinusoids as a function of plain Python floats and solve the first "
        f"{SOLVED_S} s. The reference is DOP853 at 1e-12. Methods are timed in turns; the least of "
        f"{effort.model_repeats} and of {effort.integrator_repeats} repeats counts.",
        (*rows, *_faster_rows(ours, theirs)),
        series={name: _series(points) for name, points in (series | theirs).items()},
        footnote="How many times faster: an integrator's cost at the error of our model is "
        "interpolated on the log-log line through its points; the best of the four counts.",
    )


@cache
def reference(level_v: float, duration_s: float) -> FloatArray:
    """Return the displacement, m, at every COMPARED-th sample, solved to 1e-12."""
    return _solved("DOP853", level_v, duration_s, 1e-12)


def equations_of_motion(level_v: float) -> Callable[[float, Any], list[float]]:
    """Return (x, x', i)' of the driven rig in plain floats, the fastest form for integrators."""
    p, e = PAPER.actuator, energies(PAPER.actuator, PAPER.large_signal)
    m, c, r = p.moving_mass_kg, p.damping_n_s_per_m, p.resistance_ohm
    magnet, inductance, potential = e.co_energy.magnet, e.co_energy.inductance, e.potential
    turns = tuple(math.tau * hz for hz in DRIVE_HZ)

    def rates(t: float, state: Any) -> list[float]:
        x, u, i = state.tolist()
        # A divided difference where both ends meet is the derivative.
        force_factor, slope = magnet.divided(x, x), inductance.divided(x, x)
        volt = level_v * sum([math.sin(turn * t) for turn in turns])
        force = (force_factor + 0.5 * slope * i) * i - potential.divided(x, x)
        rate = (volt - r * i - (force_factor + slope * i) * u) / inductance.value(x)
        return [u, (force - c * u) / m, rate]

    return rates


def _solved(method: str, level_v: float, duration_s: float, tolerance: float) -> FloatArray:
    times = np.arange(0, round(duration_s * SAMPLERATE), COMPARED) / SAMPLERATE
    solved = solve_ivp(
        equations_of_motion(level_v),
        (0.0, times[-1]),
        np.zeros(3),
        method,
        times,
        rtol=max(tolerance, 3e-14),
        atol=tolerance * np.array([1e-3, 1.0, 1.0]),  # of a typical 1 mm, 1 m/s and 1 A
    )
    return np.asarray(solved.y[0])


def _nonlinear_points(
    effort: Effort, duration_s: float, expected: FloatArray
) -> tuple[dict[float, Point], dict[str, list[Point]]]:
    """Return our points by nodes and the integrators' by method, all timed in turns."""
    volts = drive(duration_s, LEVEL_V)
    models = {
        hz: AdaptiveActuator(PAPER, SAMPLERATE, level=ModelLevel.NONLINEAR, nodes_hz=hz)
        for hz in NODES_HZ
    }
    errors = [
        _error(model.move(compensate_interpolation(volts)), expected) for model in models.values()
    ]
    asked = [(method, each) for method, tolerances in INTEGRATORS.items() for each in tolerances]
    solved: dict[tuple[str, float], FloatArray] = {}

    def solve(method: str, tolerance: float) -> None:
        solved[method, tolerance] = _solved(method, LEVEL_V, SOLVED_S, tolerance)

    def move(model: AdaptiveActuator) -> None:
        model.reset()
        model.move(compensate_interpolation(volts), STATES)

    works = [*(partial(move, model) for model in models.values()),
             *(partial(solve, *each) for each in asked)]  # fmt: skip
    repeats = [effort.model_repeats] * len(models) + [effort.integrator_repeats] * len(asked)
    timings = interleaved(works, repeats, warm=False)
    ours = {
        hz: Point(min(timing.seconds) / duration_s, error, timing.median_units / duration_s)
        for hz, error, timing in zip(NODES_HZ, errors, timings, strict=False)
    }
    theirs: dict[str, list[Point]] = {method: [] for method in INTEGRATORS}
    for (method, tolerance), timing in zip(asked, timings[len(models) :], strict=True):
        error = _share(solved[method, tolerance], expected)
        theirs[method].append(Point(min(timing.seconds) / SOLVED_S, error))
    return ours, theirs


def _other_points(duration_s: float, expected: FloatArray) -> dict[str, Point]:
    """Return the other models, and lsim, on the drive of the non-linear equations."""
    volts = compensate_interpolation(drive(duration_s, LEVEL_V))
    short = volts[: round(SOLVED_S * SAMPLERATE)]
    points = {}
    for level, driven, repeats in (
        (ModelLevel.LINEAR, volts, 5),
        (ModelLevel.CORRECTED, volts, 5),
        (ModelLevel.STEPPED, short, 1),
    ):
        model = AdaptiveActuator(PAPER, SAMPLERATE, level=level)
        error = _error(model.move(driven), expected)

        def move(model: AdaptiveActuator = model, driven: FloatArray = driven) -> None:
            model.reset()
            model.move(driven)

        (timing,) = interleaved([move], repeats)
        points[f"{level} model"] = Point(timing.median_s * SAMPLERATE / len(driven), error)
    held: list[FloatArray] = []
    cost = thread_seconds(lambda: held.append(lsim_states(PAPER.actuator, short)[:, 0]))
    error = _share(held[0][::COMPARED][: len(expected)], expected)
    return points | {"lsim": Point(cost / SOLVED_S, error)}


def _simpler_rows(duration_s: float) -> list[Row]:
    """Return the error of simpler models than ours, on the linear equations."""
    p = PAPER.actuator
    volts = drive(duration_s, LOW_LEVEL_V)
    states = lsim_states(p, volts)
    acceleration = states @ state_space(p)[0][1]
    gain = float(volts @ acceleration / (volts @ volts))
    mechanical = LinearActuator(replace(p, inductance_h=1e-9), SAMPLERATE).move(volts)
    error = _share(mechanical.displacement_m, states[:, 0])
    return [
        Row("simpler: without inductance, linear equations", error, "", "error"),
        Row("simpler: one gain, linear equations", _share(gain * volts, acceleration), "", "error"),
    ]


def _point_rows(name: str, point: Point, limited: bool) -> list[Row]:
    ffts = "" if point.ffts is None else "a second, FFTs"
    must = REAL_TIME if limited else None
    rows = [
        Row(name, 1.0 / point.cost, "", "x real time", must, ffts_column=ffts),
        Row(name, point.error, "", "error", ERROR if limited else None),
    ]
    if point.ffts is not None:
        must = REAL_TIME_FFTS if limited else None
        rows.append(Row(name, round(point.ffts), "FFTs", ffts, must))
    return rows


def _faster_rows(ours: dict[float, Point], theirs: dict[str, list[Point]]) -> list[Row]:
    """Return how many times faster we are than the best integrator at equal error."""
    rows = []
    for nodes_hz, point in ours.items():
        costs = {method: _cost_at(point.error, points) for method, points in theirs.items()}
        best = min(costs, key=lambda method: costs[method])
        name = f"faster than solve_ivp at equal error, {number(nodes_hz)} nodes"
        must = TIMES_FASTER if nodes_hz == DEFAULT_NODES_HZ else None
        note = f"than {best} at {point.error:.1e}"
        rows.append(Row(name, costs[best] / point.cost, "", "times", must, note=note))
    return rows


def _cost_at(error: float, points: list[Point]) -> float:
    """Return the cost at an error, interpolated on the log-log line through the points."""
    ordered = sorted(points, key=lambda point: point.error)
    errors = np.log([point.error for point in ordered])
    return float(np.exp(np.interp(math.log(error), errors, np.log([p.cost for p in ordered]))))


def _error(motion: Motion, expected: FloatArray) -> float:
    return _share(motion.displacement_m[::COMPARED][: len(expected)], expected)


def _share(got: FloatArray, expected: FloatArray) -> float:
    return float(np.abs(got - expected).max() / np.abs(expected).max())


def _series(points: list[Point]) -> tuple[float, ...]:
    """Return cost and error of each point in turn."""
    return tuple(value for point in points for value in (point.cost, point.error))


def compensate_interpolation(volts: FloatArray) -> FloatArray:
    """Return (frames,) whose straight lines approximate the smooth signal through the samples.

    Straight lines lose (w T)^2 / 12 of a sinusoid, 7e-5 at 220 Hz and 48 kHz. A second difference
    restores that and leaves (w T)^4 / 360, 2e-9. It needs the whole signal in advance.
    """
    raised = volts.copy()
    raised[1:-1] -= (volts[2:] - 2.0 * volts[1:-1] + volts[:-2]) / 12.0
    return raised
