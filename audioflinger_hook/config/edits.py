"""Changes to the values of a config file: in a document, in its text, or as a new text.

An edit names a key as `key` or `section.key`; the value None leaves the key out of the file.
"""

from __future__ import annotations

import textwrap
import tomllib
from collections import deque
from collections.abc import Mapping, MutableMapping
from pathlib import Path
from typing import Any

from audioflinger_hook.config.schema import ACTUATOR, KEYS, Key, keys_of
from audioflinger_hook.config.toml_text import text_of
from device.atomic_file import make_private_folder, write_bytes_atomically
from device.errors import InternalError, UsageError
from device.values import Text, nearest

Edits = Mapping[str, Any]

UNDO_MAX = 100  # changes that can be undone; older ones cannot

EDITABLE = {
    f"{key.section}.{key.name}" if key.section else key.name: key
    for key in KEYS
    # A text names a file or a device, and each actuator has a table of its own.
    if key.section != ACTUATOR and not isinstance(key.description, Text)
}
"""The keys that may be changed while the daemon runs, by their names in edits."""


def editable(name: str) -> Key:
    """Return the key of an edit. UsageError: there is none, or it names a file or a device."""
    if name not in EDITABLE:
        guess = nearest(name, EDITABLE)
        offer = f"did you mean {guess}?" if guess else f"allowed: {', '.join(EDITABLE)}"
        raise UsageError(f"{name[:60]!r} cannot be changed while the daemon runs; {offer}")
    return EDITABLE[name]


def apply_edits(document: MutableMapping[str, Any], edits: Edits) -> None:
    """Change the values of a document."""
    for name, value in edits.items():
        section, _, key = name.rpartition(".")
        table = document
        if section:
            if not isinstance(document.get(section, {}), MutableMapping):
                continue  # The check reports what stands there.
            if section not in document and value is None:
                continue
            table = document.setdefault(section, {})
        if value is None:
            table.pop(key, None)
        else:
            table[key] = list(value) if isinstance(value, tuple) else value


def edited_text(text: str, edits: Edits) -> str:
    """Return a text with edits; comments and order stay. UsageError: the text is not TOML."""
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    try:
        document = tomlkit.parse(text)
        expected = tomllib.loads(text)
        apply_edits(document, edits)
    except (TOMLKitError, ValueError) as error:
        raise UsageError(
            f"the config file is not TOML ({error}); see `cushion check`, then save again"
        ) from error
    apply_edits(expected, edits)
    changed = tomlkit.dumps(document)
    if tomllib.loads(changed) != expected:
        raise InternalError("the config file would not hold the changes; edit it by hand")
    return changed


HEAD = """\
# Settings of Haptic Cushion. `cushion check` finds mistakes. A key behind `#` has its default.
# A running daemon reads this again after: systemctl --user reload cushion
"""


def commented_text(edits: Edits, channels: tuple[str, ...] = ()) -> str:
    """Return a new config file with these values, and every other key as a comment.

    channels: of the only actuator; empty for all channels of the device.
    """
    parts = [HEAD]
    for name, key in keys_of("").items():
        default = f"{name} =" if key.default is None else _line(name, key.default)
        line = _line(name, edits[name]) if name in edits else f"# {default}"
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
    lines = textwrap.wrap(text, 98, break_long_words=False, break_on_hyphens=False)
    return "".join(f"# {line}\n" for line in lines)


def _line(name: str, value: Any) -> str:
    import tomlkit

    return tomlkit.dumps({name: list(value) if isinstance(value, tuple) else value}).strip()


class LiveEdits:
    """The edits since the daemon began, `values`, on top of its config file. For one thread."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.values: dict[str, Any] = {}
        self._saved: dict[str, Any] = {}
        self._undo: deque[dict[str, Any]] = deque(maxlen=UNDO_MAX)  # the edits before each change

    @property
    def unsaved(self) -> frozenset[str]:
        """The edited keys that were not saved with their present values."""
        kept = {name for name, value in self.values.items() if (name, value) in self._saved.items()}
        return frozenset(self.values.keys() - kept)

    @property
    def undo_count(self) -> int:
        """Changes that can be undone."""
        return len(self._undo)

    def accept(self, changes: Edits) -> None:
        """Make these changes; only after they were checked."""
        self._undo.append(self.values)
        self.values = {**self.values, **changes}

    def without_last(self) -> dict[str, Any]:
        """Return the edits without the last change; UsageError if there is none."""
        if not self._undo:
            raise UsageError("there is nothing to undo; nothing has been changed since the start")
        return dict(self._undo[-1])

    def undo(self) -> None:
        """Undo the last change; only after `without_last` was checked."""
        self.values = self.without_last()
        self._undo.pop()

    def save(self) -> None:
        """Write the edits into the file, which is made if it is missing.

        UsageError: the file is not TOML, or cannot be written. WriteError: the disk failed.
        """
        text = text_of(self._path, or_empty=True)
        changed = edited_text(text, self.values)
        if changed != text:
            make_private_folder(self._path.parent)
            write_bytes_atomically(self._path, changed.encode())
        self._saved = dict(self.values)
        # To undo an edit that the file holds takes an edit with the file's earlier value.
        document = tomllib.loads(text)
        before = {name: _value(document, name) for name in self.values}
        self._undo = deque(({**before, **edits} for edits in self._undo), UNDO_MAX)


def _value(document: dict[str, Any], name: str) -> Any:
    section, _, key = name.rpartition(".")
    table = document.get(section, {}) if section else document
    return table.get(key) if isinstance(table, dict) else None
