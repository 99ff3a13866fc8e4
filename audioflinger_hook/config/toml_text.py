"""The text of a config file: parsing, syntax errors, and the line numbers of keys."""

import json
import re
import tomllib
from dataclasses import asdict, dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any

from device.errors import UsageError
from device.values import Refusal, counted

DOTS_MAX = 200  # in a line
SYNTAX_ERRORS_MAX, CONFIG_BYTES_MAX, SHOWN_MAX = 50, 1 << 20, 200
LISTED_MAX, LISTED_BYTES = 50, 18_000  # of mistakes; the others are counted


@dataclass(frozen=True)
class Mistake:
    """One mistake in a config file.

    key: `section.key`. line: line number of the key, from 1; 0 if unknown. value: as text.
    problem: the mistake. allowed: allowed values. nearest: most similar allowed name, or "".
    """

    key: str
    line: int
    value: str
    problem: str
    allowed: str
    nearest: str = ""

    def __str__(self) -> str:
        where = f"line {self.line}: " if self.line else ""
        value = f" = {self.value}" if self.value else ""
        return f"{where}{self.key}{value} {Refusal(self.problem, self.allowed, self.nearest)}"


def listed(mistakes: list[Mistake]) -> list[Mistake]:
    """Return the first mistakes, and one that counts the others."""
    sizes = accumulate(len(json.dumps(asdict(one), indent=2)) for one in mistakes[:LISTED_MAX])
    count = sum(size <= LISTED_BYTES for size in sizes)
    left = len(mistakes) - count
    rest = Mistake("this file", 0, "", f"has {counted(left, 'more mistakes')}", "none")
    return mistakes[:count] + [rest] * bool(left)


# A quote without an end reaches to the line's end.
_STRINGS = re.compile(r"'[^']*'?|" + r'"(?:[^"\\]|\\.)*"?')


def text_of(path: Path, *, or_empty: bool = False, kind: str = "config file") -> str:
    """Return a file's text; with `or_empty`, "" if it is missing. UsageError: it cannot be read.

    kind: what the file is, for messages.
    """
    try:
        if or_empty and not path.exists():
            return ""
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise UsageError(f"{path} is not a regular file; give the path of a {kind}")
        with path.open("rb") as file:
            content = file.read(CONFIG_BYTES_MAX + 1)
        if len(content) > CONFIG_BYTES_MAX:
            raise UsageError(f"{path} is over {CONFIG_BYTES_MAX} bytes; a {kind} is smaller")
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UsageError(f"{path} is not UTF-8 (byte {error.start}); save it as UTF-8") from None
    except OSError as error:
        raise UsageError(
            f"{path} cannot be read ({error.strerror}); give the path of a {kind}"
        ) from None


def json_object(path: Path) -> dict[str, Any]:
    """Return the JSON object in a file. UsageError: the file cannot be read, or has none."""
    try:
        found = json.loads(text_of(path, kind="JSON file"))
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path} is no JSON ({error})") from None
    if isinstance(found, dict):
        return found
    raise UsageError(f"{path} is not a JSON object")


def parse(text: str) -> tuple[dict[str, Any], list[Mistake]]:
    """Parse a text without the lines that have syntax errors, and also return these errors.

    If a section's header has an error, its name is still used for the keys after it.
    """
    lines = text.split("\n")
    mistakes: list[Mistake] = []
    for number, line in enumerate(lines, 1):
        # The parser's time grows with the square of the number of parts of a key.
        dotted = line.count(".") > DOTS_MAX
        keys = re.split(r"#.*|[=,{}]", _STRINGS.sub("s", line)) if dotted else []
        if any(key.count(".") > DOTS_MAX for key in keys):
            return {}, [Mistake("this file", number, "", "is nested too deeply", "flat values")]
    for _ in range(SYNTAX_ERRORS_MAX):
        try:
            return tomllib.loads("\n".join(lines)), mistakes
        except RecursionError:
            mistakes.append(Mistake("this file", 0, "", "is nested too deeply", "flat values"))
            return {}, mistakes
        except ValueError as error:  # TOMLDecodeError, or a number with thousands of digits
            number = _line_of_error(str(error), lines)
            reason = str(error).partition(" (at")[0].partition(";")[0]
            shown = printable(lines[number - 1].strip())
            mistakes.append(
                Mistake(shown or "(empty)", number, "", f"is not TOML ({reason})", "key = value")
            )
            header = re.match(r"\s*(\[+)\s*([\w-]+)", lines[number - 1])
            repaired = f"[{header[2]}]" if header else ""
            if header and header[1] == "[[":
                repaired = f"[{repaired}]"
            lines[number - 1] = repaired if repaired != lines[number - 1] else ""
    mistakes.append(
        Mistake("the rest", len(lines), "", "was not read: the file has too many errors", "TOML")
    )
    return {}, mistakes


def _line_of_error(message: str, lines: list[str]) -> int:
    """Return the line number, from 1, to which a parser error refers."""
    filled = [number for number, line in enumerate(lines, 1) if line.strip()] or [1]
    if at := re.search(r"\(at line (\d+)", message):
        number = int(at[1])
        # If a line ended too early, the parser reports the next line.
        while number > 1 and not lines[number - 1].strip():
            number -= 1
        return number
    too_long = [number for number in filled if re.search(r"\d{4000}", lines[number - 1])]
    return too_long[0] if too_long else filled[-1]  # the error is "at end of document"


def lines_of_keys(text: str) -> dict[str, int]:
    """Return the line numbers of all keys, named `key`, `section.key` or `section[1].key`."""
    lines: dict[str, int] = {}
    section = ""
    tables: dict[str, int] = {}
    for number, line in enumerate(text.split("\n"), 1):
        if header := re.match(r"\s*\[+([^\]]+)\]*\s*(#.*)?$", line):
            name = _bare(header[1])
            lines.setdefault(name, number)
            if line.lstrip().startswith("[["):
                tables[name] = tables.get(name, 0) + 1
                name = f"{name}[{tables[name]}]"
                lines.setdefault(name, number)
            section = name + "."
        elif key := re.match(r"[^=#]+(?==)", line):
            name = section + _bare(key[0])
            lines.setdefault(name, number)
            lines.setdefault(name.partition(".")[0], number)
    return lines


def _bare(key: str) -> str:
    return ".".join(part.strip().strip("\"'") for part in key.split("."))


def printable(text: str) -> str:
    """Return a text in one line, with control characters escaped, cut after 200 characters."""
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return shown if len(shown) <= SHOWN_MAX else shown[:SHOWN_MAX] + "..."
