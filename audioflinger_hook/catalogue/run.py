"""A run: batches of items go to a place that works on them, and outcomes come back."""

from __future__ import annotations

import pickle
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from itertools import islice

from audioflinger_hook.catalogue.item import Item
from audioflinger_hook.catalogue.recipe import Recipe
from audioflinger_hook.catalogue.timing import Timing
from audioflinger_hook.catalogue.work import Outcome, do_batch
from audioflinger_hook.offline.pool import DIED, Place
from device.errors import InternalError

BATCH_MAX = 256
BATCH_S = 0.5  # sending a batch of this length costs little, and all workers end together
AHEAD = 2  # batches per slot that are under way or wait for a slot
POLL_S = 2.0  # between two checks whether the place has other slots, or is gone
DEATHS_MAX = 2  # an item with which this many workers died, while nothing else ran, has failed

Batch = list[Item]


def shard_of(items: Iterable[Item], index: int, count: int) -> Iterator[Item]:
    """Yield the items of one of several equal shares. index: from 1 to count."""
    return islice(iter(items), index - 1, None, count)


class Run:
    """Works on all items of a run. Iterate over `outcomes` once, from one thread.

    If workers die, the batches that they may have had run again, one at a time. So an item that
    ends its worker is found and fails, and no other item does.

    items: read one batch at a time. timing: clock and pauses of the workers.
    """

    def __init__(self, recipe: Recipe, items: Iterable[Item], place: Place, timing: Timing) -> None:
        self._recipe = pickle.dumps(recipe)
        self._items = iter(items)
        self._place = place
        self._timing = timing
        self._size = 1
        self._under_way: dict[Future[list[Outcome]], Batch] = {}
        self._suspects: deque[Batch] = deque()
        self._alone: Future[list[Outcome]] | None = None
        self._deaths: dict[int, int] = {}

    def outcomes(self) -> Iterator[list[Outcome]]:
        """Yield the outcomes of each batch, as they come. LostError: the place is gone."""
        self._submit_more()
        while self._under_way:
            done, _ = wait(self._under_way, POLL_S, FIRST_COMPLETED)
            # Asked before a batch is taken off the list: it raises if the place is gone.
            self._place.slots()
            for future in done:
                if found := self._result(future, self._under_way.pop(future)):
                    yield found
            self._submit_more()

    def _submit_more(self) -> None:
        """Keep the place busy; suspects run alone, when everything else has come back."""
        if self._suspects or self._alone:
            if not self._under_way:
                self._alone = self._submit(self._suspects.popleft())
            return
        most = AHEAD * self._place.slots()
        while len(self._under_way) < most and (batch := list(islice(self._items, self._size))):
            self._submit(batch)
            if any(future.done() for future in self._under_way):
                return  # a place that works at once: its outcomes are wanted now

    def _submit(self, batch: Batch) -> Future[list[Outcome]]:
        future = self._place.submit(do_batch, self._recipe, batch, self._timing)
        self._under_way[future] = batch
        return future

    def _result(self, future: Future[list[Outcome]], batch: Batch) -> list[Outcome]:
        """Return a batch's outcomes; none if it has to run again."""
        alone = future is self._alone
        if alone:
            self._alone = None
        try:
            found = future.result()
        except (Exception, CancelledError) as error:
            if not self._place.lost_worker(error):
                raise InternalError(
                    f"a batch failed ({type(error).__name__}: {error}); run the command again"
                ) from error
            return self._suspect(batch, alone=alone)
        # The size of the next batches follows from the time that items take.
        mean_s = sum(outcome.seconds for outcome in found) / len(found)
        wanted = BATCH_S / max(mean_s, BATCH_S / BATCH_MAX)
        self._size = max(1, min(BATCH_MAX, round(wanted), 2 * self._size))
        return found

    def _suspect(self, batch: Batch, *, alone: bool) -> list[Outcome]:
        """Let a batch run again, alone; return the failure of an item that ends its workers."""
        if not alone:
            self._suspects.append(batch)
            return []
        if len(batch) > 1:
            self._suspects.extendleft([item] for item in reversed(batch))
            return []
        item = batch[0]
        self._deaths[item.line] = self._deaths.get(item.line, 0) + 1
        if self._deaths[item.line] < DEATHS_MAX:
            self._suspects.appendleft(batch)
            return []
        error = f"{item.audio}: its worker died {DEATHS_MAX} times, {DIED}"
        return [Outcome(item, "failed", 0.0, error=error, exit_code=InternalError.exit_code)]
