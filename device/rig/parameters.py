"""The parameters of each stage of a rig, with units and allowed values.

Symbols follow Thiele and Small for moving-coil transducers (Qms, Qes, Qts), and the paper
(equations 8-10): m x'' + c x' + k x = F with k = m w0^2.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, Literal, get_args

from device.errors import UsageError


@dataclass(frozen=True)
class Limit:
    """The allowed values, and their description for a message, such as "above 0"."""

    test: Callable[[Any], bool]
    words: str

    def allows(self, value: object) -> bool:
        """Whether the value is allowed; a value of the wrong type is not allowed."""
        try:
            return not isinstance(value, bool) and self.test(value)
        except (TypeError, OverflowError):  # a text; an integer beyond the range of float
            return False


def _whole(lowest: int, highest: int) -> Limit:
    return Limit(
        lambda value: isinstance(value, int) and lowest <= value <= highest,
        f"a whole number, {lowest} to {highest}",
    )


Positive = Annotated[float, Limit(lambda x: math.isfinite(x) and x > 0, "above 0")]
NotNegative = Annotated[float, Limit(lambda x: math.isfinite(x) and x >= 0, "0 or more")]
NotPositive = Annotated[float, Limit(lambda x: math.isfinite(x) and x <= 0, "0 or less")]
UpToInfinity = Annotated[float, Limit(lambda value: value > 0, "above 0, or inf")]
Share = Annotated[float, Limit(lambda value: 0 <= value < 1, "from 0 to below 1")]
Celsius = Annotated[float, Limit(lambda t: -50 <= t <= 150, "from -50 to 150")]
Bits = Annotated[int, _whole(8, 32)]
DriveMode = Literal["voltage", "current"]
DRIVE_MODES = Limit(lambda word: word in get_args(DriveMode), "'voltage' or 'current'")

Model = Literal["auto", "linear", "nonlinear"]  # the user's choice of actuator model
MODELS: tuple[Model, ...] = get_args(Model)
LEAST_TOLERANCE = 1e-5  # smallest error, relative to the peak, that a user may request


class Stage:
    """Base class of all stages. Each field is annotated with its `Limit`."""

    def __post_init__(self) -> None:
        if wrong := self.problems(vars(self)):
            stage = type(self).__name__.removesuffix("Parameters")
            raise UsageError(f"{stage} of the rig: {'; '.join(wrong)}; correct the rig")

    @classmethod
    def limits(cls) -> dict[str, Limit]:
        """Return the `Limit` of each parameter, by name."""
        return {field.name: get_args(field.type)[1] for field in fields(cls)}  # type: ignore[arg-type]

    @classmethod
    def problems(cls, values: dict[str, Any]) -> list[str]:
        """Return an error text for each invalid value; missing values are ignored."""
        found = [
            f"{name}={values[name]!r} must be {limit.words}"
            for name, limit in cls.limits().items()
            if name in values and not limit.allows(values[name])
        ]
        low, high = values.get("low_cut_hz", 0.0), values.get("high_cut_hz", math.inf)
        if not found and not low < high:
            found = [f"low_cut_hz={low!r} must be below high_cut_hz={high!r}"]
        return found


@dataclass(frozen=True)
class DacParameters(Stage):
    """A digital-to-analogue converter. Its own volume is never set above volume_limit_db."""

    bits: Bits
    full_scale_v: Positive  # peak volts for a sample of 1.0 at a volume of 0 dB
    samplerate_hz: Positive = 48_000.0
    latency_s: NotNegative = 0.0  # from the clock edge of a sample to its voltage
    volume_limit_db: NotPositive = 0.0


@dataclass(frozen=True)
class AmplifierParameters(Stage):
    """A power amplifier. A low cut of 0 or a high cut of infinity omits the filter."""

    gain: Positive  # open-circuit output volts per input volt
    output_limit_v: Positive  # peak volts at which it clips
    source_impedance_ohm: NotNegative  # 0: ideal voltage drive; far above R: current drive
    drive_mode: Annotated[DriveMode, DRIVE_MODES] = "voltage"
    low_cut_hz: NotNegative = 0.0  # -3 dB
    high_cut_hz: UpToInfinity = math.inf  # -3 dB
    current_limit_a: UpToInfinity = math.inf  # peak
    channels: Annotated[int, _whole(1, 64)] = 1  # number of actuators that it can drive


EDDY = ("inductance_eddy_h", "resistance_eddy_ohm")  # both parameters are 0, or both are above 0


@dataclass(frozen=True)
class ActuatorParameters(Stage):
    """A voice-coil actuator near its rest position; all but the last two values are above 0.

    moving_mass_kg: m. resonance_hz: f0, undamped. q_mechanical: Qms, the Q with the coil open.
    force_factor_n_per_a: Bl. resistance_ohm, inductance_h: R and L of the coil. x_max_m: excursion
    in either direction up to which the linear model holds. inductance_eddy_h, resistance_eddy_ohm:
    L2 and R2 of eddy currents: R2 parallel to L2, in series with L; 0 for none. Only calibration
    uses L2 and R2. UsageError: a parameter is out of range.
    """

    moving_mass_kg: Positive
    resonance_hz: Positive
    q_mechanical: Positive
    force_factor_n_per_a: Positive
    resistance_ohm: Positive
    inductance_h: Positive
    x_max_m: Positive
    inductance_eddy_h: NotNegative = 0.0
    resistance_eddy_ohm: NotNegative = 0.0

    @classmethod
    def problems(cls, values: dict[str, Any]) -> list[str]:
        """Return an error text for each invalid value, and one if only one of L2 and R2 is 0."""
        found = super().problems(values)
        other, given = sorted(EDDY, key=lambda name: bool(values.get(name, 0.0)))
        if not found and values.get(given, 0.0) and not values.get(other, 0.0):
            found = [f"{given}={values[given]!r} needs {other} above 0 as well, or both must be 0"]
        return found

    def coil_ohm(self, s: complex) -> complex:
        """Return the coil's impedance without motion, R + s L + (s L2 parallel to R2)."""
        if eddy := s * self.inductance_eddy_h:
            eddy *= self.resistance_eddy_ohm / (self.resistance_eddy_ohm + eddy)
        return self.resistance_ohm + s * self.inductance_h + eddy

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
        """Return Qes = m w0 (R + Rs) / Bl^2: damping by the current that the motion induces."""
        resistance = self.resistance_ohm + source_impedance_ohm
        inertia = self.moving_mass_kg * self.resonance_rad_s
        return inertia * resistance / self.force_factor_n_per_a**2

    def q_total(self, source_impedance_ohm: float = 0.0) -> float:
        """Return Qts = 1 / (1 / Qms + 1 / Qes); inductance is neglected as usual."""
        return 1.0 / (1.0 / self.q_mechanical + 1.0 / self.q_electrical(source_impedance_ohm))


def detune(p: ActuatorParameters, share: float) -> ActuatorParameters:
    """Return the actuator with another stiffness, so that f0 changes by a share (-0.1: -10 %)."""
    factor = 1.0 + share
    return replace(p, resonance_hz=p.resonance_hz * factor, q_mechanical=p.q_mechanical * factor)


def vary(
    p: ActuatorParameters, mass: float = 1.0, stiffness: float = 1.0, force_factor: float = 1.0
) -> ActuatorParameters:
    """Return the actuator with scaled moving mass, stiffness and Bl, and unchanged friction."""
    ratio, impedance = math.sqrt(stiffness / mass), math.sqrt(stiffness * mass)
    return replace(
        p,
        moving_mass_kg=p.moving_mass_kg * mass,
        resonance_hz=p.resonance_hz * ratio,
        q_mechanical=p.q_mechanical * impedance,
        force_factor_n_per_a=p.force_factor_n_per_a * force_factor,
    )


@dataclass(frozen=True)
class LargeSignalParameters(Stage):
    """Deviations of an actuator from the linear model up to Xmax, and its end stops."""

    stop_m: Positive  # excursion, in both directions, at which the end stops begin
    stiffness_rise: NotNegative = 0.5  # relative increase of k at Xmax
    force_factor_loss: Share = 0.25  # relative decrease of Bl at Xmax
    inductance_change: Share = 0.3  # L is L0 (1 - change tanh(x / Xmax))
    stop_n_per_m2: NotNegative = 1.3e9  # force over the squared indentation of an end stop
    stop_loss_s_per_m: NotNegative = 0.5  # relative rise of this force per m/s (Hunt-Crossley 1975)


@dataclass(frozen=True)
class ThermalParameters(Stage):
    """Coil and magnet as two thermal masses."""

    coil_k_per_w: Positive  # thermal resistance from coil to magnet
    coil_j_per_k: Positive
    magnet_k_per_w: Positive  # thermal resistance from magnet to the surroundings
    magnet_j_per_k: Positive
    ambient_c: Celsius = 20.0  # temperature for which the actuator's resistance is given


@dataclass(frozen=True)
class SeatParameters(Stage):
    """Frame, cushion and seated person: a second mass on a spring and damper to the ground."""

    mass_kg: Positive
    stiffness_n_per_m: Positive
    damping_n_s_per_m: NotNegative


@dataclass(frozen=True)
class AccelerometerParameters(Stage):
    """A piezoelectric accelerometer with its own resonance; its output is a charge."""

    sensitivity_pc_per_m_s2: Positive
    resonance_hz: Positive
    q_resonance: Positive
    limit_m_s2: Positive  # largest measurable acceleration in either direction


@dataclass(frozen=True)
class ConditioningParameters(Stage):
    """A charge amplifier: charge in, volts out, with a band between two corners (-3 dB)."""

    gain_v_per_pc: Positive
    low_cut_hz: NotNegative
    high_cut_hz: UpToInfinity
    noise_pc: NotNegative  # r.m.s. at the input, in the whole band
    output_limit_v: Positive  # peak


@dataclass(frozen=True)
class DaqParameters(Stage):
    """A data-acquisition input with a range of ±range_v."""

    bits: Bits
    range_v: Positive
    noise_v: NotNegative  # r.m.s.
    max_samplerate_hz: Positive
