"""The config file: TOML, every mistake found at once, each with its line."""

from __future__ import annotations

import os
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from audioflinger_hook.settings import CHOICES, Settings
from audioflinger_hook.transform import LIMITS, TransformParameters
from device.errors import UsageError

TOP_LEVEL = ("profile", "damping", "rig")
TRANSFORM_CHOICES = ("form", "channels")
SECTION = "transform"
SYNTAX_ERRORS_MAX = 50


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


def default_path() -> Path:
    """Return where the config is looked for: $XDG_CONFIG_HOME/cushion/config.toml."""
    base = os.environ.get("XDG_CONFIG_HOME") or "~/.config"
    return Path(base).expanduser() / "cushion" / "config.toml"


def load(path: Path) -> Settings:
    """Return the settings of a config file.

    Raises
    ------
    UsageError
        The file cannot be read, or has mistakes; the message names the first and how many.
    """
    settings, problems = check(path)
    if settings is None:
        more = f" (and {len(problems) - 1} more; see `cushion check`)" if problems[1:] else ""
        raise UsageError(f"{path}: {problems[0]}{more}")
    return settings


def check(path: Path) -> tuple[Settings | None, list[Problem]]:
    """Return the settings and an empty list, or None and every mistake in order of lines."""
    try:
        text = path.read_bytes().decode("utf-8-sig")
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
    problems += _unknown_keys(document, lines)
    problems += _wrong_choices(document, lines)
    section = document.get(SECTION, {})
    parameters = section if isinstance(section, dict) else {}
    numbers = {name: value for name, value in parameters.items() if name in LIMITS}
    for name, message in TransformParameters.problems(numbers).items():
        problem, _, allowed = message.partition("; allowed: ")
        key = f"{SECTION}.{name}"
        problem = problem.removeprefix(f"{name}=").partition(" ")[2]
        shown = _shown(numbers[name]) if name in numbers else ""
        problems.append(Problem(key, lines.get(key, 0), shown, problem, allowed))
    if problems:
        return None, sorted(problems, key=lambda problem: problem.line)
    choices = {name: document[name] for name in TOP_LEVEL if name in document}
    choices |= {name: parameters[name] for name in TRANSFORM_CHOICES if name in parameters}
    return Settings(**choices, parameters=TransformParameters(**numbers)), []


def _parse(text: str) -> tuple[dict[str, Any], list[Problem]]:
    """Return what can be read, and the syntax errors: each line that has one is left out."""
    lines = text.split("\n")
    problems: list[Problem] = []
    while len(problems) < SYNTAX_ERRORS_MAX:
        try:
            return tomllib.loads("\n".join(lines)), problems
        except tomllib.TOMLDecodeError as error:
            at = re.search(r"\(at line (\d+)", str(error))
            # "at end of document": the last line that holds anything.
            filled = [number for number, line in enumerate(lines, 1) if line.strip()]
            number = int(at[1]) if at else (filled[-1] if filled else 1)
            # The parser stands behind a line break where a line ended too early.
            while number > 1 and not lines[number - 1].strip():
                number -= 1
            reason = str(error).partition(" (at")[0]
            shown = lines[number - 1].strip()
            problems.append(
                Problem(shown or "(empty)", number, "", f"is not TOML ({reason})", "key = value")
            )
            lines[number - 1] = ""
    return {}, problems


def _lines_of_keys(text: str) -> dict[str, int]:
    """Return the line of every `key` and `section.key` that stands on a line of its own."""
    lines: dict[str, int] = {}
    section = ""
    for number, line in enumerate(text.split("\n"), 1):
        if header := re.match(r"\s*\[+\s*([^\]]+?)\s*\]+", line):
            section = header[1].strip("\"'") + "."
            lines.setdefault(section[:-1], number)
        elif key := re.match(r"\s*([\w.\-\"']+)\s*=", line):
            lines.setdefault(section + key[1].replace('"', "").replace("'", ""), number)
    return lines


def _unknown_keys(document: dict[str, Any], lines: dict[str, int]) -> list[Problem]:
    problems = []

    def unknown(key: str, value: Any, known: tuple[str, ...]) -> None:
        shown = "" if isinstance(value, dict) else _shown(value)
        allowed = ", ".join(known)
        problems.append(Problem(key, lines.get(key, 0), shown, "is an unknown key", allowed))

    for name, value in document.items():
        if name == SECTION and isinstance(value, dict):
            known = (*TRANSFORM_CHOICES, *LIMITS)
            for inner, inner_value in value.items():
                if inner not in known:
                    unknown(f"{SECTION}.{inner}", inner_value, known)
        elif name == SECTION:
            problems.append(
                Problem(name, lines.get(name, 0), _shown(value), "is not a section", "[transform]")
            )
        elif name not in TOP_LEVEL:
            unknown(name, value, (*TOP_LEVEL, f"[{SECTION}]"))
    return problems


def _wrong_choices(document: dict[str, Any], lines: dict[str, int]) -> list[Problem]:
    section = document.get(SECTION)
    inner = section if isinstance(section, dict) else {}
    chosen = {name: document[name] for name in TOP_LEVEL if name in document}
    chosen |= {f"{SECTION}.{name}": inner[name] for name in TRANSFORM_CHOICES if name in inner}
    problems = []
    for key, value in chosen.items():
        allowed = CHOICES[key.rpartition(".")[2]]
        if value not in allowed:
            problems.append(
                Problem(key, lines.get(key, 0), _shown(value), "is not known", ", ".join(allowed))
            )
    return problems


def _shown(value: Any) -> str:
    """Return a value as one would write it in TOML, near enough for a message."""
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else str(value)
