"""The resonance inverse: zeros on the poles of the actuator, and a well damped pair in their place.

The poles are those of the electro-mechanical system, not f0 and Qts: with a coil of 1 mH the
`paper` rig rings at 91.8 Hz, not 90, and zeros at 90 Hz would leave 1 dB more at +10 % of f0.
"""

import math
from dataclasses import dataclass

import numpy as np

from device.errors import UsageError
from device.rig import ActuatorParameters
from device.rig.actuator import state_space
from device.units import FloatArray


@dataclass(frozen=True)
class Resonance:
    """A pair of poles as frequency_hz (its magnitude over 2 pi) and q, 0.5 or less where real."""

    frequency_hz: float
    q: float

    def __post_init__(self) -> None:
        for name in ("frequency_hz", "q"):
            number = getattr(self, name)
            if not (math.isfinite(number) and number > 0.0):
                raise UsageError(f"{name}={number!r} of a resonance must be above 0; correct it")

    def polynomial(self, samplerate: float) -> FloatArray:
        """(3,): (z - e^(pT)) (z - e^(p'T)), highest power first, for its two poles p, p'.

        An actuator's own step has its poles at these places too, so what is divided by this is
        cancelled exactly, at any samplerate.
        """
        w = math.tau * self.frequency_hz
        damping = 1.0 / (2.0 * self.q)
        root = np.sqrt(complex(damping**2 - 1.0))
        pair = np.exp(np.array([-damping + root, -damping - root]) * w / samplerate)
        return np.array([1.0, -(pair[0] + pair[1]).real, (pair[0] * pair[1]).real])


def resonance_of(p: ActuatorParameters, source_impedance_ohm: float = 0.0) -> Resonance:
    """The pair of poles with which the actuator rings at this source impedance."""
    rate, _, _ = state_space(p, source_impedance_ohm)
    poles = np.linalg.eigvals(rate)
    # The coil's pole is real; the pair is complex, or the two slowest where damped critically.
    pair = poles[np.lexsort((np.abs(poles), -np.abs(poles.imag)))][:2]
    magnitude = math.sqrt(abs(pair[0] * pair[1]))
    return Resonance(magnitude / math.tau, magnitude / -float((pair[0] + pair[1]).real))


def inverse_sections(ringing: Resonance, wanted: Resonance, samplerate: float) -> FloatArray:
    """(1, 6): the second-order section that turns one resonance into another; gain 1 at 0 Hz.

    Where the wanted Q is the smaller one and the frequencies are alike, its gain for a steady
    tone is at most 1. Raises UsageError where a resonance is not below half the samplerate.
    """
    highest_hz = max(ringing.frequency_hz, wanted.frequency_hz)
    if not samplerate > 2.0 * highest_hz:
        raise UsageError(
            f"samplerate={samplerate!r} Hz is too low for a resonance at {highest_hz:.1f} Hz; "
            f"choose more than {2.0 * highest_hz:.0f} Hz"
        )
    zeros, poles = ringing.polynomial(samplerate), wanted.polynomial(samplerate)
    return np.array([[*(zeros * (poles.sum() / zeros.sum())), *poles]])
