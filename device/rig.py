"""Rigs: what stands between the vibration signal and the seat, as named parameters with units.

Symbols are those of Thiele and Small for moving-coil transducers: Qms, Qes, Qts; and of the paper
(equations 8-10): m x'' + c x' + k x = F with k = m w0^2.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

from device.errors import UsageError

_Limit = tuple[Callable[[Any], bool], str]
_POSITIVE: _Limit = (lambda value: math.isfinite(value) and value > 0, "above 0")
_NOT_NEGATIVE: _Limit = (lambda value: math.isfinite(value) and value >= 0, "0 or more")
_BITS: _Limit = (lambda bits: isinstance(bits, int) and 8 <= bits <= 32, "a whole number, 8 to 32")


def _validate(parameters: Any, limits: dict[str, _Limit]) -> None:
    wrong = []
    for name, (allowed, words) in limits.items():
        value = getattr(parameters, name)
        if not allowed(value):
            wrong.append(f"{name}={value!r} must be {words}")
    if wrong:
        stage = type(parameters).__name__.removesuffix("Parameters")
        raise UsageError(f"{stage} of the rig: {'; '.join(wrong)}; correct the rig")


@dataclass(frozen=True)
class DacParameters:
    """A digital-to-analogue converter.

    bits: 8 to 32; full_scale_v: peak volts for a sample of 1.0, above 0. Raises UsageError that
    names every parameter out of range; so do the other classes here.
    """

    bits: int
    full_scale_v: float

    def __post_init__(self) -> None:
        _validate(self, {"bits": _BITS, "full_scale_v": _POSITIVE})


@dataclass(frozen=True)
class AmplifierParameters:
    """A power amplifier.

    gain: volts out per volt in, above 0; output_limit_v: peak volts where it clips, above 0;
    source_impedance_ohm: in series with the actuator, 0 (voltage drive) or more.
    """

    gain: float
    output_limit_v: float
    source_impedance_ohm: float

    def __post_init__(self) -> None:
        limits = {"gain": _POSITIVE, "output_limit_v": _POSITIVE}
        _validate(self, limits | {"source_impedance_ohm": _NOT_NEGATIVE})


@dataclass(frozen=True)
class ActuatorParameters:
    """A voice-coil actuator about its rest position; every value is above 0.

    moving_mass_kg: m; resonance_hz: f0, undamped; q_mechanical: Qms, with the coil open;
    force_factor_n_per_a: Bl; resistance_ohm: R; inductance_h: L; x_max_m: excursion, either way,
    up to which the linear model is meant.
    """

    moving_mass_kg: float
    resonance_hz: float
    q_mechanical: float
    force_factor_n_per_a: float
    resistance_ohm: float
    inductance_h: float
    x_max_m: float

    def __post_init__(self) -> None:
        _validate(self, {field.name: _POSITIVE for field in fields(self)})

    @property
    def resonance_rad_s(self) -> float:
        """w0 = 2 pi f0, rad/s."""
        return math.tau * self.resonance_hz

    @property
    def stiffness_n_per_m(self) -> float:
        """k = m w0^2, N/m (equation 8)."""
        return self.moving_mass_kg * self.resonance_rad_s**2

    @property
    def damping_n_s_per_m(self) -> float:
        """c = m w0 / Qms, N s/m."""
        return self.moving_mass_kg * self.resonance_rad_s / self.q_mechanical

    def q_electrical(self, source_impedance_ohm: float = 0.0) -> float:
        """Qes = m w0 (R + Rs) / Bl^2: the damping by the current that the motion drives."""
        resistance = self.resistance_ohm + source_impedance_ohm
        return (
            self.moving_mass_kg * self.resonance_rad_s * resistance / self.force_factor_n_per_a**2
        )

    def q_total(self, source_impedance_ohm: float = 0.0) -> float:
        """Qts = 1 / (1 / Qms + 1 / Qes), inductance neglected as usual."""
        return 1.0 / (1.0 / self.q_mechanical + 1.0 / self.q_electrical(source_impedance_ohm))


@dataclass(frozen=True)
class Rig:
    """One chain from the vibration signal to the seat, under a name."""

    name: str
    dac: DacParameters
    amplifier: AmplifierParameters
    actuator: ActuatorParameters


PAPER = Rig(
    name="paper",
    # Assumed: a common USB DAC at line level.
    dac=DacParameters(bits=24, full_scale_v=1.0),
    amplifier=AmplifierParameters(
        # Assumed (the paper gives the amplifier, Type 2718, not its setting): a steady
        # full-scale 90 Hz vibration then gives 89.1 m/s^2 and moves 0.28 mm either way.
        gain=2.5,
        # Assumed from the class of that amplifier: 75 VA into 3 ohm are 15 V r.m.s.
        output_limit_v=21.2,
        # Assumed: voltage drive, which damps more than current drive.
        source_impedance_ohm=0.0,
    ),
    actuator=ActuatorParameters(
        resonance_hz=90.0,  # given: "about 90 Hz"
        moving_mass_kg=0.25,  # assumed; a body of 100 x 100 x 30 mm (given) has room for it
        q_mechanical=8.0,  # assumed
        force_factor_n_per_a=10.0,  # assumed
        resistance_ohm=3.3,  # assumed
        inductance_h=1e-3,  # assumed
        x_max_m=1.5e-3,  # assumed
    ),
)
"""The paper's rig. Given there: the resonance, the outer size and the instruments; the rest is
assumed, consistent in itself, and marked so: Qes 4.67, Qts 2.95 at voltage drive."""

_RIGS = {rig.name: rig for rig in (PAPER,)}


def rig_by_name(name: str) -> Rig:
    """The rig of that name, or UsageError listing the names there are."""
    try:
        return _RIGS[name]
    except KeyError:
        names = ", ".join(_RIGS)
        raise UsageError(f"no rig is named {name!r}; choose one of: {names}") from None
