"""The resonance inverse as numbers that do not depend on the sample rate.

The filter cancels the poles of the actuator by zeros and adds a well damped pair of poles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy

from device.errors import UsageError
from device.rig import ActuatorParameters
from device.rig.actuator import state_space
from device.units import FloatArray

DAMPED_Q = 0.35
"""Q of the poles that replace those of the actuator, unless another rig would need a higher."""


@dataclass(frozen=True)
class Resonance:
    """A pair of poles: its magnitude over 2 pi in Hz, and its Q, at most 0.5 for real poles."""

    frequency_hz: float
    q: float

    def polynomial(self, samplerate: float) -> FloatArray:
        """Return (z - e^(pT)) (z - e^(p'T)) for the poles p and p', highest power first, (3,).

        The discrete model of the actuator has the same poles, so they cancel exactly at any rate.
        """
        w, damping = math.tau * self.frequency_hz, 1.0 / (2.0 * self.q)
        root = np.sqrt(complex(damping**2 - 1.0))
        pair = np.exp(np.array([-damping + root, -damping - root]) * w / samplerate)
        return np.array([1.0, -(pair[0] + pair[1]).real, (pair[0] * pair[1]).real])


def resonance_of(p: ActuatorParameters, source_impedance_ohm: float = 0.0) -> Resonance:
    """Return the pair of poles with which the actuator rings at this source impedance."""
    rate, _, _ = state_space(p, source_impedance_ohm)
    poles = np.linalg.eigvals(rate)
    # The coil's pole is real. The pair is complex, or the two slowest poles.
    pair = poles[np.lexsort((np.abs(poles), -np.abs(poles.imag)))][:2]
    magnitude = math.sqrt(abs(pair[0] * pair[1]))
    return Resonance(magnitude / math.tau, magnitude / -float((pair[0] + pair[1]).real))


def resonance_as_damped(p: ActuatorParameters, is_damped: bool) -> tuple[float, float, float]:
    """Return the resonance that a drive meets: 1 to 400 Hz, Q 0.1 to 20, gain before it in dB.

    is_damped: by a filter whose poles have `DAMPED_Q`, and whose gain makes up for what they take
    at the resonance.
    """
    ringing = resonance_of(p)
    hz, q = min(max(ringing.frequency_hz, 1.0), 400.0), min(max(ringing.q, 0.1), 20.0)
    if not is_damped or q <= DAMPED_Q:
        return hz, q, 0.0
    return hz, DAMPED_Q, 20.0 * math.log10(q / DAMPED_Q)


def inverse_sections(ringing: Resonance, wanted: Resonance, samplerate: float) -> FloatArray:
    """Return the second-order section that turns one resonance into another, (1, 6).

    Its gain is 1 at 0 Hz, and at most 1 if the wanted Q is lower at the same frequency. UsageError:
    a resonance is not below half the sample rate.
    """
    highest_hz = max(ringing.frequency_hz, wanted.frequency_hz)
    if not samplerate > 2.0 * highest_hz:
        raise UsageError(
            f"samplerate={samplerate!r} Hz is too low for a resonance at {highest_hz:.1f} Hz; "
            f"choose more than {2.0 * highest_hz:.0f} Hz"
        )
    zeros, poles = ringing.polynomial(samplerate), wanted.polynomial(samplerate)
    return np.array([[*(zeros * (poles.sum() / zeros.sum())), *poles]])


@dataclass(frozen=True)
class Damping:
    """One damping filter, and the amplifier that it is meant for.

    source_impedance_ohm: of the amplifier; 0 (voltage drive) damps (Qts), large: current drive
        (Qms).
    ringing, wanted: the resonance that the filter removes, and the one that replaces it.
    gain: additional factor.
    """

    source_impedance_ohm: float
    ringing: Resonance | None = None
    wanted: Resonance | None = None
    gain: float = 1.0

    def sections(self, samplerate: float) -> FloatArray:
        """Return the second-order sections without the gain, (n, 6), n 0 or 1."""
        if self.ringing is None or self.wanted is None:
            return np.empty((0, 6))
        return inverse_sections(self.ringing, self.wanted, samplerate)

    def filtered(self, signal: FloatArray, samplerate: float) -> FloatArray:
        """Return a whole signal, (frames,), damped from rest."""
        sections = self.sections(samplerate)
        scaled = self.gain * signal
        return np.asarray(scipy.signal.sosfilt(sections, scaled)) if len(sections) else scaled


def no_damping(source_impedance_ohm: float = 0.0) -> Damping:
    """Return a filter that changes nothing: only the amplifier's source impedance damps."""
    return Damping(source_impedance_ohm)


def inverse_damping(
    p: ActuatorParameters,
    wanted_q: float,
    source_impedance_ohm: float = 0.0,
    *,
    caution: float = 1.0,
    shift: float = 1.0,
) -> Damping:
    """Return the resonance inverse with a chosen Q at the actuator's ringing frequency.

    wanted_q: above 0; up to 0.5 the actuator does not swing. caution: factor on the removed Q, up
    to 1. A lower value makes the dip in the drive shallower: it needs fewer volts and tolerates
    another resonance better, but damps less. shift: factor on the frequency. Above 1 it tolerates a
    higher resonance better, and a lower one worse.
    """
    ringing = resonance_of(p, source_impedance_ohm)
    frequency_hz = shift * ringing.frequency_hz
    removed = Resonance(frequency_hz, caution * ringing.q)
    return Damping(source_impedance_ohm, removed, Resonance(frequency_hz, wanted_q))
