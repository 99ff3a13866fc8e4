"""What each input channel carries, and its physical value at full scale."""

from dataclasses import dataclass

from device.errors import UsageError

QUANTITIES = ("acceleration", "current", "voltage", "loopback")
UNUSED = "-"
DRIVE = "drive"
"""The name of the played signal, and of its loop-back."""

MOST_CHANNELS = 32

Pair = tuple[str, str]


@dataclass(frozen=True)
class Inputs:
    """The input's channels in order, each of QUANTITIES or "-", and their scales."""

    names: tuple[str, ...]
    full_scale_v: float | None = None  # peak volts at the input for a sample of 1.0
    acceleration_v_per_m_s2: float | None = None  # accelerometer with its conditioning amplifier
    shunt_ohm: float | None = None  # the current's channel is across it
    voltage_ratio: float = 1.0  # volts at the coil per volt at the input

    def __post_init__(self) -> None:
        used = [name for name in self.names if name != UNUSED]
        unknown = [name for name in used if name not in QUANTITIES]
        twice = sorted({name for name in used if used.count(name) > 1})
        shown = ",".join(self.names)
        if unknown or twice or not 1 <= len(self.names) <= MOST_CHANNELS:
            what = f"1 to {MOST_CHANNELS} channels are possible"
            if unknown or twice:
                what = f"{unknown[0]!r} is unknown" if unknown else f"{', '.join(twice)} twice"
            raise UsageError(
                f"channels={shown}: {what}; name each input in order, of "
                f"{', '.join(QUANTITIES)}, and {UNUSED} for one that is not used"
            )
        if "acceleration" not in used and not {"voltage", "current"} <= set(used):
            raise UsageError(
                f"channels={shown}: nothing can be identified from that; name acceleration, or "
                "voltage and current"
            )
        for name, value in (
            ("input full scale", self.full_scale_v),
            ("acceleration sensitivity", self.acceleration_v_per_m_s2),
            ("shunt", self.shunt_ohm),
            ("voltage ratio", self.voltage_ratio),
        ):
            if value is not None and not 0.0 < value < 1e9:
                raise UsageError(f"{name}={value!r} must be above 0; correct it")
        physical = {"voltage", "current"} & set(used) or self.acceleration_scaled
        if physical and self.full_scale_v is None:
            raise UsageError(
                f"channels={shown}: volts, amperes and an acceleration sensitivity need the "
                "input's full scale; give --input-full-scale-v V, the peak volts that a sample of "
                "1.0 stands for"
            )
        if "current" in used and self.shunt_ohm is None:
            raise UsageError(
                f"channels={shown}: amperes need the resistance that the current's channel is "
                "across; give --shunt-ohm R"
            )

    @classmethod
    def parse(cls, text: str, **known: float | None) -> "Inputs":
        """Parse "acceleration,current,-"; `known` are the other fields, None for unknown ones."""
        names = tuple(part.strip() for part in text.split(","))
        return cls(names, **{key: value for key, value in known.items() if value is not None})

    @property
    def used(self) -> tuple[int, ...]:
        """The channels that are used, from 0."""
        return tuple(i for i, name in enumerate(self.names) if name != UNUSED)

    @property
    def acceleration_scaled(self) -> bool:
        """Whether acceleration is in m/s^2 rather than in shares of full scale."""
        return self.acceleration_v_per_m_s2 is not None

    def scale(self, name: str) -> float:
        """Return the physical value of a sample of 1.0: m/s^2, A, V at the coil; otherwise 1."""
        volts = self.full_scale_v or 1.0
        if name == "acceleration":
            return volts / self.acceleration_v_per_m_s2 if self.acceleration_v_per_m_s2 else 1.0
        if name == "current":
            assert self.shunt_ohm is not None
            return volts / self.shunt_ohm
        return volts * self.voltage_ratio if name == "voltage" else 1.0

    @property
    def pairs(self) -> tuple[Pair, ...]:
        """The available pairs (reference, response)."""
        there, pairs = set(self.names), []
        if {"current", "acceleration"} <= there:
            pairs.append(("current", "acceleration"))
        if {"voltage", "current"} <= there:
            pairs.append(("voltage", "current"))
        if "acceleration" in there:
            pairs.append(("voltage" if "voltage" in there else DRIVE, "acceleration"))
        return tuple(pairs)
