"""The config file: TOML, every mistake found at once, each with its line."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from audioflinger_hook.config import actuator_tables
from audioflinger_hook.config.profiles import PROFILES, parameters_of, values_of
from audioflinger_hook.config.settings import (
    CHOICES,
    LISTS,
    RENAMED_PARAMETERS,
    LiveSettings,
    Settings,
    live_from_document,
    live_problems,
    wrong_gain,
    wrong_rig,
)
from audioflinger_hook.transform import CHOICES as PARAMETER_CHOICES
from audioflinger_hook.transform import LIMITS, TransformParameters
from audioflinger_hook.transform.parameters import Problem as PartProblem
from device.drive.settings import KEYS as ACTUATOR_KEYS
from device.errors import UsageError
from device.rig.rig_file import SHIPPED

TOP_LEVEL = ("profile", "damping", "protection", "exposure_cap")
RIG = "rig"
GAIN = "gain_db"
EFFECTS_FILE = "effects_file"
LIVE = ("tap", "device", "offset_ms", "drop_in", "block_frames", "realtime", "device_volume_db")
TRANSFORM_CHOICES = ("form", "channels")
SECTION = "transform"
LIVE_SECTION = "applications"
PARAMETERS = (*LIMITS, *PARAMETER_CHOICES)
SECTIONS = {SECTION: (*TRANSFORM_CHOICES, *PARAMETERS), LIVE_SECTION: LISTS}
SYNTAX_ERRORS_MAX = 50
CONFIG_BYTES_MAX = 1 << 20
SHOWN_MAX = 200


@dataclass(frozen=True)
class Problem:
    """One mistake: the key as `section.key`, its line from 1 (0: none), value and what goes."""

    key: str
    line: int
    value: str
    problem: str
    allowed: str

    def __str__(self) -> str:
        where = f"line {self.line}: " if self.line else ""
        value = f" = {self.value}" if self.value else ""
        return f"{where}{self.key}{value} {self.problem}; allowed: {self.allowed}"


@dataclass(frozen=True)
class Config:
    """What a config file says: how vibration is made of sound, and what live sound does."""

    settings: Settings = field(default_factory=Settings)
    live: LiveSettings = field(default_factory=LiveSettings)


def default_path() -> Path:
    """Return where the config is looked for: $XDG_CONFIG_HOME/cushion/config.toml."""
    base = os.environ.get("XDG_CONFIG_HOME") or "~/.config"
    return Path(base).expanduser() / "cushion" / "config.toml"


def load(path: Path) -> Config:
    """Return what a config file says.

    Raises
    ------
    UsageError
        The file cannot be read, or has mistakes; the message names the first and how many.
    """
    config, problems = check(path)
    if config is None:
        more = f" (and {len(problems) - 1} more; see `cushion check`)" if problems[1:] else ""
        raise UsageError(f"{path}: {problems[0]}{more}")
    return config


def check(path: Path) -> tuple[Config | None, list[Problem]]:
    """Return what a file says and an empty list, or None and every mistake in order of lines.

    Raises
    ------
    UsageError
        The file cannot be read, or is no text.
    """
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise UsageError(f"{path} is not a regular file; give the path of a config file")
        with path.open("rb") as file:
            content = file.read(CONFIG_BYTES_MAX + 1)
        if len(content) > CONFIG_BYTES_MAX:
            raise UsageError(f"{path} is over {CONFIG_BYTES_MAX} bytes; a config file is smaller")
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UsageError(
            f"{path} is not UTF-8 text (byte {error.start}); save it as UTF-8"
        ) from None
    except OSError as error:
        raise UsageError(
            f"{path} cannot be read ({error.strerror}); give the path of a config file"
        ) from None
    document, problems = _parse(text)
    lines = _lines_of_keys(text)
    section = _section(document, SECTION)
    for old, new in RENAMED_PARAMETERS.items():
        if old in section and new not in section:
            section[new] = section.pop(old)
            lines[f"{SECTION}.{new}"] = lines.get(f"{SECTION}.{old}", 0)
    problems += _unknown_keys(document, lines)
    problems += _wrong_choices(document, lines)
    problems += _wrong_effects_file(document, lines, path.parent)
    if RIG in document and (wrong := wrong_rig(document[RIG], path.parent)):
        problems.append(_problem(RIG, lines, _shown(document[RIG]), wrong.wrong, wrong.allowed))
    if GAIN in document and (wrong := wrong_gain(document[GAIN])):
        problems.append(_problem(GAIN, lines, _shown(document[GAIN]), wrong.wrong, wrong.allowed))
    parameters = _section(document, SECTION)
    chosen = {name: value for name, value in parameters.items() if name in PARAMETERS}
    profile = _profile(document)
    wrong_together = TransformParameters.problems(values_of(profile) | chosen)
    problems += _from_part(wrong_together, chosen, f"{SECTION}.", lines)
    live = {name: document[name] for name in LIVE if name in document}
    rules = {
        name: value for name, value in _section(document, LIVE_SECTION).items() if name in LISTS
    }
    problems += _from_part(live_problems(live), live, "", lines)
    problems += _from_part(live_problems(rules), rules, f"{LIVE_SECTION}.", lines)
    tables = actuator_tables.tables_of(document)
    wrong_tables = actuator_tables.problems(tables, path.parent)
    problems += _from_part(wrong_tables, actuator_tables.values_of(tables), "", lines)
    if tables and parameters.get("channels") == "each":
        allowed = f"mono: the source of every {actuator_tables.HEADER} says what it plays"
        key = f"{SECTION}.channels"
        problems.append(_problem(key, lines, '"each"', "cannot be with actuators", allowed))
    if problems:
        return None, sorted(problems, key=lambda problem: problem.line)
    choices = {name: document[name] for name in (*TOP_LEVEL, GAIN) if name in document}
    choices |= {name: parameters[name] for name in TRANSFORM_CHOICES if name in parameters}
    if RIG in document:
        named = document[RIG]
        choices[RIG] = named if named in SHIPPED else str(path.parent / named)
    effects_file = path.parent / document[EFFECTS_FILE] if EFFECTS_FILE in document else None
    settings = Settings(
        **choices,
        effects_file=effects_file,
        parameters=parameters_of(profile, chosen),
        said=tuple(chosen),
        actuators=actuator_tables.from_tables(tables, path.parent),
    )
    return Config(settings, live_from_document(live | rules)), []


def _profile(document: dict[str, Any]) -> str:
    """Return the profile that a document names, the default where it names none that exists."""
    named = document.get("profile")
    return named if isinstance(named, str) and named in PROFILES else CHOICES["profile"][0]


def _section(document: dict[str, Any], name: str) -> dict[str, Any]:
    """Return a section's keys, none where it is missing or is no section."""
    section = document.get(name, {})
    return section if isinstance(section, dict) else {}


def _from_part(
    found: Mapping[str, PartProblem], values: dict[str, Any], prefix: str, lines: dict[str, int]
) -> list[Problem]:
    """Return what one part of the program found wrong with its share of the file."""
    return [
        _problem(
            prefix + name,
            lines,
            _shown(values[name]) if name in values else "",
            problem.wrong,
            problem.allowed,
        )
        for name, problem in found.items()
    ]


def _parse(text: str) -> tuple[dict[str, Any], list[Problem]]:
    """Return what can be read, and the syntax errors: each line that has one is left out.

    Of a section's broken headline the name is kept where there is one, so that the keys below
    are still taken for that section's.
    """
    lines = text.split("\n")
    problems: list[Problem] = []
    for _ in range(SYNTAX_ERRORS_MAX):
        try:
            return tomllib.loads("\n".join(lines)), problems
        except RecursionError:
            problems.append(Problem("this file", 0, "", "is nested too deeply", "flat values"))
            return {}, problems
        except ValueError as error:  # TOMLDecodeError, and numbers of thousands of digits
            number = _line_of_error(str(error), lines)
            reason = str(error).partition(" (at")[0].partition(";")[0]
            shown = _printable(lines[number - 1].strip())
            problems.append(
                Problem(shown or "(empty)", number, "", f"is not TOML ({reason})", "key = value")
            )
            header = re.match(r"\s*(\[+)\s*([\w-]+)", lines[number - 1])
            repaired = f"[{header[2]}]" if header else ""
            if header and header[1] == "[[":
                repaired = f"[{repaired}]"
            lines[number - 1] = repaired if repaired != lines[number - 1] else ""
    problems.append(
        Problem("the rest", len(lines), "", "was not read, so broken is this file", "TOML")
    )
    return {}, problems


def _line_of_error(message: str, lines: list[str]) -> int:
    """Return the number from 1 of the line that a message of the parser is about."""
    filled = [number for number, line in enumerate(lines, 1) if line.strip()] or [1]
    if at := re.search(r"\(at line (\d+)", message):
        number = int(at[1])
        # The parser stands behind a line break where a line ended too early.
        while number > 1 and not lines[number - 1].strip():
            number -= 1
        return number
    too_long = [number for number in filled if re.search(r"\d{4000}", lines[number - 1])]
    return too_long[0] if too_long else filled[-1]  # "at end of document"


def _lines_of_keys(text: str) -> dict[str, int]:
    """Return the line of every `key` and `section.key`, as far as one can tell from its start.

    Of an array of tables it is `section[1].key`, `section[2].key` and so on.
    """
    lines: dict[str, int] = {}
    section = ""
    tables: dict[str, int] = {}
    for number, line in enumerate(text.split("\n"), 1):
        if header := re.match(r"\s*\[+\s*([^\]]+?)\s*\]*\s*(#.*)?$", line):
            name = _bare(header[1])
            lines.setdefault(name, number)
            if line.lstrip().startswith("[["):
                tables[name] = tables.get(name, 0) + 1
                name = f"{name}[{tables[name]}]"
                lines.setdefault(name, number)
            section = name + "."
        elif key := re.match(r"\s*([^=#]+?)\s*=", line):
            name = section + _bare(key[1])
            lines.setdefault(name, number)
            lines.setdefault(name.partition(".")[0], number)
    return lines


def _bare(key: str) -> str:
    """Return a dotted key without quotes and blanks."""
    return ".".join(part.strip().strip("\"'") for part in key.split("."))


def _problem(key: str, lines: dict[str, int], value: str, problem: str, allowed: str) -> Problem:
    """Return a problem with its line: that of the key, or of the section that holds it inline."""
    section = key.partition(".")[0]
    line = lines.get(key) or lines.get(section) or lines.get(section.partition("[")[0], 0)
    return Problem(_printable(key), line, value, problem, allowed)


def _unknown_keys(document: dict[str, Any], lines: dict[str, int]) -> list[Problem]:
    problems = []
    for name, value in document.items():
        if name in SECTIONS and isinstance(value, dict):
            known: tuple[str, ...] = SECTIONS[name]
            unknown = {f"{name}.{key}": value[key] for key in value if key not in known}
        elif name in SECTIONS:
            problems.append(_problem(name, lines, _shown(value), "is not a section", f"[{name}]"))
            continue
        elif name == actuator_tables.ACTUATOR:
            if actuator_tables.are_no_tables(document):
                allowed = actuator_tables.HEADER
                problems.append(_problem(name, lines, "", "is no array of tables", allowed))
            known = ACTUATOR_KEYS
            unknown = actuator_tables.unknown_of(actuator_tables.tables_of(document))
        else:
            sections = (f"[{section}]" for section in SECTIONS)
            known = (*TOP_LEVEL, RIG, GAIN, EFFECTS_FILE, *LIVE, *sections, actuator_tables.HEADER)
            unknown = {} if name in known else {name: value}
        for key, found in unknown.items():
            shown = "" if isinstance(found, dict) else _shown(found)
            problems.append(_problem(key, lines, shown, "is an unknown key", ", ".join(known)))
    return problems


def _wrong_choices(document: dict[str, Any], lines: dict[str, int]) -> list[Problem]:
    inner = _section(document, SECTION)
    chosen = {name: document[name] for name in TOP_LEVEL if name in document}
    chosen |= {f"{SECTION}.{name}": inner[name] for name in TRANSFORM_CHOICES if name in inner}
    problems = []
    for key, value in chosen.items():
        allowed = CHOICES[key.rpartition(".")[2]]
        if value not in allowed:
            problems.append(_problem(key, lines, _shown(value), "is not known", ", ".join(allowed)))
    return problems


def _wrong_effects_file(
    document: dict[str, Any], lines: dict[str, int], folder: Path
) -> list[Problem]:
    """Return what is wrong with the effects file's name; what is in it is told when it is used."""
    if EFFECTS_FILE not in document:
        return []
    value = document[EFFECTS_FILE]
    allowed = "the path of an audio_effects.xml, from this file's folder on"
    if not isinstance(value, str) or not value:
        wrong = "is not a path"
    elif "\0" in value or not (folder / value).is_file():
        wrong = "is not a file"
    else:
        return []
    return [_problem(EFFECTS_FILE, lines, _shown(value), wrong, allowed)]


def _shown(value: Any) -> str:
    """Return a value as one would write it in TOML, near enough for a message of one line."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return _printable(f'"{value}"')
    if isinstance(value, list):
        return _printable(f"[{', '.join(map(_shown, value))}]")
    try:
        return _printable(str(value))
    except ValueError:  # an integer of thousands of digits
        return "a number of thousands of digits"


def _printable(text: str) -> str:
    """Return text that neither breaks the line nor commands the terminal, at most 200 long."""
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return shown if len(shown) <= SHOWN_MAX else shown[:SHOWN_MAX] + "..."
