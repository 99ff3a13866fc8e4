"""An actuator behind any coil impedance: a simulator that shares nothing with what is fitted.

It solves a whole signal in the frequency domain: the linear part exactly for any law of the coil,
whether its order is whole, fractional or infinite. The spring that hardens and the Bl that falls
are added as forces and voltages of the last solution, until nothing changes.
"""

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
from tests.support.random_rigs import log_uniform, random_rig

Law = Callable[[np.ndarray], np.ndarray]
"""The coil's impedance without its resistance, ohm, for s = j w."""

_REST_S = 2.0
"""Silence behind the signal, in which the rig comes to rest."""


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
    """L1 and any number of L || R in series: what a thick or layered conductor does."""

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
        s = 1j * math.tau * rfftfreq(length, 1.0 / samplerate)
        m, c, k = a.moving_mass_kg, a.damping_n_s_per_m, a.stiffness_n_per_m
        bl = a.force_factor_n_per_a
        electric = a.resistance_ohm + self.rig.amplifier.source_impedance_ohm + self.law(s)
        # y = x - z, the spring's length: force between mass and frame, which may move itself
        inertia, absolute = s**2 * m, np.ones_like(s)
        if self.seat and self.rig.seat:
            w = self.rig.seat
            frame = s**2 * w.mass_kg + s * w.damping_n_s_per_m + w.stiffness_n_per_m
            # m s^2 x = F = -frame z, so y = F (1 / (m s^2) + 1 / frame)
            absolute = frame / (frame + inertia)
        stiffness, drive = inertia * absolute + s * c + k, np.asarray(rfft(volts, length))
        force, emf = np.zeros_like(drive), np.zeros_like(drive)
        y = i = np.zeros(0)
        for _ in range(40):
            back = emf + s * bl * force / stiffness
            current = (drive - back) / (electric + s * bl**2 / stiffness)
            moved, before = (bl * current + force) / stiffness, y
            y, v, i = irfft(moved, length), irfft(s * moved, length), irfft(current, length)
            if large is None or (len(before) and np.abs(y - before).max() < 1e-7 * np.abs(y).max()):
                break
            share = (y / a.x_max_m) ** 2
            lost = bl * large.force_factor_loss * share
            force = rfft(-k * large.stiffness_rise * share * y - lost * i)
            emf = rfft(-lost * v)
        else:
            raise AssertionError("the excursion is too large for this simulator")
        frames = len(volts)
        acceleration = irfft(s**2 * moved * absolute, length)[:frames]
        return Motion(y[:frames], v[:frames], i[:frames], acceleration)


class EddyActuator:
    """A linear actuator with L1 + (L2 || R2), block by block; exact for straight lines of volts."""

    def __init__(self, p: ActuatorParameters, samplerate: float, source_ohm: float) -> None:
        m, bl = p.moving_mass_kg, p.force_factor_n_per_a
        main, inner = p.inductance_h, p.inductance_eddy_h
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
        pushed = np.outer(self._inverse @ self._before, np.concatenate([[self._last], volts[:-1]]))
        pushed += np.outer(self._inverse @ self._now, volts)
        modes = np.empty_like(pushed)
        for k, value in enumerate(self._values):
            modes[k], _ = lfilter([1.0], [1.0, -value], pushed[k], zi=[value * self._state[k]])
        if len(volts):
            self._state, self._last = modes[:, -1], float(volts[-1])
        states = (self._vectors @ modes).real
        return Motion(states[0], states[1], states[2], self._acceleration @ states)


KINDS = ("plain", "parallel", "leach")


def random_coil_rig(seed: int, kind: str | None = None) -> tuple[CoilRig, str]:
    """A random rig, every third one on a seat, with a coil of one of KINDS; and which it is."""
    rig, _ = random_rig(seed)
    random, kind = np.random.default_rng([seed, 1]), kind or KINDS[seed % 3]
    seat, r = bool(random.random() < 0.33), rig.actuator.resistance_ohm
    reactance, w = r * log_uniform(random, 0.05, 0.6), math.tau * 200.0
    big = reactance / w
    if kind == "plain":
        main = rig.actuator.inductance_h
        law = ladder(main)
    elif kind == "parallel":
        main = big * float(random.uniform(0.2, 1.0))
        eddy = big * float(random.uniform(0.5, 2.0))
        ohm = math.tau * log_uniform(random, 60.0, 600.0) * eddy
        law = ladder(main, (eddy, ohm))
    elif kind == "leach":
        exponent = float(random.uniform(0.5, 0.85))
        law, main = leach(reactance / w**exponent, exponent), big
    elif kind == "diffusion":
        main = 0.3 * reactance / w
        law = diffusion(main, big, log_uniform(random, 20.0, 200.0))
    elif kind == "ladder":
        main = 0.3 * reactance / w
        hz = [log_uniform(random, 40.0, 1000.0) for _ in range(3)]
        parts = zip((1.0, 0.5, 0.3), hz, strict=True)
        law = ladder(main, *((share * big, math.tau * c * share * big) for share, c in parts))
    else:
        raise AssertionError(kind)
    actuator = replace(rig.actuator, inductance_h=main)
    if kind == "parallel":
        actuator = replace(actuator, inductance_eddy_h=eddy, resistance_eddy_ohm=ohm)
    return CoilRig(replace(rig, actuator=actuator), law, seat), kind
