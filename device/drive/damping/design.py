"""A way of damping, as numbers that do not depend on the samplerate."""

import math
from dataclasses import dataclass, replace

import numpy as np

from device.drive.damping.inverse import Resonance, inverse_sections, resonance_of
from device.drive.damping.shaper import Impulses, ShaperKind, input_shaper
from device.errors import UsageError
from device.rig import ActuatorParameters
from device.units import FloatArray


@dataclass(frozen=True)
class Damping:
    """What is done to the drive, and the amplifier that it is meant for.

    name: what a user chooses it by. source_impedance_ohm: of that amplifier; 0 is voltage drive,
    which damps by itself (Qts), a large one current drive, which does not (Qms). ringing, wanted:
    the resonance that a resonance inverse removes and the one it puts there, or None. impulses:
    of an input shaper, or None. gain: applied besides, 1 unless a level is to be made up for.
    """

    name: str
    source_impedance_ohm: float
    ringing: Resonance | None = None
    wanted: Resonance | None = None
    impulses: Impulses | None = None
    gain: float = 1.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.gain) and self.gain > 0.0):
            raise UsageError(f"gain={self.gain!r} of the damping must be above 0; correct it")
        if (self.ringing is None) != (self.wanted is None):
            raise UsageError("a resonance inverse needs both resonances, ringing and wanted")

    @property
    def latency_s(self) -> float:
        """By how much the vibration comes later, s: 0 but for a shaper.

        The inverse is of minimum phase: the first sample passes at once, and with a lower Q the
        seat moves sooner, not later.
        """
        return self.impulses.latency_s if self.impulses else 0.0

    def sections(self, samplerate: float) -> FloatArray:
        """(n, 6): second-order sections with n 0 or 1, without the gain."""
        if self.ringing is None or self.wanted is None:
            return np.empty((0, 6))
        return inverse_sections(self.ringing, self.wanted, samplerate)

    def taps(self, samplerate: float) -> FloatArray:
        """(frames,): what the shaper convolves with; one tap of 1 without a shaper."""
        return self.impulses.taps(samplerate) if self.impulses else np.ones(1)

    def with_gain(self, gain: float) -> "Damping":
        """The same with another gain, above 0."""
        return replace(self, gain=gain)


def no_damping(source_impedance_ohm: float = 0.0) -> Damping:
    """The drive as it is: only the amplifier's source impedance damps."""
    return Damping("none", source_impedance_ohm)


def inverse_damping(
    p: ActuatorParameters,
    wanted_q: float,
    source_impedance_ohm: float = 0.0,
    *,
    caution: float = 1.0,
) -> Damping:
    """The resonance inverse to a chosen Q, at the frequency at which the actuator rings.

    wanted_q: what is left, above 0; 0.5 and less come to rest without swinging. caution: above 0
    to 1; times the Q that is removed. Below 1 the dip in the drive is shallower, and so takes
    fewer volts to make up for and suffers less from a resonance that lies beside it, but it does
    less on it.
    """
    if not 0.0 < caution <= 1.0:
        raise UsageError(f"caution={caution!r} must be above 0 and at most 1; correct it")
    ringing = resonance_of(p, source_impedance_ohm)
    return Damping(
        "inverse",
        source_impedance_ohm,
        ringing=Resonance(ringing.frequency_hz, caution * ringing.q),
        wanted=Resonance(ringing.frequency_hz, wanted_q),
    )


def shaper_damping(
    p: ActuatorParameters,
    kind: ShaperKind,
    source_impedance_ohm: float = 0.0,
    *,
    shift: float = 1.0,
) -> Damping:
    """An input shaper for the actuator; UsageError where it does not ring by itself.

    shift: times the frequency at which it rings. A few percent make the worst case better, since
    what is left is not the same above and below it.
    """
    ringing = resonance_of(p, source_impedance_ohm)
    tuned = replace(ringing, frequency_hz=shift * ringing.frequency_hz)
    return Damping(kind, source_impedance_ohm, impulses=input_shaper(tuned, kind))
