"""What a user may choose of one actuator, and of several together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from device.drive.channel_map import CHANNELS_MAX, Wiring, check_wiring
from device.errors import UsageError
from device.units import db_to_amplitude

SOURCES = ("mix", "left", "right", "front", "back")
"""Which vibration an actuator may play; "all" says the same as "mix"."""

POLARITIES = ("normal", "inverted")
SWITCHES = {
    "damping": ("off", "auto"),
    "protection": ("off", "on"),
    "exposure_cap": ("off", "action", "limit"),
}

GAIN_MIN_DB, GAIN_MAX_DB = -60.0, 0.0
"""At 0 dB full scale of the vibration is full scale of the device: more would be cut."""

DELAY_MAX_MS = 500.0
"""Sound takes half a second for 170 m, which is further apart than any two seats; memory for so
much is taken from the start."""

ACTUATORS_MAX = CHANNELS_MAX
"""Each needs a channel of its own."""


@dataclass(frozen=True)
class ActuatorSettings:
    """One actuator.

    source: one of `SOURCES`; channels: of the device, counted from 0, or by the positions that a
    sound server gives them, such as "front-left": one or more, none twice. rig: what it is, a name
    or a file; damping, protection, exposure_cap: what is done for it; None each for what holds for
    all. gain_db: its level, -60 to 0; polarity: one of `POLARITIES`; delay_ms: by how much it is
    later than it would have to be, 0 to 500, rounded to the nearest frame.

    Raises
    ------
    UsageError
        Names every choice that cannot be. Whether there is such a rig is not looked at.
    """

    channels: tuple[int | str, ...]
    source: str = SOURCES[0]
    rig: str | None = None
    gain_db: float = GAIN_MAX_DB
    polarity: str = POLARITIES[0]
    delay_ms: float = 0.0
    damping: str | None = None
    protection: str | None = None
    exposure_cap: str | None = None

    def __post_init__(self) -> None:
        chosen = {field.name: getattr(self, field.name) for field in fields(self)}
        found = problems({name: value for name, value in chosen.items() if value is not None})
        if found:
            raise UsageError(
                "; ".join(
                    f"{name}={chosen[name]!r} {wrong}; allowed: {allowed}"
                    for name, (wrong, allowed) in found.items()
                )
            )
        if self.source == "all":
            object.__setattr__(self, "source", "mix")

    @property
    def factor(self) -> float:
        """What level and polarity multiply by: -1 to 1."""
        amplitude = db_to_amplitude(self.gain_db)
        return -amplitude if self.polarity == "inverted" else amplitude

    @classmethod
    def from_document(cls, values: Mapping[str, Any]) -> ActuatorSettings:
        """What a table of a config file means; `problems` has found nothing wrong in it."""
        chosen = {**values, "channels": tuple(values["channels"])}
        for name in ("gain_db", "delay_ms"):
            if name in chosen:
                chosen[name] = float(chosen[name])
        return cls(**chosen)


KEYS = tuple(field.name for field in fields(ActuatorSettings))


def problems(values: Mapping[str, Any]) -> dict[str, tuple[str, str]]:
    """What is wrong with one actuator's choices, by name: (what is wrong, what is allowed).

    Values may be of any type, as a config file has them. Unknown names, and the rig, are the
    caller's to look at.
    """
    found = {
        "channels": _check_channels(values.get("channels", ())),
        "source": _check_choice(values.get("source", SOURCES[0]), (*SOURCES, "all")),
        "polarity": _check_choice(values.get("polarity", POLARITIES[0]), POLARITIES),
        "gain_db": _check_number(values.get("gain_db", 0.0), GAIN_MIN_DB, GAIN_MAX_DB, "dB"),
        "delay_ms": _check_number(values.get("delay_ms", 0.0), 0.0, DELAY_MAX_MS, "ms"),
        **{
            name: _check_choice(values.get(name, allowed[0]), allowed)
            for name, allowed in SWITCHES.items()
        },
    }
    return {name: problem for name, problem in found.items() if problem is not None}


def problems_together(wired: Sequence[Sequence[int | str]]) -> dict[int, tuple[str, str]]:
    """What is wrong with the channels of several actuators, by the actuator's number from 1."""
    if len(wired) > ACTUATORS_MAX:
        return {ACTUATORS_MAX + 1: ("is one too many", f"up to {ACTUATORS_MAX} actuators")}
    return check_wiring(wired)


def sources_of(actuators: Sequence[ActuatorSettings]) -> tuple[str, ...]:
    """The sources that somebody plays, each once, in the order of `SOURCES`."""
    played = {actuator.source for actuator in actuators}
    return tuple(source for source in SOURCES if source in played)


def wiring_of(actuators: Sequence[ActuatorSettings]) -> Wiring:
    """The channels of every actuator."""
    return tuple(actuator.channels for actuator in actuators)


def _check_channels(value: Any) -> tuple[str, str] | None:
    allowed = (
        f"a list of the device's channels, counted from 0 (up to {CHANNELS_MAX - 1}), or by "
        'positions such as "front-left"'
    )
    if not isinstance(value, (list, tuple)):
        return "is no list", allowed
    if not value:
        return "names no channel", allowed
    for channel in value:
        if isinstance(channel, str):
            good = bool(channel) and channel == channel.strip()
        else:
            good = type(channel) is int and 0 <= channel < CHANNELS_MAX
        if not good:
            return "names what is no channel", allowed
    if len(set(value)) < len(value):
        return "names a channel twice", "each channel once"
    return None


def _check_choice(value: Any, allowed: tuple[str, ...]) -> tuple[str, str] | None:
    if isinstance(value, str) and value in allowed:
        return None
    return "is not known", ", ".join(allowed)


def _check_number(value: Any, low: float, high: float, unit: str) -> tuple[str, str] | None:
    allowed = f"{low:g} to {high:g} {unit}"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return "is not a number", allowed
    return None if low <= value <= high else ("is out of range", allowed)
