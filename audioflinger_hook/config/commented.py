"""The text of a new config file: the values that were chosen, and every other key as a comment."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any

from audioflinger_hook.config.edits import Edits
from audioflinger_hook.config.schema import keys_of

WIDTH = 100

HEAD = """\
# Settings of Haptic Cushion. `cushion check` finds mistakes. A key behind `#` has its default.
# A running daemon reads this again after: systemctl --user reload cushion
"""


def commented_text(edits: Edits, channels: tuple[str, ...] = ()) -> str:
    """Return a new config file with these values.

    edits: values by `key` or `section.key`. channels: of the only actuator; empty for all channels
    of the device.
    """
    parts = [HEAD]
    for key in keys_of("").values():
        if key.name in edits:
            line = _line(key.name, edits[key.name])
        elif key.default is None:
            line = f"# {key.name} ="
        else:
            line = f"# {_line(key.name, key.default)}"
        parts.append(f"{_comment(key.help)}{line}\n")
    sections: dict[str, dict[str, Any]] = {}
    for name, value in edits.items():
        section, _, key_name = name.rpartition(".")
        if section:
            sections.setdefault(section, {})[key_name] = value
    for section, values in sections.items():
        lines = [f"{_comment(keys_of(section)[n].help)}{_line(n, v)}" for n, v in values.items()]
        parts.append("\n".join([f"[{section}]", *lines, ""]))
    if channels:
        parts.append(actuator_text(channels))
    return "\n".join(parts)


def actuator_text(channels: tuple[str, ...]) -> str:
    """Return the table of an actuator on some channels of the device."""
    return f"[[actuator]]\n{_line('channels', channels)}\n"


def _comment(text: str) -> str:
    """Return a comment of lines that are not too long."""
    lines = textwrap.wrap(text, WIDTH - 2, break_long_words=False, break_on_hyphens=False)
    return "".join(f"# {line}\n" for line in lines)


def _line(name: str, value: Any) -> str:
    import tomlkit

    document: Mapping[str, Any] = {name: list(value) if isinstance(value, tuple) else value}
    return tomlkit.dumps(document).strip()
