"""The settings of one actuator, and checks of several actuators together."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from device.drive.channel_map import CHANNELS_MAX, Wiring, check_wiring
from device.units import db_to_amplitude
from device.values import Choice, Described, Description, Number, Refusal, Text

SOURCES = ("mix", "left", "right", "front", "back")
POLARITIES = ("normal", "inverted")
DAMPING = ("off", "auto")
PROTECTION = ("off", "on")
EXPOSURE_CAP = ("off", "action", "limit")

GAIN_MIN_DB, GAIN_MAX_DB = -60.0, 0.0  # above 0 dB full-scale vibration would clip
# longest delay, which determines the allocated memory; sound travels 170 m in 500 ms
DELAY_MAX_MS = 500.0
ACTUATORS_MAX = CHANNELS_MAX  # largest number of actuators: one for each channel
LIKE_ALL = "; default: the top-level value"


@dataclass(frozen=True)
class _DeviceChannels(Description):
    """A list of a device's channels, each by number or by position, without duplicates."""

    @property
    def allowed(self) -> str:
        return (
            f"a list of channels, counted from 0 (up to {CHANNELS_MAX - 1}), or of positions such "
            'as "front-left"'
        )

    def refuse(self, value: object) -> Refusal | None:
        if not isinstance(value, (list, tuple)):
            return Refusal("is not a list", self.allowed)
        if not value:
            return Refusal("is an empty list", self.allowed)
        numbers = [one for one in value if not isinstance(one, str)]
        named = all(one and one == one.strip() for one in value if isinstance(one, str))
        if not named or not all(type(one) is int and 0 <= one < CHANNELS_MAX for one in numbers):
            return Refusal("is not a list of channels", self.allowed)
        if len(set(value)) < len(value):
            return Refusal("names a channel twice", "each channel once")
        return None

    def json_schema(self) -> dict[str, Any]:
        number = {"type": "integer", "minimum": 0, "maximum": CHANNELS_MAX - 1}
        items = {"anyOf": [number, {"type": "string", "minLength": 1}]}
        return {"type": "array", "minItems": 1, "uniqueItems": True, "items": items}

    def typed(self, value: Any) -> Any:
        return tuple(value)


@dataclass(frozen=True)
class ActuatorSettings(Described):
    """Settings of one actuator, such as its source and channels.

    For `rig`, `damping`, `protection` and `exposure_cap`, None means the top-level value of the
    config. Whether the rig exists is not checked here. A delay is rounded to the nearest frame.
    UsageError: values are invalid; the message names all of them.
    """

    channels: Annotated[
        tuple[int | str, ...], _DeviceChannels("channels of the device that drive the actuator")
    ]
    source: Annotated[
        str,
        Choice(
            "part of the sound that the actuator plays; all is another name of mix",
            SOURCES,
            aliases=("all",),
        ),
    ] = SOURCES[0]
    rig: Annotated[
        str | None, Text(f"rig of this actuator: a name or a file{LIKE_ALL}", change="engine")
    ] = None
    gain_db: Annotated[float, Number("level", GAIN_MIN_DB, GAIN_MAX_DB, "dB")] = GAIN_MAX_DB
    polarity: Annotated[str, Choice("sign of its vibration", POLARITIES)] = POLARITIES[0]
    delay_ms: Annotated[
        float, Number("delay behind the other actuators", 0.0, DELAY_MAX_MS, "ms")
    ] = 0.0
    damping: Annotated[
        str | None, Choice(f"reduction of the ringing{LIKE_ALL}", DAMPING, change="engine")
    ] = None
    protection: Annotated[
        str | None, Choice(f"protection of the rig{LIKE_ALL}", PROTECTION, change="engine")
    ] = None
    exposure_cap: Annotated[
        str | None, Choice(f"exposure limit of the rig{LIKE_ALL}", EXPOSURE_CAP, change="engine")
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.source == "all":
            object.__setattr__(self, "source", "mix")

    @property
    def factor(self) -> float:
        """Factor on the actuator's signal, from gain and polarity, -1 to 1."""
        amplitude = db_to_amplitude(self.gain_db)
        return -amplitude if self.polarity == "inverted" else amplitude


def wiring_refusals(wired: Sequence[Sequence[int | str]]) -> dict[int, Refusal]:
    """Return the errors of a wiring by actuator number, from 1. wired: channels per actuator."""
    if len(wired) > ACTUATORS_MAX:
        return {ACTUATORS_MAX + 1: Refusal("is one too many", f"up to {ACTUATORS_MAX} actuators")}
    return {number: Refusal(*wrong) for number, wrong in check_wiring(wired).items()}


def sources_of(actuators: Sequence[ActuatorSettings]) -> tuple[str, ...]:
    """Return the sources in use, in the order of `SOURCES`. actuators: all actuators of a run."""
    played = {actuator.source for actuator in actuators}
    return tuple(source for source in SOURCES if source in played)


def wiring_of(actuators: Sequence[ActuatorSettings]) -> Wiring:
    """Return the channels of each actuator. actuators: all actuators of a run."""
    return tuple(actuator.channels for actuator in actuators)
