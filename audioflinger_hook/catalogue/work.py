"""Processes one item: renders its vibration, unless a valid result exists already."""

import errno
import json
import math
import pickle
import platform
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

from audioflinger_hook.catalogue.addresses import is_url, scrubbed
from audioflinger_hook.catalogue.item import Item
from audioflinger_hook.catalogue.listing import is_same
from audioflinger_hook.catalogue.measures import VibrationMeter
from audioflinger_hook.catalogue.recipe import VERSION, Recipe
from audioflinger_hook.catalogue.storage import (
    RECORD,
    Storage,
    identity_of,
    local_copy,
    sha256_of,
    storage_of,
)
from audioflinger_hook.catalogue.timing import Timing, has_errno
from audioflinger_hook.exports.export import export
from audioflinger_hook.sources import FileTap, TapClient
from audioflinger_hook.sources.film import FILMS, FilmTap
from audioflinger_hook.sources.tap import PartTap, SteadyTap
from device.errors import CushionError, InternalError, UsageError, unexpected

State = Literal["rendered", "skipped", "failed"]
_cached_storage = lru_cache(maxsize=4)(storage_of)

FIGURES = (  # fields that a record takes from the report of an export
    "frames", "samplerate", "channels", "peak", "leak_above_250_hz_db", "limited_samples",
    "replaced_samples", "warnings",
)  # fmt: skip


class DeathError(InternalError):
    """The item ended its workers in an earlier run."""


@dataclass(frozen=True)
class Outcome:
    """The result of one item.

    record: content of the record (a JSON file beside the result); empty if the item failed.
    stops: whether all further items would fail for the same reason, such as a full disk.
    """

    item: Item
    state: State
    seconds: float
    record: dict[str, Any] = field(default_factory=dict)
    error: str = ""
    exit_code: int = 0
    stops: bool = False


class ItemStatus(NamedTuple):
    """State of an item before a run. error: why the item is unreadable."""

    state: Literal["done", "outdated", "missing", "unreadable"]
    error: str = ""


def do_batch(recipe: bytes, items: Sequence[Item], timing: Timing) -> list[Outcome]:
    """Process items; return the outcomes in order. recipe: pickled. Any thread may call this."""
    unpickled = _unpickled(recipe)
    return [do_item(unpickled, item, timing) for item in items]


_unpickled: Callable[[bytes], Recipe] = lru_cache(maxsize=4)(pickle.loads)


def do_item(recipe: Recipe, item: Item, timing: Timing) -> Outcome:
    """Process one item; return its outcome, also after an error. Only interruptions are raised."""
    start_s = timing.clock()
    try:
        if recipe.version != VERSION:
            raise UsageError(
                f"this worker has version {VERSION}, the run has version {recipe.version}; "
                "install the same version of cushion on all machines"
            )
        state, record = timing.repeated(lambda: _do(recipe, item, timing))
        return Outcome(item, state, timing.clock() - start_s, record)
    except CushionError as error:
        found = error
    except Exception as error:
        found = unexpected(error)
        found.__cause__ = error
    text, shown = scrubbed(str(found)), scrubbed(item.audio)
    text = text if shown in text else f"{shown}: {text}"
    stops = has_errno(found, errno.ENOSPC, errno.EDQUOT) or recipe.version != VERSION
    seconds = timing.clock() - start_s
    return Outcome(item, "failed", seconds, error=text, exit_code=found.exit_code, stops=stops)


def failed_by_death(recipe: Recipe, item: Item, error: str, is_tried_again: bool) -> Outcome:
    """Return the failure of an item that ended its workers. It may be tried again by later runs."""
    with suppress(CushionError):
        if not is_tried_again and (key := _key(recipe, item)):
            record = {"key": key, "version": VERSION, "audio": item.audio, "death": scrubbed(error)}
            _write_record(_cached_storage(recipe.out), recipe.name(item), record)
    return Outcome(item, "failed", 0.0, error=scrubbed(error), exit_code=DeathError.exit_code)


def status_of(recipe: Recipe, items: Iterable[Item], timing: Timing) -> Iterator[ItemStatus]:
    """Yield the status of each item, in order. CushionError: the storage of the results fails."""
    storage = storage_of(recipe.out)
    for item in items:
        name = recipe.name(item)
        try:
            key = timing.repeated(lambda: _key(recipe, item))  # noqa: B023
        except CushionError as error:
            yield ItemStatus("unreadable", str(error))
            continue
        try:
            yield timing.repeated(lambda: _status_with(recipe, storage, name, key))  # noqa: B023
        except (DeathError, UsageError) as error:
            yield ItemStatus("unreadable", str(error))


def _status_with(recipe: Recipe, storage: Storage, name: str, key: str | None) -> ItemStatus:
    """Return the status of an item whose sound is readable. key: see `_key`."""
    if key is not None and _right_record(recipe, storage, name, key):
        return ItemStatus("done")
    if key is None or storage.stamp(name) or storage.stamp(name + RECORD):
        return ItemStatus("outdated")
    return ItemStatus("missing")


def _do(recipe: Recipe, item: Item, timing: Timing) -> tuple[State, dict[str, Any]]:
    storage = _cached_storage(recipe.out)
    key, name = _key(recipe, item), recipe.name(item)
    if key is not None and (record := _right_record(recipe, storage, name, key)):
        return "skipped", record
    with local_copy(item.audio) as path:
        if key is None:
            key = recipe.key(item, {"sha256": sha256_of(path)})
            if record := _right_record(recipe, storage, name, key):
                return "skipped", record
        return "rendered", _render(recipe, item, storage, path, key, timing)


def _render(
    recipe: Recipe, item: Item, storage: Storage, path: Path, key: str, timing: Timing
) -> dict[str, Any]:
    start_s = timing.clock()
    settings = recipe.settings_of(item)
    name = recipe.name(item)
    if is_same(item.audio, f"{recipe.out}/{name}"):  # the sound is a link to its own result
        raise UsageError(f"{item.audio} is the file that its result would replace; name another id")

    def make(target: Path) -> dict[str, Any]:
        tap, options = open_sound(path, item, recipe), recipe.options
        client, meter = TapClient(tap), VibrationMeter(settings.rig)
        report = export(client, target, settings, options, warnings=tap.warnings, watch=meter)
        found = {one: getattr(report, one) for one in FIGURES}
        found["warnings"] = [str(one).replace(str(path), item.audio) for one in report.warnings]
        return {**found, **meter.measures()}

    try:
        figures, made, sha256 = storage.put(name, make)
    except CushionError as error:
        if is_url(item.audio) and str(path) in str(error):
            # The user knows the URL, not the temporary copy.
            error.args = (str(error).replace(str(path), scrubbed(item.audio)),)
        raise
    record = {
        "key": key,
        "version": VERSION,
        "audio": item.audio,
        "bytes": made.size,
        "sha256": sha256,
        "stamp": made.stamp,
        "profile": settings.profile,
        **{name: _finite(value) for name, value in figures.items()},
        "seconds": round(timing.clock() - start_s, 4),
        "host": platform.node(),
    }
    _write_record(storage, name, record)
    return record


def open_sound(path: Path, item: Item, recipe: Recipe) -> SteadyTap:
    """Return a reader of an item's sound. UsageError: the sound or wanted part is unreadable."""
    tap, skipped = _open(path, item, recipe)
    if not (item.start_s or item.duration_s or item.picked):
        return tap
    try:
        return PartTap(tap, item.start_s, item.duration_s, item.picked, skipped)
    except UsageError:
        tap.close()
        raise


def _open(path: Path, item: Item, recipe: Recipe) -> tuple[SteadyTap, int]:
    """Return a reader of a sound, and the number of frames that it skips at the beginning."""
    track, language = item.track or recipe.track, item.language or recipe.language
    is_film = item.track or item.language or path.suffix.lower() in FILMS
    if is_film and path.is_file() and path.stat().st_size:
        return FilmTap(path, track=track, language=language), 0
    try:
        tap = FileTap(path)
    except UsageError as error:
        if "is not a sound file" not in str(error):
            raise
        try:  # AAC, WMA and other formats that libsndfile cannot read
            return FilmTap(path, track=track, language=language), 0
        except UsageError:
            raise error from None
    first = round(item.start_s * tap.samplerate)
    if not (0 < first < (tap.frames_expected or 0) and tap.divisible):
        return tap, 0
    tap.close()
    return FileTap(path, first=first), first


def _key(recipe: Recipe, item: Item) -> str | None:
    """Return the key of the item's present result; None if known only after a download."""
    if recipe.verify:
        if is_url(item.audio):
            return None
        return recipe.key(item, {"sha256": sha256_of(Path(item.audio))})
    if (found := identity_of(item.audio)) is None:
        FileTap(Path(item.audio)).close()  # raises an error that states the reason
        raise UsageError(f"{item.audio} cannot be read; check the path")
    return recipe.key(item, {"audio": item.audio, "size": found.size, "stamp": found.stamp})


def _right_record(recipe: Recipe, storage: Storage, name: str, key: str) -> dict[str, Any]:
    """Return the record of a complete result with this key; empty if there is none.

    DeathError: the item with this key has ended its workers, and is not to be tried again.
    """
    if (text := storage.read(name + RECORD)) is None:
        return {}
    try:
        record = json.loads(text)
        right = record["key"] == key
        if right and "death" in record and not recipe.retry_died:
            raise DeathError(f"{record['death']}; to try it again, add --retry-died")
        size, stamp, sha256 = record["bytes"], record["stamp"], record["sha256"]
    except (ValueError, TypeError, KeyError, RecursionError):
        return {}  # incomplete, or written by another program
    found = storage.stamp(name) if right else None
    if found is None or found.size not in (None, size):
        return {}
    if found.stamp != stamp:
        # Files in a copied folder have other times, although their content may be equal.
        record["stamp"] = storage.restamped(name, sha256)
        if record["stamp"] is None:
            return {}
        _write_record(storage, name, record)
    return dict(record)


def _write_record(storage: Storage, name: str, record: dict[str, Any]) -> None:
    text = json.dumps(record, allow_nan=False, separators=(",", ":"))
    storage.write(name + RECORD, text.encode() + b"\n")


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
