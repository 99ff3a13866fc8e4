"""For each second of signal: the models that a simulated rig selected, their CPU time and error."""

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from device.errors import UsageError
from device.rig.actuator import Motion, Quantity
from device.rig.adaptive_actuator import FLOOR, AdaptiveActuator
from device.rig.parameters import Model
from device.rig.rig import Rig
from device.units import FloatArray

SHOWN: tuple[Quantity, ...] = ("acceleration_m_s2", "displacement_m", "current_a")


def actuator_of(rig: Rig, samplerate: float, model: Model, tolerance: float) -> AdaptiveActuator:
    """Return an actuator. UsageError: `model` is "nonlinear", but the rig has no [large_signal]."""
    if model == "nonlinear" and rig.large_signal is None:
        raise UsageError(
            f"rig {rig.name!r} has no data for the non-linear model: large_signal.stop_m is "
            "missing. Add [large_signal] with it to the file, or choose --model linear. Optional "
            "there, with usual values as defaults: stiffness_rise, force_factor_loss, "
            "inductance_change, stop_n_per_m2, stop_loss_s_per_m"
        )
    return AdaptiveActuator(rig, samplerate, tolerance, model=model)


@dataclass(frozen=True)
class SecondReport:
    """Values for one second of signal, from all actuators of a rig."""

    second: int
    nonlinear_percent: float  # share of the frames that the non-linear model moved
    cost_ms: float  # CPU time of the models
    error_percent: float  # largest error of acceleration or excursion, relative to its peak


class _Compared:
    """An actuator and its reference: the non-linear model with half the step length."""

    def __init__(self, actuator: AdaptiveActuator) -> None:
        self.actuator = actuator
        rig, p = actuator.rig, actuator.rig.actuator
        self._true = AdaptiveActuator(rig, actuator.samplerate, model="nonlinear", refine=1)
        self._least = np.array([p.resonance_rad_s**2, 1.0]) * (FLOOR * p.x_max_m)
        self.begin()

    def begin(self) -> None:
        self._wrong, self._peaks = np.zeros(2), self._least
        self._nonlinear = self.actuator.frames_by_model["nonlinear"]

    def compare(self, volts: FloatArray, motion: Motion) -> None:
        true = self._true.move(volts, SHOWN[:2])
        found, expected = (
            np.array([one.acceleration_m_s2, one.displacement_m]) for one in (motion, true)
        )
        self._wrong = np.maximum(self._wrong, np.abs(found - expected).max(axis=1, initial=0.0))
        self._peaks = np.maximum(self._peaks, np.abs(expected).max(axis=1, initial=0.0))

    def end(self) -> tuple[float, int]:
        """Return this second's largest relative error and its number of non-linear frames."""
        nonlinear = self.actuator.frames_by_model["nonlinear"] - self._nonlinear
        error = float((self._wrong / self._peaks).max())
        self.begin()
        return error, nonlinear


class ModelRecord:
    """Moves actuators and reports each second of signal, on one thread. clock: CPU time in s."""

    def __init__(
        self, actuators: Iterable[AdaptiveActuator], samplerate: int, clock: Callable[[], float]
    ) -> None:
        self._compared = [_Compared(actuator) for actuator in actuators]
        self._samplerate, self._clock = samplerate, clock
        self._frames, self._begun, self._cost_s = 0, 0, 0.0
        self.seconds: deque[SecondReport] = deque(maxlen=86_400)  # those of a day

    def move(self, index: int, volts: FloatArray) -> Motion:
        """Move one actuator and its reference by a block, of the same length for all actuators."""
        one = self._compared[index]
        start_s = self._clock()
        motion = one.actuator.move(volts, SHOWN)
        self._cost_s += self._clock() - start_s
        one.compare(volts, motion)
        if one.actuator.unresolved_frames:
            raise UsageError(
                f"rig {one.actuator.rig.name!r}: its stops are too hard for the non-linear model "
                f"{self._frames / self._samplerate:.2f} s after the start; lower "
                "large_signal.stop_n_per_m2, or choose --model linear"
            )
        return motion

    def advance(self, frames: int) -> None:
        """Count a block by which all actuators have moved; report a second when it has ended."""
        before = self._frames // self._samplerate
        self._frames += frames
        if self._frames // self._samplerate > before:
            self._finish(before)

    def finish(self) -> None:
        """Report the last, possibly incomplete second."""
        if self._frames > self._begun:
            self._finish(self._frames // self._samplerate)

    def _finish(self, second: int) -> None:
        frames, self._begun = self._frames - self._begun, self._frames
        errors, nonlinear = zip(*(one.end() for one in self._compared), strict=True)
        share = min(1.0, sum(nonlinear) / max(1, frames * len(errors)))
        numbers = (100.0 * share, 1e3 * self._cost_s, 100.0 * max(errors))
        self.seconds.append(SecondReport(second, *(float(f"{x:.4g}") for x in numbers)))
        self._cost_s = 0.0


def in_words(seconds: Iterable[SecondReport]) -> list[str]:
    """Return lines for a user; consecutive seconds with the same models share a line."""
    lines = []
    for kind, group in groupby(seconds, key=_kind):
        part = list(group)
        cost_ms = sum(one.cost_ms for one in part) / len(part)
        error = max(one.error_percent for one in part)
        lines.append(
            f"{part[0].second} to {part[-1].second + 1} s: {kind}, {cost_ms:.2g} ms of CPU a "
            f"second, true error up to {error:.2g} %"
        )
    return lines


def _kind(second: SecondReport) -> str:
    if second.nonlinear_percent == 0.0:
        return "linear model"
    return "non-linear model" if second.nonlinear_percent > 99.0 else "both models in turn"
