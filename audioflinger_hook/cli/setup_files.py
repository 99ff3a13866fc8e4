"""Writes the files of `cushion setup`, the config and the service, and restores them on undo.

Before a setup changes files, it records the changes in `setup-undo.json` in the state folder. Undo
reverts the last recorded setup. A setup that fails restores the files. A copy of the earlier config
is kept until undo. Undo keeps a copy of a config that the user edited after the setup.
"""

import itertools
import json
import os
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from audioflinger_hook.config import toml_text
from audioflinger_hook.service import autostart
from audioflinger_hook.service import install as service
from audioflinger_hook.service.autostart import install_page_entry, remove_page_entry
from device import atomic_file
from device.errors import CushionError, UsageError

RECORDS_NAME = "setup-undo.json"
RECORDS_MAX = 20  # largest number of setups that can be undone


@dataclass(frozen=True)
class Record:
    """The changes of one setup. Paths are absolute."""

    config: str
    written: str | None  # the config's new text; None if unchanged
    backup: str | None  # copy of the earlier config; None if unchanged or if there was no config
    unit_changed: bool  # whether the service was installed
    unit: str | None  # the earlier text of the unit; None if there was no unit
    started: bool = False  # whether the daemon started at every login before


def write(path: Path, before: str | None, text: str, *, with_service: bool) -> str:
    """Write the config, the service and the menu's entry. Return the config's backup, or "".

    before: the file's text before the questions; None if there was no file. with_service: whether
    to start the daemon at every login. UsageError: the file has changed since the questions, or a
    folder cannot be written. WriteError: the disk is full or failed. After an error or an
    interruption, all files are restored if possible.
    """
    if text_of(path) != before:
        raise UsageError(
            f"{path} was changed during the setup, so setup did not change it; run setup again"
        )
    changes = text != before
    if not changes and not with_service:
        return ""
    earlier = _records()
    backup = None
    if changes:
        atomic_file.make_private_folder(path.parent)
        if before is not None:
            backup = _copy(path.read_bytes(), path, "before-setup")
    record = Record(
        config=str(path.absolute()),
        written=text if changes else None,
        backup=str(backup.absolute()) if backup else None,
        unit_changed=with_service,
        unit=service.installed_text() if with_service else None,
        started=with_service and autostart.is_on(),
    )
    try:
        _save([*earlier, record])
        if changes:
            atomic_file.write_bytes_atomically(path, text.encode())
        if with_service:
            if autostart.has_systemd():
                service.install(["--wait"], systemd=service.systemd_version())
            autostart.set_on(True)
        install_page_entry(service.own_command())
    except BaseException:
        with suppress(CushionError):  # `cushion setup --undo` can then restore the files
            if record in _records():
                _take_back(record, earlier)
            else:
                _remove_backup(record)
        raise
    return str(backup or "")


def text_of(path: Path) -> str | None:
    """Return a config file's text; None if there is no file. UsageError: it cannot be read."""
    return toml_text.text_of(path) if path.exists() or path.is_symlink() else None


def undo() -> tuple[list[str], tuple[str, ...]]:
    """Undo the last setup; return its steps, and commands that the user must run next.

    UsageError: there is no setup to undo, or a file cannot be read or removed.
    """
    records = _records()
    if not records:
        raise UsageError("there is nothing to undo: `cushion setup` has written nothing")
    return _take_back(records[-1], records[:-1])


def _take_back(record: Record, earlier: list[Record]) -> tuple[list[str], tuple[str, ...]]:
    done = [] if record.written is None else _restore_config(record)
    commands: tuple[str, ...] = ()
    if record.unit_changed:
        if not record.started:
            autostart.set_on(False)
            done.append("start at login: off")
        restored = service.restore(record.unit)
        if restored.changed or record.unit is not None:
            done.append(f"{restored.path}: {'as it was before' if record.unit else 'removed'}")
        commands = restored.commands
    _save(earlier)
    _remove_backup(record)
    if not earlier:
        done.append(f"{remove_page_entry()}: removed")
    return done, commands


def _remove_backup(record: Record) -> None:
    if record.backup is not None:
        with suppress(OSError):
            Path(record.backup).unlink()


def _restore_config(record: Record) -> list[str]:
    path = Path(record.config)
    try:
        before = Path(record.backup).read_bytes() if record.backup else None
    except OSError as error:
        why = f"{record.backup} cannot be read ({error.strerror})"
        raise UsageError(f"{why}, so {path} is not changed") from error
    done = []
    now = None
    try:
        with suppress(FileNotFoundError):
            now = path.read_bytes()
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}; move it away first") from error
    if now == before:
        return [f"{path}: as it was before"]
    if now not in ((record.written or "").encode(), None):
        done.append(f"{_copy(now or b'', path, 'undone')}: your later changes")
    if before is None:
        atomic_file.remove_file(path)
        return [*done, f"{path}: removed"]
    atomic_file.make_private_folder(path.parent)
    atomic_file.write_bytes_atomically(path, before, Path(record.backup or path))
    return [*done, f"{path}: as it was before"]


def _copy(content: bytes, path: Path, word: str) -> Path:
    """Write a copy of a file beside it under an unused name, and return the copy's path."""
    for number in itertools.count(1):
        found = path.with_name(f"{path.name}.{word}{f'-{number}' if number > 1 else ''}")
        if not os.path.lexists(found):
            break
    atomic_file.write_bytes_atomically(found, content, path)
    return found


def _records() -> list[Record]:
    path = service.state_folder() / RECORDS_NAME
    try:
        return [Record(**found) for found in json.loads(path.read_text(encoding="utf-8"))]
    except FileNotFoundError:
        return []
    except (OSError, ValueError, TypeError) as error:
        raise UsageError(f"{path} cannot be read ({error}); move it away first") from error


def _save(records: list[Record]) -> None:
    path = service.state_folder() / RECORDS_NAME
    if not records:
        with suppress(OSError):  # if this fails, the write below reports the reason
            path.unlink(missing_ok=True)
            return
    kept = [asdict(record) for record in records[-RECORDS_MAX:]]
    atomic_file.write_private(path, json.dumps(kept, indent=1).encode())
