"""The parameters of each stage between the vibration signal and the seat, with units.

Symbols are those of Thiele and Small for moving-coil transducers: Qms, Qes, Qts; and of the paper
(equations 8-10): m x'' + c x' + k x = F with k = m w0^2. Where a value comes from is said beside
it, in the rig's file (rig_file.py).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, get_args

from device.errors import UsageError


@dataclass(frozen=True)
class Limit:
    """Whether a value is allowed, and what it must be: "above 0"."""

    test: Callable[[Any], bool]
    words: str

    def allows(self, value: object) -> bool:
        """Whether the value is allowed; one of a type that cannot be tested is not."""
        try:
            return not isinstance(value, bool) and self.test(value)
        except (TypeError, OverflowError):  # a word; a whole number beyond all floats
            return False


POSITIVE = Limit(lambda value: math.isfinite(value) and value > 0, "above 0")
NOT_NEGATIVE = Limit(lambda value: math.isfinite(value) and value >= 0, "0 or more")
NOT_POSITIVE = Limit(lambda value: math.isfinite(value) and value <= 0, "0 or less")
UP_TO_INFINITY = Limit(lambda value: value > 0, "above 0, or inf")
SHARE = Limit(lambda value: 0 <= value < 1, "from 0 to below 1")


def whole(lowest: int, highest: int) -> Limit:
    """A whole number in a range, both ends allowed."""
    return Limit(
        lambda value: isinstance(value, int) and lowest <= value <= highest,
        f"a whole number, {lowest} to {highest}",
    )


def one_of(*words: str) -> Limit:
    """One of some words."""
    return Limit(lambda value: value in words, " or ".join(repr(word) for word in words))


DriveMode = Literal["voltage", "current"]


class Stage:
    """What all stages share: their values are within LIMITS, or constructing one raises.

    Raises
    ------
    UsageError
        It names every parameter that is out of range, and what it must be.
    """

    LIMITS: ClassVar[dict[str, Limit]] = {}

    def __post_init__(self) -> None:
        wrong = self.problems(vars(self))
        if wrong:
            stage = type(self).__name__.removesuffix("Parameters")
            raise UsageError(f"{stage} of the rig: {'; '.join(wrong)}; correct the rig")

    @classmethod
    def problems(cls, values: dict[str, Any]) -> list[str]:
        """What is wrong with the values, each with its limit; nothing of those that are absent."""
        found = [
            f"{name}={values[name]!r} must be {limit.words}"
            for name, limit in cls.LIMITS.items()
            if name in values and not limit.allows(values[name])
        ]
        return found or cls.contradictions(values)

    @classmethod
    def contradictions(cls, values: dict[str, Any]) -> list[str]:
        """Which values, each allowed by itself, do not go together."""
        low, high = values.get("low_cut_hz", 0.0), values.get("high_cut_hz", math.inf)
        if low < high:
            return []
        return [f"low_cut_hz={low!r} must be below high_cut_hz={high!r}"]


@dataclass(frozen=True)
class DacParameters(Stage):
    """A digital-to-analogue converter.

    bits: 8 to 32; full_scale_v: peak volts for a sample of 1.0; samplerate_hz: the rate it is
    meant for; latency_s: from a sample's turn to its voltage. volume_limit_db: its own volume is
    never set above this, 0 or less, on this rig; full_scale_v is at 0 dB.
    """

    bits: int
    full_scale_v: float
    samplerate_hz: float = 48_000.0
    latency_s: float = 0.0
    volume_limit_db: float = 0.0

    LIMITS: ClassVar = {
        "bits": whole(8, 32),
        "full_scale_v": POSITIVE,
        "samplerate_hz": POSITIVE,
        "latency_s": NOT_NEGATIVE,
        "volume_limit_db": NOT_POSITIVE,
    }


@dataclass(frozen=True)
class AmplifierParameters(Stage):
    """A power amplifier.

    gain: volts out, without a load, per volt in; output_limit_v: peak volts where it clips;
    source_impedance_ohm: in series with the actuator, 0 for an ideal voltage drive and far above
    the coil's resistance for a current drive. low_cut_hz, high_cut_hz: corners, -3 dB, of its
    band; 0 and infinity leave an end open. current_limit_a: peak. channels: actuators it drives.
    """

    gain: float
    output_limit_v: float
    source_impedance_ohm: float
    drive_mode: DriveMode = "voltage"
    low_cut_hz: float = 0.0
    high_cut_hz: float = math.inf
    current_limit_a: float = math.inf
    channels: int = 1

    LIMITS: ClassVar = {
        "gain": POSITIVE,
        "output_limit_v": POSITIVE,
        "source_impedance_ohm": NOT_NEGATIVE,
        "drive_mode": one_of(*get_args(DriveMode)),
        "low_cut_hz": NOT_NEGATIVE,
        "high_cut_hz": UP_TO_INFINITY,
        "current_limit_a": UP_TO_INFINITY,
        "channels": whole(1, 64),
    }


@dataclass(frozen=True)
class ActuatorParameters(Stage):
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

    LIMITS: ClassVar = {
        "moving_mass_kg": POSITIVE,
        "resonance_hz": POSITIVE,
        "q_mechanical": POSITIVE,
        "force_factor_n_per_a": POSITIVE,
        "resistance_ohm": POSITIVE,
        "inductance_h": POSITIVE,
        "x_max_m": POSITIVE,
    }

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
class LargeSignalParameters(Stage):
    """How an actuator departs from the linear one as it moves out to Xmax, and its end stops.

    stiffness_rise: share that k has gained at Xmax, either way; force_factor_loss: share that Bl
    has lost there; inductance_change: L is L0 (1 - change tanh(x / Xmax)). stop_m: excursion,
    either way, where the stops begin; they push back by stop_n_per_m2 times the indentation
    squared, more by stop_loss_s_per_m times the speed inwards, as shares (Hunt-Crossley).
    """

    stop_m: float
    stiffness_rise: float = 0.5
    force_factor_loss: float = 0.25
    inductance_change: float = 0.3
    stop_n_per_m2: float = 1.3e9
    stop_loss_s_per_m: float = 0.5

    LIMITS: ClassVar = {
        "stop_m": POSITIVE,
        "stiffness_rise": NOT_NEGATIVE,
        "force_factor_loss": SHARE,
        "inductance_change": SHARE,
        "stop_n_per_m2": NOT_NEGATIVE,
        "stop_loss_s_per_m": NOT_NEGATIVE,
    }


@dataclass(frozen=True)
class ThermalParameters(Stage):
    """Coil and magnet as two masses that warm up.

    coil_k_per_w, coil_j_per_k: from coil to magnet, and of the coil; magnet_k_per_w,
    magnet_j_per_k: from magnet to the surroundings; ambient_c: their temperature, in Celsius, at
    which the resistance is as stated.
    """

    coil_k_per_w: float
    coil_j_per_k: float
    magnet_k_per_w: float
    magnet_j_per_k: float
    ambient_c: float = 20.0

    LIMITS: ClassVar = {
        "coil_k_per_w": POSITIVE,
        "coil_j_per_k": POSITIVE,
        "magnet_k_per_w": POSITIVE,
        "magnet_j_per_k": POSITIVE,
        "ambient_c": Limit(lambda t: -50 <= t <= 150, "from -50 to 150"),
    }


@dataclass(frozen=True)
class SeatParameters(Stage):
    """The frame with the cushion and the sitter on it: a second mass, on spring and damper.

    mass_kg: what the actuator's frame moves; stiffness_n_per_m, damping_n_s_per_m: against the
    ground; a soft spring comes close to a free frame.
    """

    mass_kg: float
    stiffness_n_per_m: float
    damping_n_s_per_m: float

    LIMITS: ClassVar = {
        "mass_kg": POSITIVE,
        "stiffness_n_per_m": POSITIVE,
        "damping_n_s_per_m": NOT_NEGATIVE,
    }


@dataclass(frozen=True)
class AccelerometerParameters(Stage):
    """A piezoelectric accelerometer: charge for acceleration, with a resonance of its own.

    limit_m_s2: the largest acceleration it shows, either way.
    """

    sensitivity_pc_per_m_s2: float
    resonance_hz: float
    q_resonance: float
    limit_m_s2: float

    LIMITS: ClassVar = {
        "sensitivity_pc_per_m_s2": POSITIVE,
        "resonance_hz": POSITIVE,
        "q_resonance": POSITIVE,
        "limit_m_s2": POSITIVE,
    }


@dataclass(frozen=True)
class ConditioningParameters(Stage):
    """A charge amplifier: volts for charge, between two corners (-3 dB).

    gain_v_per_pc; noise_pc: r.m.s. at its input over its whole band; output_limit_v: peak.
    """

    gain_v_per_pc: float
    low_cut_hz: float
    high_cut_hz: float
    noise_pc: float
    output_limit_v: float

    LIMITS: ClassVar = {
        "gain_v_per_pc": POSITIVE,
        "low_cut_hz": NOT_NEGATIVE,
        "high_cut_hz": UP_TO_INFINITY,
        "noise_pc": NOT_NEGATIVE,
        "output_limit_v": POSITIVE,
    }


@dataclass(frozen=True)
class DaqParameters(Stage):
    """A data-acquisition input: bits over ±range_v, noise_v r.m.s., and the highest rate."""

    bits: int
    range_v: float
    noise_v: float
    max_samplerate_hz: float

    LIMITS: ClassVar = {
        "bits": whole(8, 32),
        "range_v": POSITIVE,
        "noise_v": NOT_NEGATIVE,
        "max_samplerate_hz": POSITIVE,
    }
