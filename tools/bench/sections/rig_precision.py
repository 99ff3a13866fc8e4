"""Bench on the rungs of the rig: what each costs for what error, beside SciPy's integrators."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.signal import lsim

from audioflinger_hook.transform import FloatArray
from device.rig import PAPER
from device.rig.actuator import LinearActuator, Motion
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.co_energy import Energies, energies
from device.rig.model_levels import ModelLevel
from device.rig.node_grid import compensate_interpolation
from tools.bench.cost import in_ffts, interleaved, thread_seconds
from tools.bench.report import Must, Row, Section, number
from tools.bench.sections.rig import DRIVE_HZ, state_space
from tools.bench.sounds.signals import SAMPLERATE
from tools.bench.workbench import Effort, Workbench

TITLE = "Work and precision of the rungs"
REAL_TIME, ERROR = Must(">=", 60.0), Must("<=", 1e-4)
REAL_TIME_FFTS = Must("<=", in_ffts(1.0 / REAL_TIME.bound))
TIMES_FASTER = Must(">=", 15.0)
AIM_FASTER = 100.0

LEVEL_V = 6.5
"""Of each of the sinusoids: together they drive the actuator to nine tenths of Xmax."""
LOW_LEVEL_V = 0.1
NODES_HZ = (1_500.0, 2_000.0, 3_000.0, 6_000.0, 12_000.0)
DEFAULT_NODES_HZ = 6_000.0
METHODS = ("RK45", "DOP853", "LSODA", "Radau")
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
_RADAUS = 4
"""Beyond these, Radau takes seconds."""
COMPARED = 24
"""Every so many samples of 48 kHz are compared: the integrators are asked for no more."""
LONGEST_S = 1.0
SOLVED_S = 0.2
"""The integrators solve the beginning only: their cost is in proportion to the time."""
STATES = ("displacement_m", "velocity_m_s", "current_a")
"""What an integrator gives, and so what the non-linear rung is asked for beside it."""


@dataclass(frozen=True)
class Point:
    """One way of computing the motion: seconds of CPU for a second of signal, and its error.

    error: of the displacement, the largest one over the peak. ffts: the cost in FFTs that were
    timed with it; None where none were.
    """

    cost: float
    error: float
    ffts: float | None = None


def work_and_precision(bench: Workbench) -> Section:
    """Cost and error of each rung and of each integrator, on the same equations and drive."""
    effort = bench.effort
    duration_s = min(LONGEST_S, effort.rig_s)
    expected = reference(LEVEL_V, SOLVED_S)
    rows, series = _linear_rows(duration_s, effort.rung_repeats), {}
    ours, theirs = _nonlinear_points(effort, duration_s, expected)
    for nodes_hz, point in ours.items():
        name = f"non-linear rung, {number(nodes_hz)} nodes a second"
        rows += _point_rows(name, point, nodes_hz == DEFAULT_NODES_HZ)
    series["non-linear rung"] = _series(list(ours.values()))
    for name, point in _other_points(duration_s, expected).items():
        rows += _point_rows(f"{name}, non-linear equations", point, False)
        series[name] = _series([point])
    for method, points in theirs.items():
        for tolerance, point in zip(TOLERANCES, points, strict=False):
            rows += _point_rows(f"solve_ivp {method}, rtol {tolerance:.0e}", point, False)
        series[method] = _series(points)
    rows += _faster_rows(ours, theirs)
    return Section(
        TITLE,
        "Seconds of signal computed in a second of CPU time, and the largest error of the "
        "displacement as a share of its peak. Drive: the sinusoids of the section above, from "
        "rest; for the non-linear equations so loud that the peak is nine tenths of Xmax. The "
        "non-linear rung gets samples at 48 kHz, has the hold's loss put back, and gives "
        "displacement, velocity and current at each; the integrators get the "
        "sinusoids as a function in plain Python floats, and solve the first "
        f"{SOLVED_S} s, asked for the motion {SAMPLERATE // COMPARED} times a second. The "
        "reference is DOP853 at 1e-12, and lsim for the linear equations. Non-linear rung and "
        f"integrators in turns, the least of {effort.rung_repeats} and of "
        f"{effort.integrator_repeats} repeats. What is asked of the linear rung stands in the "
        "section above, over longer blocks.",
        tuple(rows),
        series=series,
        footnote="How many times faster: the cost of an integrator at the error of ours is read "
        "off its line through the points above, log over log; the best of the four counts.",
    )


def drive(level_v: float, duration_s: float) -> FloatArray:
    """The volts at 48 kHz, (frames,)."""
    times = np.arange(round(duration_s * SAMPLERATE)) / SAMPLERATE
    return level_v * np.asarray(sum(np.sin(math.tau * hz * times) for hz in DRIVE_HZ))


@cache
def reference(level_v: float, duration_s: float) -> FloatArray:
    """Displacement, m, at every COMPARED-th sample, solved to 1e-12."""
    return _solved("DOP853", level_v, duration_s, 1e-12)


def equations_of_motion(e: Energies, level_v: float) -> Callable[[float, Any], list[float]]:
    """(x, x', i)' in plain floats, the fastest form for an integrator that asks point by point.

    The derivatives are those of the energies: a divided difference where both ends meet.
    """
    p = PAPER.actuator
    m, c, r = p.moving_mass_kg, p.damping_n_s_per_m, p.resistance_ohm
    magnet, inductance, potential = e.co_energy.magnet, e.co_energy.inductance, e.potential
    turns = tuple(math.tau * hz for hz in DRIVE_HZ)

    def rates(t: float, state: Any) -> list[float]:
        x, u, i = state.tolist()
        force_factor, slope = magnet.divided(x, x), inductance.divided(x, x)
        volt = level_v * sum([math.sin(turn * t) for turn in turns])
        force = (force_factor + 0.5 * slope * i) * i - potential.divided(x, x)
        rate = (volt - r * i - (force_factor + slope * i) * u) / inductance.value(x)
        return [u, (force - c * u) / m, rate]

    return rates


def _solved(method: str, level_v: float, duration_s: float, tolerance: float) -> FloatArray:
    e = energies(PAPER.actuator, PAPER.large_signal)
    times = np.arange(0, round(duration_s * SAMPLERATE), COMPARED) / SAMPLERATE
    # Of the typical millimetre, metre a second and ampere.
    absolute = tolerance * np.array([1e-3, 1.0, 1.0])
    solved = solve_ivp(
        equations_of_motion(e, level_v),
        (0.0, times[-1]),
        np.zeros(3),
        method,
        times,
        rtol=max(tolerance, 3e-14),
        atol=absolute,
    )
    return np.asarray(solved.y[0])


def _nonlinear_points(
    effort: Effort, duration_s: float, expected: FloatArray
) -> tuple[dict[float, Point], dict[str, list[Point]]]:
    """Ours by nodes, and the integrators' by method; timed in turns, since they are compared.

    Of each the least of its repeats: what else the host does only ever adds to it.
    """
    volts = drive(LEVEL_V, duration_s)
    ladders = {
        hz: AdaptiveActuator(PAPER, SAMPLERATE, level=ModelLevel.NONLINEAR, nodes_hz=hz)
        for hz in NODES_HZ
    }
    errors = [
        _error(ladder.move(compensate_interpolation(volts)), expected)
        for ladder in ladders.values()
    ]
    asked = [
        (method, tolerance)
        for method in METHODS
        for tolerance in TOLERANCES[: _RADAUS if method == "Radau" else None]
    ]
    solved: dict[tuple[str, float], FloatArray] = {}

    def solve(method: str, tolerance: float) -> None:
        solved[method, tolerance] = _solved(method, LEVEL_V, SOLVED_S, tolerance)

    works = [
        *(partial(_afresh_smoothly, ladder, volts) for ladder in ladders.values()),
        *(partial(solve, *each) for each in asked),
    ]
    repeats = [effort.rung_repeats] * len(ladders) + [effort.integrator_repeats] * len(asked)
    timings = interleaved(works, repeats, warm=False)  # the first is hardly ever the least
    ours = {
        hz: Point(min(timing.seconds) / duration_s, error, timing.median_units / duration_s)
        for hz, error, timing in zip(NODES_HZ, errors, timings, strict=False)
    }
    theirs: dict[str, list[Point]] = {method: [] for method in METHODS}
    for (method, tolerance), timing in zip(asked, timings[len(ladders) :], strict=True):
        error = _share(solved[method, tolerance], expected)
        theirs[method].append(Point(min(timing.seconds) / SOLVED_S, error))
    return ours, theirs


def _other_points(duration_s: float, expected: FloatArray) -> dict[str, Point]:
    """The other rungs, and lsim, on the drive that they are too simple or too slow for."""
    volts = compensate_interpolation(drive(LEVEL_V, duration_s))
    short = volts[: round(SOLVED_S * SAMPLERATE)]
    points = {}
    for rung, driven in (
        (ModelLevel.LINEAR, volts),
        (ModelLevel.CORRECTED, volts),
        (ModelLevel.STEPPED, short),
    ):
        ladder = AdaptiveActuator(PAPER, SAMPLERATE, level=rung)
        error = _error(ladder.move(driven), expected)
        (timing,) = interleaved([partial(_afresh, ladder, driven)], 1 if driven is short else 5)
        points[f"{rung} rung"] = Point(timing.median_s * SAMPLERATE / len(driven), error)
    rate, into = state_space(PAPER.actuator)
    system = (rate, into[:, None], np.eye(3), np.zeros((3, 1)))
    times = np.arange(len(short)) / SAMPLERATE
    held: list[FloatArray] = []
    cost = thread_seconds(lambda: held.append(lsim(system, short, times, interp=True)[2][:, 0]))
    error = _share(held[0][::COMPARED][: len(expected)], expected)
    points["lsim"] = Point(cost / SOLVED_S, error)
    return points


def _afresh(actuator: AdaptiveActuator | LinearActuator, volts: FloatArray) -> None:
    actuator.reset()
    actuator.move(volts)


def _afresh_smoothly(ladder: AdaptiveActuator, volts: FloatArray) -> None:
    ladder.reset()
    ladder.move(compensate_interpolation(volts), STATES)


def _linear_rows(duration_s: float, repeats: int) -> list[Row]:
    """The linear rungs on the linear equations, and what simpler ones would be off by."""
    volts = drive(LOW_LEVEL_V, duration_s)
    p = PAPER.actuator
    rate, into = state_space(p)
    system = (rate, into[:, None], np.eye(3), np.zeros((3, 1)))
    times = np.arange(volts.size) / SAMPLERATE
    _, _, states = lsim(system, volts, times, interp=True)
    full, acceleration = states[:, 0], states @ rate[1]
    actuator = LinearActuator(p, SAMPLERATE)
    mechanical = LinearActuator(replace(p, inductance_h=1e-9), SAMPLERATE)
    ladder = AdaptiveActuator(replace(PAPER, large_signal=None), SAMPLERATE, 1e-3)
    works = [
        partial(_afresh, actuator, volts),
        partial(_afresh, ladder, volts),
        partial(lsim, system, volts, times),
    ]
    turns = (repeats, repeats, 1)  # lsim takes a hundred times as long
    costs = [timing.median_s / duration_s for timing in interleaved(works, turns)]
    names = ("linear rung", "linear rung, chosen by the ladder", "scipy.signal.lsim")
    rows = [
        Row(name, 1.0 / cost, "", "x real time") for name, cost in zip(names, costs, strict=True)
    ]
    for name, motion in (
        ("linear rung", LinearActuator(p, SAMPLERATE).move(volts)),
        ("no rung: without inductance", mechanical.move(volts)),
    ):
        rows.append(Row(name, _share(motion.displacement_m, full), "", "error"))
    gain = float(volts @ acceleration / (volts @ volts))
    rows.append(Row("no rung: one gain", _share(gain * volts, acceleration), "", "error"))
    return rows


def _point_rows(name: str, point: Point, limited: bool) -> list[Row]:
    must, twin = REAL_TIME if limited else None, "" if point.ffts is None else "a second, FFTs"
    rows = [
        Row(name, 1.0 / point.cost, "", "x real time", must, ffts_column=twin),
        Row(name, point.error, "", "error", ERROR if limited else None),
    ]
    if point.ffts is not None:
        must = REAL_TIME_FFTS if limited else None
        rows.append(Row(name, round(point.ffts), "FFTs", twin, must))
    return rows


def _faster_rows(ours: dict[float, Point], theirs: dict[str, list[Point]]) -> list[Row]:
    """How many times faster than the best integrator, at the error of each of ours."""
    rows = []
    for nodes_hz, point in ours.items():
        costs = {method: _cost_at(point.error, points) for method, points in theirs.items()}
        best = min(costs, key=lambda method: costs[method])
        rows.append(
            Row(
                f"faster than solve_ivp at equal error, {number(nodes_hz)} nodes",
                costs[best] / point.cost,
                "",
                "times",
                TIMES_FASTER if nodes_hz == DEFAULT_NODES_HZ else None,
                note=f"than {best} at {point.error:.1e}; the aim is {AIM_FASTER:g}",
            )
        )
    return rows


def _cost_at(error: float, points: list[Point]) -> float:
    """The cost on the straight line through log error and log cost, at the ends the end's."""
    ordered = sorted(points, key=lambda point: point.error)
    errors = np.log([point.error for point in ordered])
    return float(np.exp(np.interp(math.log(error), errors, np.log([p.cost for p in ordered]))))


def _error(motion: Motion, expected: FloatArray) -> float:
    return _share(motion.displacement_m[::COMPARED][: len(expected)], expected)


def _share(got: FloatArray, expected: FloatArray) -> float:
    return float(np.abs(got - expected).max() / np.abs(expected).max())


def _series(points: list[Point]) -> tuple[float, ...]:
    """Cost and error in turn."""
    return tuple(value for point in points for value in (point.cost, point.error))
