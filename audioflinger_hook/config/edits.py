"""Applies edits (new values of config keys) to a parsed config, its text, or a new config.

Edits are keyed by the name of a config key: `key` or `section.key`. The value None removes the key.
`RULE` and a name are the key of an [[application]] rule, whose value has all keys except `match`.
"""

import textwrap
import tomllib
from collections import deque
from collections.abc import Mapping, MutableMapping
from pathlib import Path
from typing import Any

from audioflinger_hook.config.schema import APPLICATION, ARRAYS, KEYS, Key, keys_of
from audioflinger_hook.config.toml_text import lines_of_keys, text_of
from device.atomic_file import write_private
from device.errors import InternalError, UsageError
from device.values import Text, nearest

Edits = Mapping[str, Any]

RULE = f"{APPLICATION}:"
UNDO_MAX = 100  # largest number of changes that can be undone

HEAD = """\
# Settings of Haptic Cushion. `cushion check` finds mistakes. A key behind `#` has its default.
# A running daemon reads this again after: systemctl --user reload cushion
"""

EDITABLE = {  # keys that may be changed while the daemon runs
    f"{key.section}.{key.name}" if key.section else key.name: key
    for key in KEYS
    # Keys of type `Text`, such as names of files, and keys of arrays of tables cannot be edited.
    if key.section not in ARRAYS and not isinstance(key.description, Text)
}


def editable(name: str) -> Key:
    """Return the config key of this name. UsageError: there is none, or it cannot be edited."""
    if name not in EDITABLE:
        guess = nearest(name, EDITABLE)
        offer = f"did you mean {guess}?" if guess else f"allowed: {', '.join(EDITABLE)}"
        raise UsageError(f"{name[:60]!r} cannot be changed while the daemon runs; {offer}")
    return EDITABLE[name]


def apply_edits(document: MutableMapping[str, Any], edits: Edits) -> None:
    """Change a parsed config in place."""
    for name, value in edits.items():
        if match := name.partition(RULE)[2]:
            _apply_rule(document, match.strip(), value)
            continue
        section, _, key = name.rpartition(".")
        table = document
        if section:
            if not isinstance(document.get(section, {}), MutableMapping):
                continue  # `check` reports the invalid section.
            if section not in document and value is None:
                continue
            table = document.setdefault(section, {})
        if value is None:
            table.pop(key, None)
        else:
            table[key] = list(value) if isinstance(value, tuple) else value


def _apply_rule(document: MutableMapping[str, Any], match: str, rule: Edits | None) -> None:
    index = _rule_index(document, match)
    rules = document.get(APPLICATION, [])
    if index is None:
        if rule is not None and isinstance(rules, list):  # else `check` reports it
            document.setdefault(APPLICATION, rules).append({"match": match, **rule})
    elif rule is not None:
        for name in rules[index].keys() - rule.keys() - {"match"}:
            del rules[index][name]
        rules[index].update({n: v for n, v in rule.items() if rules[index].get(n) != v})
    elif rules[1:]:
        del rules[index]
    else:
        del document[APPLICATION]


def _rule_index(document: Mapping[str, Any], match: str) -> int | None:
    found = document.get(APPLICATION)
    rules = found if isinstance(found, list) else []
    names = [str(one.get("match")) if isinstance(one, Mapping) else "" for one in rules]
    known = [name.strip().casefold() for name in names]
    return known.index(match.casefold()) if match.casefold() in known else None


def _with_rules(text: str, edits: Edits) -> str:
    """Add and remove lines of [[application]] tables, so that all comments stay in place."""
    for match, rule in ((name.partition(RULE)[2].strip(), rule) for name, rule in edits.items()):
        if not match:
            continue
        document, lines = tomllib.loads(text), (text and text.rstrip("\n") + "\n").split("\n")
        index = _rule_index(document, match)
        prefix = f"{APPLICATION}[" if index is None else f"{APPLICATION}[{index + 1}]"
        own = [at for key, at in lines_of_keys(text).items() if key.startswith(prefix)]
        if rule is not None:
            known = {} if index is None else document[APPLICATION][index]
            head = [] if known else ["", f"[[{APPLICATION}]]", _line("match", match)]
            at = max(own, default=len(lines) - 1)
            lines[at:at] = head + [_line(n, value) for n, value in rule.items() if n not in known]
        elif index is not None and own:
            first = min(own) - 1
            del lines[first - (not lines[first - 1].strip()) : max(own)]
        text = "\n".join(lines).lstrip("\n")
    return text


def edited_text(text: str, edits: Edits) -> str:
    """Return the edited text of a config. Its comments and the order of keys do not change.

    UsageError: the text is not TOML. InternalError: the new text would not have the edited values.
    """
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    try:
        expected = tomllib.loads(text)
        document = tomlkit.parse(text)
        if not isinstance(document.get(APPLICATION), tomlkit.items.Array):  # of inline tables
            document = tomlkit.parse(_with_rules(text, edits))
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


def commented_text(edits: Edits, channels: tuple[str, ...] = ()) -> str:
    """Return the text of a new config with these values, and other top-level keys as comments.

    channels: channels of its only actuator; if empty, the config has no actuator.
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
    """Return the text of an [[actuator]] table with these channels."""
    return f"[[actuator]]\n{_line('channels', channels)}\n"


def _comment(text: str) -> str:
    lines = textwrap.wrap(text, 98, break_long_words=False, break_on_hyphens=False)
    return "".join(f"# {line}\n" for line in lines)


def _line(name: str, value: Any) -> str:
    import tomlkit

    return tomlkit.dumps({name: list(value) if isinstance(value, tuple) else value}).strip()


class LiveEdits:
    """The edits since the daemon started. They override the values of the config file at `path`.

    Only one thread may use it. values: the edits in effect.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.values: dict[str, Any] = {}
        self._undo: deque[dict[str, Any]] = deque(maxlen=UNDO_MAX)  # values before each change

    @property
    def undo_count(self) -> int:
        """Number of changes that can be undone."""
        return len(self._undo)

    def accept(self, changes: Edits) -> None:
        """Add edits that the caller has checked."""
        self._undo.append(self.values)
        self.values = {**self.values, **changes}

    def without_last(self) -> dict[str, Any]:
        """Return the edits as they were before the last change. UsageError: there is no change."""
        if not self._undo:
            raise UsageError("there is nothing to undo; nothing has been changed since the start")
        return dict(self._undo[-1])

    def undo(self) -> None:
        """Undo the last change. The caller must have checked the edits of `without_last`."""
        self.values = self.without_last()
        self._undo.pop()

    def unsaved(self) -> dict[str, Any]:
        """Return what the file says of each key with another value; None: it lacks the key."""
        try:
            document = tomllib.loads(text_of(self._path, or_empty=True)) if self.values else {}
        except (ValueError, UsageError):  # saving will say what is wrong with the file
            return dict.fromkeys(self.values)
        edits = {n: [*v] if isinstance(v, tuple) else v for n, v in self.values.items()}
        return {n: old for n, v in edits.items() if (old := value_in(document, n)) != v}

    def save(self) -> None:
        """Write the edits to the config file. UsageError, InternalError: it cannot be changed."""
        text = text_of(self._path, or_empty=True)
        changed = edited_text(text, self.values)
        if changed != text:
            write_private(self._path, changed.encode())
        # The file now holds the edits, so undoing an edit must restore the file's earlier value.
        document = tomllib.loads(text)
        before = {name: value_in(document, name) for name in self.values}
        self._undo = deque(({**before, **edits} for edits in self._undo), UNDO_MAX)


def value_in(document: dict[str, Any], name: str) -> Any:
    """Return the value of a key in a parsed config; None if the config lacks it."""
    if match := name.partition(RULE)[2]:
        index = _rule_index(document, match.strip())
        rule = {} if index is None else document[APPLICATION][index]
        return {key: value for key, value in rule.items() if key != "match"} if rule else None
    section, _, key = name.rpartition(".")
    table = document.get(section, {}) if section else document
    return table.get(key) if isinstance(table, dict) else None
