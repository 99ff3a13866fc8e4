"""The actuators that a rig may turn out to have, and an optimiser that looks for bad drives."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.optimize import differential_evolution
from scipy.signal import butter, sosfilt, ss2zpk, zpk2sos

from device.rig import ActuatorParameters, Rig
from device.rig.actuator import first_order_hold
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.electronics import Amplifier
from device.rig.parameters import SeatParameters, vary
from device.units import FloatArray
from tests.support.random_rigs import linear_rates

FREE = SeatParameters(mass_kg=0.57, stiffness_n_per_m=100.0, damping_n_s_per_m=0.0)
"""A board that lies freely: 2 Hz on its spring, far below every vibration."""
GROUND = SeatParameters(mass_kg=1e6, stiffness_n_per_m=1e12, damping_n_s_per_m=0.0)
NEAR, F0_SQUARED = (0.9, 1.0, 1.1), (0.81, 1.0, 1.21)


@dataclass(frozen=True)
class Possible:
    """An actuator by what its mass, spring and Bl are multiplied by, and what its frame is on."""

    mass: float = 1.0
    stiffness: float = 1.0
    force_factor: float = 1.0
    seat: SeatParameters = GROUND

    def of(self, p: ActuatorParameters) -> ActuatorParameters:
        return vary(p, self.mass, self.stiffness, self.force_factor)


def possible_actuators(rig: Rig) -> list[Possible]:
    """Return the corners and the middle of all, on solid ground, on the rig's seat and free."""
    seats = [GROUND, FREE, *([rig.seat] if rig.seat else [])]
    found = [Possible(*at, seat) for seat in seats for at in product(NEAR, F0_SQUARED, (0.9, 1.1))]
    # f0 a tenth lower and higher by the mass alone
    return [*found, *(Possible(mass, 1.0, bl) for mass in (1.235, 0.826) for bl in (0.9, 1.1))]


def volts_of(rig: Rig, drive: FloatArray, samplerate: int) -> FloatArray:
    """Return what the amplifier with its band, but without clipping, makes of a drive, in V."""
    unlimited = replace(rig.amplifier, output_limit_v=1e9)
    return Amplifier(unlimited, samplerate).drive(rig.dac.full_scale_v * drive)


def excursion_sections(rig: Rig, possible: Possible, samplerate: int) -> FloatArray:
    """Return second-order sections from volts to the coil's excursion in its frame, in Xmax."""
    p, seat = possible.of(rig.actuator), possible.seat
    resistance = p.resistance_ohm + rig.amplifier.source_impedance_ohm
    rate = linear_rates(p, seat, resistance, p.force_factor_n_per_a)
    drive = np.array([0.0, 0.0, 1.0 / p.inductance_h, 0.0, 0.0])
    scale = np.array([1e3, 1.0, 1.0, 1e3, 1.0])
    rate, drive = rate * scale[:, None] / scale, drive * scale
    shown = np.array([1.0 / scale[0] / rig.actuator.x_max_m, 0.0, 0.0, 0.0, 0.0])
    step, from_last, from_new = first_order_hold(rate, drive, 1.0 / samplerate)
    entered = (step @ from_new + from_last)[:, None]
    zeros, poles, gain = ss2zpk(step, entered, shown[None], np.array([[shown @ from_new]]))
    return np.asarray(zpk2sos(zeros, poles, gain))


def linear_excursions(
    rig: Rig, possible: Possible, drive: FloatArray, samplerate: int
) -> FloatArray:
    """Return the largest excursion, (drives,), in Xmax, for drives of (frames, drives)."""
    volts = volts_of(rig, drive, samplerate)
    moved = sosfilt(excursion_sections(rig, possible, samplerate), volts, axis=0)
    return np.asarray(np.abs(moved).max(axis=0))


def non_linear_excursion(rig: Rig, possible: Possible, drive: FloatArray, samplerate: int) -> float:
    """Return the same of the non-linear model, for a drive of (frames,)."""
    true = replace(rig, actuator=possible.of(rig.actuator), seat=possible.seat)
    volts = np.ascontiguousarray(volts_of(rig, drive, samplerate))
    is_on_seat = possible.seat is not GROUND
    actuator = AdaptiveActuator(true, samplerate, model="nonlinear", seat=is_on_seat)
    x = actuator.move(volts, ("displacement_m",)).displacement_m
    return float(np.abs(x).max()) / rig.actuator.x_max_m


# -------------------------------------------------------------------------------------- search

KINDS = 6
DRIVES = (
    *((0.0, KINDS - 1e-6), (0.3, 2.0), (0.1, 3.0)),
    *((0.0, 1.0), (0.0, 1.0), (0.1, 1.0), (0.3, 1.5)),
)
"""Bounds of the numbers that `searched_drive` takes after f0 and the rate."""


def searched_drive(
    f0: float, samplerate: int, numbers: Sequence[float], seconds: float = 0.25
) -> FloatArray:
    """Return a burst, square burst, sweep, staircase, beat or noise, (frames,), by numbers."""
    kind, ratio, other_ratio, other, phase, until, level = numbers
    frames = round(seconds * samplerate)
    time_s = np.arange(frames) / samplerate
    sine = np.sin(math.tau * (ratio * f0 * time_s + phase))
    second = np.sin(math.tau * (other_ratio * f0 * time_s + 2.0 * phase))
    along = time_s / seconds
    if kind < 1:
        wave = sine + other * second
    elif kind < 2:
        wave = np.sign(sine) + other * second
    elif kind < 3:
        rate = f0 * (ratio + (other_ratio - ratio) * along / 2.0)
        wave = np.sin(math.tau * (rate * time_s + phase))
    elif kind < 4:
        wave = np.sign(sine) * (1.0 - other) + other * np.sign(second)
    elif kind < 5:
        wave = sine * (1.0 + other * np.sin(math.tau * other_ratio * f0 / 8.0 * time_s))
    else:
        band_hz = (0.5 * ratio * f0, 0.5 * ratio * f0 * (1.2 + other_ratio))
        noise = np.random.default_rng(int(1e6 * phase)).standard_normal(frames)
        wave = sosfilt(butter(2, band_hz, "band", fs=samplerate, output="sos"), noise)
        wave = wave / np.abs(wave).max()
    return level * np.where(along < until, wave, 0.0)


def search(
    reached: Callable[[FloatArray], FloatArray],
    bounds: Sequence[tuple[float, float]],
    *,
    drives: int,
    generations: int,
    seed: int,
) -> tuple[float, list[float], int]:
    """Return the largest value of `reached`, from (tries, numbers) to (tries,), that differential
    evolution finds, its numbers, and the tries."""
    best, found, tries = 0.0, [], 0

    def lowest(numbers: FloatArray) -> FloatArray:
        nonlocal best, found, tries
        values = reached(numbers.T)
        tries += len(values)
        if values.max() > best:
            best, found = float(values.max()), numbers.T[int(values.argmax())].tolist()
        return -values

    low, high = np.array(bounds).T
    first = np.random.default_rng(seed).uniform(low, high, (drives, len(bounds)))
    options = {"tol": 0.0, "polish": False, "vectorized": True, "updating": "deferred"}
    differential_evolution(lowest, bounds, init=first, maxiter=generations, rng=seed, **options)
    return best, found, tries


def strong(rig: Rig, stronger: float) -> Rig:
    """Return the rig behind an amplifier without a limit of its current that could drive it so many
    times as far as Xmax at f0."""
    p, source = rig.actuator, rig.amplifier.source_impedance_ohm
    s = 1j * p.resonance_rad_s
    impedance = p.resistance_ohm + source + s * p.inductance_h
    friction = p.damping_n_s_per_m * s * impedance + p.force_factor_n_per_a**2 * s
    gain = stronger * p.x_max_m / abs(p.force_factor_n_per_a / friction) / rig.dac.full_scale_v
    free = replace(rig.amplifier, current_limit_a=math.inf)
    return replace(rig, amplifier=replace(free, gain=gain, output_limit_v=2.0 * gain))
