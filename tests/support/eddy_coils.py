"""An actuator behind any coil impedance: a simulator that shares nothing with what is fitted.

It solves a whole signal in the frequency domain: the linear part exactly for any law of the coil,
whether its order is whole, fractional or infinite. The spring that hardens and the Bl that falls
are added as forces and voltages of the last solution, until nothing changes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.signal import lfilter

from device.rig import Rig
from device.rig.actuator import Motion, first_order_hold
from device.rig.parameters import ActuatorParameters
from device.units import FloatArray
from tests.support.random_rigs import random_rig

Law = Callable[[np.ndarray], np.ndarray]
"""The coil's impedance without its resistance, ohm, for s = j w."""

_REST_S = 2.0
"""Silence behind the signal, in which the rig comes to rest."""


def plain(inductance_h: float) -> Law:
    """An inductance."""
    return lambda s: s * inductance_h


def parallel(inductance_h: float, eddy_h: float, eddy_ohm: float) -> Law:
    """L1 + (L2 || R2)."""
    return lambda s: s * inductance_h + s * eddy_h * eddy_ohm / (eddy_ohm + s * eddy_h)


def leach(factor: float, exponent: float) -> Law:
    """K s^n: Leach, "Loudspeaker voice-coil inductance losses", JAES 50 (2002)."""
    return lambda s: factor * s**exponent


def diffusion(leak_h: float, inductance_h: float, corner_hz: float) -> Law:
    """Flux that diffuses into a conducting plate: tanh(u) / u with u = sqrt(s / (2 pi corner))."""

    def law(s: np.ndarray) -> np.ndarray:
        u = np.sqrt(np.where(s == 0.0, 1e-9, s) / (math.tau * corner_hz))
        return s * leak_h + s * inductance_h * np.tanh(u) / u

    return law


def ladder(inductance_h: float, *sections: tuple[float, float]) -> Law:
    """L1 and several L || R in series: what a thick or layered conductor does."""

    def law(s: np.ndarray) -> np.ndarray:
        z = s * inductance_h
        for eddy_h, eddy_ohm in sections:
            z = z + s * eddy_h * eddy_ohm / (eddy_ohm + s * eddy_h)
        return z

    return law


@dataclass(frozen=True)
class CoilRig:
    """A rig with a coil of its own law; its actuator's inductance does not count."""

    rig: Rig
    law: Law
    seat: bool = False

    def move(self, volts: FloatArray, samplerate: float) -> Motion:
        """Return acceleration and current for the amplifier's voltage, (frames,), from rest."""
        a, large = self.rig.actuator, self.rig.large_signal
        length = int(next_fast_len(len(volts) + round(_REST_S * samplerate), real=True))
        f = rfftfreq(length, 1.0 / samplerate)
        s = 1j * math.tau * f
        m, c, k = a.moving_mass_kg, a.damping_n_s_per_m, a.stiffness_n_per_m
        bl = a.force_factor_n_per_a
        electric = a.resistance_ohm + self.rig.amplifier.source_impedance_ohm + self.law(s)
        # y = x - z, the spring's length: force between mass and frame, which may move itself
        inertia = s**2 * m
        absolute = np.ones_like(s)
        if self.seat and self.rig.seat:
            w = self.rig.seat
            frame = s**2 * w.mass_kg + s * w.damping_n_s_per_m + w.stiffness_n_per_m
            # m s^2 x = F = -frame z, so y = F (1 / (m s^2) + 1 / frame)
            absolute = frame / (frame + inertia)
        stiffness = inertia * absolute + s * c + k
        drive = np.asarray(rfft(volts, length))
        force, emf = np.zeros_like(drive), np.zeros_like(drive)
        y = i = np.zeros(0)
        for _ in range(40):
            current = (drive - emf - s * bl * force / stiffness) / (
                electric + s * bl**2 / stiffness
            )
            moved = (bl * current + force) / stiffness
            before = y
            y, v, i = irfft(moved, length), irfft(s * moved, length), irfft(current, length)
            if large is None or (len(before) and np.abs(y - before).max() < 1e-7 * np.abs(y).max()):
                break
            share = (y / a.x_max_m) ** 2
            force = rfft(
                -k * large.stiffness_rise * share * y - bl * large.force_factor_loss * share * i
            )
            emf = rfft(-bl * large.force_factor_loss * share * v)
        else:
            raise AssertionError("the excursion is too large for this simulator")
        frames = len(volts)
        acceleration = irfft(s**2 * moved * absolute, length)[:frames]
        return Motion(y[:frames], v[:frames], i[:frames], acceleration)


class EddyActuator:
    """A linear actuator with L1 + (L2 || R2), block by block; exact for straight lines of volts."""

    def __init__(self, p: ActuatorParameters, samplerate: float, source_ohm: float) -> None:
        m, bl, main, inner = (
            p.moving_mass_kg, p.force_factor_n_per_a, p.inductance_h, p.inductance_eddy_h,
        )  # fmt: skip
        r, r2 = p.resistance_ohm + source_ohm, p.resistance_eddy_ohm
        rate = np.array(
            [
                [0.0, 1.0, 0.0, 0.0],
                [-p.stiffness_n_per_m / m, -p.damping_n_s_per_m / m, bl / m, 0.0],
                [0.0, -bl / main, -(r + r2) / main, r2 / main],
                [0.0, 0.0, r2 / inner, -r2 / inner],
            ]
        )
        drive = np.array([0.0, 0.0, 1.0 / main, 0.0])
        self._step, self._before, self._now = first_order_hold(rate, drive, 1.0 / samplerate)
        self._acceleration = rate[1]
        self._values, vectors = np.linalg.eig(self._step)
        self._vectors, self._inverse = vectors, np.linalg.inv(vectors)
        self._state, self._last = np.zeros(4, complex), 0.0

    def move(self, volts: FloatArray, _: object = None) -> Motion:
        """Return the next frames of the motion."""
        before = np.concatenate([[self._last], volts[:-1]])
        pushed = np.outer(self._inverse @ self._before, before)
        pushed += np.outer(self._inverse @ self._now, volts)
        modes = np.empty_like(pushed)
        for k, value in enumerate(self._values):
            start = [value * self._state[k]]
            modes[k], _ = lfilter([1.0], [1.0, -value], pushed[k], zi=start)
        if len(volts):
            self._state, self._last = modes[:, -1], float(volts[-1])
        states = (self._vectors @ modes).real
        return Motion(states[0], states[1], states[2], self._acceleration @ states)


KINDS = ("plain", "parallel", "leach")


def random_coil_rig(seed: int, kind: str | None = None) -> tuple[CoilRig, str]:
    """A random rig, every third one on a seat, with a coil of one of KINDS; and which it is.

    At 200 Hz, what eddy currents add is 5 to 60 % of the coil's resistance.
    """
    rig, _ = random_rig(seed)
    random = np.random.default_rng([seed, 1])
    kind = kind or KINDS[seed % 3]
    seat = bool(random.random() < 0.33)
    r = rig.actuator.resistance_ohm
    reactance = r * float(np.exp(random.uniform(math.log(0.05), math.log(0.6))))
    w = math.tau * 200.0
    if kind == "plain":
        law, main = plain(rig.actuator.inductance_h), rig.actuator.inductance_h
    elif kind == "parallel":
        main = reactance / w * float(random.uniform(0.2, 1.0))
        eddy = reactance / w * float(random.uniform(0.5, 2.0))
        corner = float(np.exp(random.uniform(math.log(60.0), math.log(600.0))))
        law = parallel(main, eddy, math.tau * corner * eddy)
    elif kind == "leach":
        exponent = float(random.uniform(0.5, 0.85))
        law, main = leach(reactance / w**exponent, exponent), reactance / w
    elif kind == "diffusion":
        main = 0.3 * reactance / w
        law = diffusion(
            main, reactance / w, float(np.exp(random.uniform(math.log(20.0), math.log(200.0))))
        )
    elif kind == "ladder":
        main = 0.3 * reactance / w
        hz = np.exp(random.uniform(math.log(40.0), math.log(1000.0), 3)).tolist()
        big = reactance / w
        law = ladder(
            main,
            *(
                (share * big, math.tau * c * share * big)
                for share, c in zip((1.0, 0.5, 0.3), hz, strict=True)
            ),
        )
    else:
        raise AssertionError(kind)
    actuator = replace(rig.actuator, inductance_h=main)
    if kind == "parallel":
        ohm = math.tau * corner * eddy
        actuator = replace(actuator, inductance_eddy_h=eddy, resistance_eddy_ohm=ohm)
    return CoilRig(replace(rig, actuator=actuator), law, seat), kind
