"""Describes all keys of the config file, for `check`, the command line, editors and docs."""

from dataclasses import MISSING, dataclass, replace
from typing import Any

from audioflinger_hook.config.applications import ApplicationRule
from audioflinger_hook.config.profiles import LIVE_DEFAULT, values_of
from audioflinger_hook.config.settings import LiveSettings, Settings
from audioflinger_hook.transform import TransformParameters
from device.drive import ActuatorSettings
from device.values import Choice, Described, Description, Number, Switch

ACTUATOR = "actuator"
APPLICATION = "application"
ARRAYS = {ACTUATOR: "channels", APPLICATION: "match"}  # arrays of tables, with their required key
# "" is the top level
SECTIONS = ("", "transform", "live", "applications", APPLICATION, ACTUATOR)
HEADERS = {name: f"[[{name}]]" if name in ARRAYS else f"[{name}]" for name in SECTIONS[1:]}

CHANGES = {  # effect of changing a key while the daemon runs
    "nothing": "no interruption",
    "next stream": "used by streams opened later",
    "stream": "opens one stream again",
    "streams": "opens both streams again",
    "transform": "cross-fades; the Python engine restarts the vibration",
    "engine": "cross-fades; the Python engine restarts both streams",
    "another engine": "one engine ends before the other begins",
}

OPTIONS = {
    **dict.fromkeys(
        ("form", "channels", "damping", "protection", "model", "drop_in", "engine"), ""
    ),
    "profile": "NAME",
    "rig": "NAME|FILE",
    "tolerance": "SHARE",
    "tap": "TAP",
    "device": "DEVICE",
    "offset_ms": "MS|auto",
    "device_volume_db": "DB|off",
}
"""Fields that a command-line option sets, each with the placeholder of its value in help.

"" stands for a switch or a choice. Help shows a choice's words as its placeholder.
"""

# Maps old names of parameters in configs and captures, and old keys, to the present names.
REPLACED_PARAMETERS = {
    "level_law": "amplitude_mapping",
    "follower_db": "loudness_db",
    "follower_target_db": "loudness_target_db",
    "follower_slope_db": "dynamics, with a twentieth of the value",
    "loudness_slope_db": "dynamics, with a twentieth of the value",
    "follower_floor_db": "loudness_floor_db",
    "follower_gate_db": "loudness_gate_db",
}
REPLACED = {"transform": {"form": "transform", **REPLACED_PARAMETERS}}

_OWNERS: tuple[tuple[type[Described], str, str], ...] = (
    (Settings, "", "engine"),
    (LiveSettings, "", "stream"),
    (TransformParameters, "transform", "transform"),
    (ApplicationRule, APPLICATION, "nothing"),
    (ActuatorSettings, ACTUATOR, "nothing"),
)
"""The classes that hold the keys. Each has a default section and a default effect of changes."""


@dataclass(frozen=True)
class Key:
    """A key of the config file. Its value becomes the field `field` of the class `owner`."""

    section: str  # "" for the top level
    name: str
    owner: type[Described]
    field: str
    description: Description
    default: Any  # None if there is none
    live_default: Any  # default in `run`, which has another default profile
    change: str  # the effect of changing the key while the daemon runs, one of `CHANGES`

    @property
    def flag(self) -> str:
        """The command-line option that sets the key; "" if there is none."""
        has_one = self.field in OPTIONS and self.section not in ARRAYS
        return f"--{self.name.replace('_', '-')}" if has_one else ""

    @property
    def metavar(self) -> str:
        """The word that stands for the option's value in help, such as NAME."""
        words = self.description.words if isinstance(self.description, Choice) else ()
        return OPTIONS[self.field] or "|".join(map(str, words))

    @property
    def shown_default(self) -> str:
        """The default as shown in help and docs; "" if there is none."""
        shown, live = (_shown(value) for value in (self.default, self.live_default))
        return shown if shown == live else f"{live} in run, else {shown}"

    @property
    def help(self) -> str:
        """The help text: the key's meaning, allowed values and default."""
        described = self.description
        parts = [described.meaning]
        if not isinstance(described, Switch):
            words_shown = isinstance(described, Choice) and not OPTIONS.get(self.field, "-")
            parts += [] if words_shown else [described.allowed]
            parts += [f"default: {self.shown_default}"] if self.shown_default else []
        return "; ".join(parts)

    def json_schema(self) -> dict[str, Any]:
        """Return the JSON Schema of the key's value."""
        schema = self.description.json_schema()
        if isinstance(self.description, Number) and self.description.word:
            schema = {"anyOf": [schema, {"enum": [self.description.word]}]}
        schema = {"description": self.help, **schema}
        if self.default is None or self.default != self.live_default:
            return schema
        default = list(self.default) if isinstance(self.default, tuple) else self.default
        return {**schema, "default": default}


def _shown(default: Any) -> str:
    if default is None:
        return ""
    if isinstance(default, bool):
        return str(default).lower()
    if isinstance(default, tuple):
        return ", ".join(default)
    return f"{default:g}" if isinstance(default, float) else str(default)


def _keys() -> tuple[Key, ...]:
    found = []
    for owner, section, change in _OWNERS:
        for field, described in owner.DESCRIPTIONS.items():
            if owner is ActuatorSettings and field == "rig":  # `Settings` reads the rig file
                described = replace(Settings.DESCRIPTIONS["rig"], meaning=described.meaning)
            default = getattr(owner, field, MISSING)
            default = live_default = None if default is MISSING else default
            if field == "profile" and owner is Settings:
                live_default = LIVE_DEFAULT
            elif owner is TransformParameters:
                live_default = values_of(LIVE_DEFAULT).get(field, default)
            place = described.section or section, described.name or field
            change_of_key = described.change or change
            found.append(Key(*place, owner, field, described, default, live_default, change_of_key))
    return tuple(sorted(found, key=lambda key: SECTIONS.index(key.section)))


KEYS = _keys()  # all keys, in order of section


def keys_of(section: str) -> dict[str, Key]:
    """Return the keys of a section, keyed by name. section: "" for the top level."""
    return {key.name: key for key in KEYS if key.section == section}


def option(field: str) -> Key:
    """Return the key of a field that a command-line option sets."""
    return next(key for key in KEYS if key.field == field and key.flag)


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of the config file, for editors."""
    root = _table("")
    for section in SECTIONS[1:]:
        table = _table(section)
        if section in ARRAYS:
            items = {**table, "required": [ARRAYS[section]]}
            table = {"type": "array", "minItems": 1, "items": items}
        root["properties"][section] = table
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Configuration of Haptic Cushion",
        **root,
    }


def _table(section: str) -> dict[str, Any]:
    properties = {name: key.json_schema() for name, key in keys_of(section).items()}
    return {"type": "object", "additionalProperties": False, "properties": properties}
