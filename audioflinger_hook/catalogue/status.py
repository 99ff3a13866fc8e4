"""What a run would still have to do, without doing it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

from audioflinger_hook.catalogue.item import Item
from audioflinger_hook.catalogue.recipe import Recipe
from audioflinger_hook.catalogue.storage import RECORD, storage_of
from audioflinger_hook.catalogue.timing import Timing
from audioflinger_hook.catalogue.work import record_of
from device.errors import CushionError

ItemState = Literal["done", "outdated", "missing", "unreadable"]
"""done: skipped by a run. outdated: there is a result or record, but not the right one.
missing: there is none. unreadable: the sound cannot be looked at."""


@dataclass(frozen=True)
class ItemStatus:
    """The state of one item, and what is wrong with an unreadable one."""

    item: Item
    state: ItemState
    error: str = ""


def status_of(recipe: Recipe, items: Iterable[Item], timing: Timing) -> Iterator[ItemStatus]:
    """Yield the state of each item, in order. LostError or UsageError: the storage is gone."""
    storage = storage_of(recipe.out)
    for item in items:
        try:
            key, record = timing.repeated(lambda: record_of(recipe, item, storage))  # noqa: B023
        except CushionError as error:
            yield ItemStatus(item, "unreadable", str(error))
            continue
        name = recipe.name(item)
        if record:
            yield ItemStatus(item, "done")
        elif key is None or storage.stamp(name) or storage.stamp(name + RECORD):
            yield ItemStatus(item, "outdated")
        else:
            yield ItemStatus(item, "missing")
