"""Reads the config file (TOML), and finds all mistakes in it at once, with line numbers."""

import os
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from audioflinger_hook.config import fits, profiles, schema, toml_text
from audioflinger_hook.config.applications import ApplicationRule, rule_refusals
from audioflinger_hook.config.edits import Edits, apply_edits
from audioflinger_hook.config.kinds import curve_text
from audioflinger_hook.config.profiles import OFFLINE_DEFAULT
from audioflinger_hook.config.schema import ACTUATOR, APPLICATION, ARRAYS, KEYS, keys_of
from audioflinger_hook.config.settings import LiveSettings, Settings
from audioflinger_hook.config.toml_text import Mistake, printable
from audioflinger_hook.transform import TransformParameters
from device.drive import ActuatorSettings, wiring_refusals
from device.errors import UsageError
from device.values import Described, Refusal, nearest


@dataclass(frozen=True)
class Config:
    """The settings of a config file."""

    settings: Settings = field(default_factory=Settings)
    live: LiveSettings = field(default_factory=LiveSettings)


def default_path() -> Path:
    """Return the path of the user's config, in $XDG_CONFIG_HOME or ~/.config."""
    base = os.environ.get("XDG_CONFIG_HOME") or "~/.config"
    return Path(base).expanduser() / "cushion" / "config.toml"


def names_a_device() -> bool:
    """Return whether the user's config names a device. UsageError: the file has mistakes."""
    path = default_path()
    return path.exists() and load(path, profiles.LIVE_DEFAULT).live.device is not None


def load(
    path: Path, default_profile: str = OFFLINE_DEFAULT, edits: Edits | None = None, device: str = ""
) -> Config:
    """Return the settings of a config file; see `check`. UsageError: the file has mistakes."""
    config, mistakes = check(path, default_profile, edits, device)
    if config is None:
        more = f" (and {len(mistakes) - 1} more; see `cushion check --config {path}`)"
        raise UsageError(f"{path}: {mistakes[0]}{more if mistakes[1:] else ''}")
    return config


def check(
    path: Path, default_profile: str = OFFLINE_DEFAULT, edits: Edits | None = None, device: str = ""
) -> tuple[Config | None, list[Mistake]]:
    """Return a file's settings and an empty list, or None and all mistakes, ordered by line.

    default_profile: the profile if the file names none.
    edits: values that override those of the file. If they are given, the file may be missing.
    device: its fit counts instead of that of the file's device.
    UsageError: the file cannot be read or is not text.
    """
    text = toml_text.text_of(path, or_empty=edits is not None)
    return check_text(text, path.parent, default_profile, edits, device)


def check_text(
    text: str, folder: Path, default_profile: str, edits: Edits | None = None, device: str = ""
) -> tuple[Config | None, list[Mistake]]:
    """Check a text as `check` checks a file. folder: relative paths in the text start there."""
    document, mistakes = toml_text.parse(text)
    apply_edits(document, edits or {})
    reading = _Reading(toml_text.lines_of_keys(text), folder, mistakes, default_profile)
    reading.read(document)
    reading.find_contradictions(device)
    if mistakes:
        return None, sorted(mistakes, key=lambda mistake: mistake.line)
    return reading.config(), []


class _Reading:
    def __init__(
        self, lines: dict[str, int], folder: Path, mistakes: list[Mistake], default_profile: str
    ) -> None:
        self.lines, self.folder = lines, folder
        self.mistakes, self.default_profile = mistakes, default_profile
        self.shown: dict[str, str] = {}
        # Accepted values by class and field; for arrays, the values of the latest table.
        self.accepted: dict[type[Described], dict[str, Any]] = {key.owner: {} for key in KEYS}
        self.arrays: dict[str, list[dict[str, Any]]] = {name: [] for name in ARRAYS}
        self.refused: set[tuple[type[Described], str]] = set()

    def read(self, document: dict[str, Any]) -> None:
        top = {name: value for name, value in document.items() if name not in schema.HEADERS}
        self._read_table("", "", top)
        for section in schema.SECTIONS[1:]:
            found = document.get(section, {})
            if section in ARRAYS:
                self._read_array(section, found if section in document else None)
            elif isinstance(found, dict):
                self._read_table(section, f"{section}.", found)
            else:
                self.shown[section] = _shown(found)
                self._add(section, Refusal("is not a section", schema.HEADERS[section]))

    def _read_array(self, section: str, found: object) -> None:
        tables = found if isinstance(found, list) else []
        good = [table for table in tables if isinstance(table, dict)]
        if found is not None and (not good or len(good) < len(tables)):
            self._add(section, Refusal("is not an array of tables", schema.HEADERS[section]))
        for number, table in enumerate(good, 1):
            required = keys_of(section)[ARRAYS[section]]
            accepted = self.accepted[required.owner] = {}
            self.arrays[section].append(accepted)
            prefix = f"{section}[{number}]."
            self._read_table(section, prefix, table)
            if required.name not in table:
                allowed = required.description.allowed
                self._add(f"{prefix}{required.name}", Refusal("is missing", allowed))

    def _read_table(self, section: str, prefix: str, table: dict[str, Any]) -> None:
        known = keys_of(section)
        for name, value in table.items():
            shown = f"{prefix}{name}"
            if not isinstance(value, dict):
                self.shown[shown] = _shown(value)
            if name not in known:
                # Similar names take long to find, and only the first mistakes are shown.
                told = name if len(self.mistakes) < toml_text.LISTED_MAX else ""
                self._add(shown, _unknown(section, told, is_section=isinstance(value, dict)))
                continue
            key = known[name]
            resolved = key.description.resolved(value, self.folder)
            if refusal := key.description.refuse(resolved):
                self._add(shown, refusal)
                self.refused.add((key.owner, key.field))
            else:
                self.accepted[key.owner][key.field] = key.description.typed(resolved)

    def find_contradictions(self, device: str) -> None:
        self.accepted[Settings]["actuators"] = self.arrays[ACTUATOR]
        chosen = self.accepted[TransformParameters]
        if chosen.get("strength") == "fit":
            try:
                device = device or self.accepted[LiveSettings].get("device", "")
                if not (name := chosen.get("fit") or (device and fits.default_name(device))):
                    raise UsageError("no fit is named, and the config has no device")
                chosen["fit"] = curve_text(fits.read(name).curve_db)
            except UsageError as error:
                self._add("transform.strength", Refusal(f"cannot be used ({error})", "felt, flat"))
                del chosen["strength"]
        owners: tuple[type[Described], ...] = (TransformParameters, Settings, LiveSettings)
        for owner in owners:
            for name, refusal in self._contradictions(owner, self.profile).items():
                section = next(k.section for k in KEYS if (k.owner, k.field) == (owner, name))
                self._add(f"{section}.{name}" if section else name, refusal)
        for number, rule in enumerate(self.arrays[APPLICATION], 1):
            profile = rule.get("profile") or self.profile
            found = self._contradictions(TransformParameters, profile)
            for name in found.keys() if profile != self.profile else ():
                wrong = f"does not fit {name} in [transform], which {found[name].wrong}"
                self._add(f"{APPLICATION}[{number}].profile", replace(found[name], wrong=wrong))
        wired = [actuator.get("channels", ()) for actuator in self.arrays[ACTUATOR]]
        for (number, key), refusal in rule_refusals(self.arrays[APPLICATION]).items():
            self._add(f"{APPLICATION}[{number}].{key}", refusal)
        for number, refusal in wiring_refusals(wired).items():
            if wired[number - 1]:  # If there are no channels, another mistake is already reported.
                self._add(f"{ACTUATOR}[{number}].channels", refusal)

    def _contradictions(self, owner: type[Described], profile: str) -> dict[str, Refusal]:
        base = profiles.values_of(profile) if owner is TransformParameters else {}
        values = owner.defaults() | base | self.accepted[owner]
        values = {n: value for n, value in values.items() if (owner, n) not in self.refused}
        return owner.contradictions(values)

    @property
    def profile(self) -> str:
        """The profile that the config names, or the default if it names no known profile."""
        return str(self.accepted[Settings].get("profile", self.default_profile))

    def config(self) -> Config:
        chosen = self.accepted[TransformParameters]
        settings = Settings(
            **self.accepted[Settings]
            | {
                "profile": self.profile,
                "parameters": profiles.parameters_of(self.profile, chosen),
                "said": tuple(chosen),
                "actuators": tuple(ActuatorSettings(**one) for one in self.arrays[ACTUATOR]),
            }
        )
        rules = tuple(ApplicationRule(**rule) for rule in self.arrays[APPLICATION])
        return Config(
            settings, LiveSettings(**self.accepted[LiveSettings], application_rules=rules)
        )

    def _add(self, key: str, refusal: Refusal) -> None:
        section = key.partition(".")[0]
        names = (key, section, section.partition("[")[0])
        line = next((self.lines[name] for name in names if name in self.lines), 0)
        where = printable(key), line, self.shown.get(key, "")
        self.mistakes.append(Mistake(*where, refusal.wrong, refusal.allowed, refusal.nearest))


@lru_cache(maxsize=128)
def _unknown(section: str, name: str, is_section: bool) -> Refusal:
    """Return a message about an unknown key or section, with the most similar known name."""
    if name in schema.REPLACED.get(section, {}):
        return Refusal("is no longer a key", schema.REPLACED[section][name])
    known = [*keys_of(section), *(schema.HEADERS.values() if not section else ())]
    elsewhere = [
        f"{name} in {schema.HEADERS[key.section]}" if key.section else f"{name} at the top level"
        for key in KEYS
        if key.name == name
    ]
    guess = elsewhere[0] if elsewhere else nearest(name, [*keys_of(section), *schema.SECTIONS[1:]])
    wrong = "is an unknown section" if is_section and not section else "is an unknown key"
    return Refusal(wrong, ", ".join(known), schema.HEADERS.get(guess, guess))


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return printable(f'"{value}"')
    if isinstance(value, list):
        return printable(f"[{', '.join(map(_shown, value))}]")
    try:
        return printable(str(value))
    except ValueError:  # an integer with thousands of digits
        return "a number of thousands of digits"
