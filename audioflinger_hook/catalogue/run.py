"""A run sends batches of items to workers and collects the outcomes."""

import pickle
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from itertools import islice

from audioflinger_hook.catalogue.item import Item
from audioflinger_hook.catalogue.recipe import Recipe
from audioflinger_hook.catalogue.timing import Timing
from audioflinger_hook.catalogue.work import Outcome, do_batch, failed_by_death
from audioflinger_hook.offline.batch import ENDED, NO_SERVER, Place
from device.errors import InternalError

BATCH_MAX = 256
BATCH_S = 0.5  # wanted duration of a batch
AHEAD = 2  # batches submitted for each slot, running or waiting
POLL_S = 2.0  # time between two checks of the number of slots and of the connection
DEATHS_MAX = 2  # an item fails after this many deaths of workers that ran only this item

Batch = list[Item]


class Run:
    """Processes all items of a run. Iterate over `outcomes` once, from one thread.

    If a worker dies, all batches that may have caused its death run again, one at a time. Thus only
    the item that kills its worker fails.
    items: read batch by batch. place: runs the batches. timing: clock and delays of the workers.
    """

    def __init__(self, recipe: Recipe, items: Iterable[Item], place: Place, timing: Timing) -> None:
        self._plain_recipe = recipe
        self._recipe = pickle.dumps(recipe)
        self._items = iter(items)
        self._place = place
        self._timing = timing
        self._size = 1
        self._under_way: dict[Future[list[Outcome]], Batch] = {}
        self._suspects: deque[Batch] = deque()
        self._alone: Future[list[Outcome]] | None = None
        self._deaths: Counter[int] = Counter()

    def outcomes(self) -> Iterator[list[Outcome]]:
        """Yield the outcomes of each finished batch. LostError: the workers cannot be reached."""
        self._submit_more()
        while self._under_way:
            done, _ = wait(self._under_way, POLL_S, FIRST_COMPLETED)
            # `slots` is called first: it raises an error if the connection to the workers is lost.
            self._place.slots()
            for future in done:
                if found := self._result(future, self._under_way.pop(future)):
                    yield found
            self._submit_more()

    def _submit_more(self) -> None:
        """Keep AHEAD batches per slot under way. One that may have killed a worker runs alone."""
        if self._suspects or self._alone:
            if not self._under_way:
                self._alone = self._submit(self._suspects.popleft())
            return
        most = AHEAD * self._place.slots()
        while len(self._under_way) < most and (batch := list(islice(self._items, self._size))):
            self._submit(batch)
            if any(future.done() for future in self._under_way):
                return  # The batch ran at once in this process, so its outcomes are returned now.

    def _submit(self, batch: Batch) -> Future[list[Outcome]]:
        future = self._place.submit(do_batch, self._recipe, batch, self._timing)
        self._under_way[future] = batch
        return future

    def _result(self, future: Future[list[Outcome]], batch: Batch) -> list[Outcome]:
        """Return a batch's outcomes, or an empty list if the batch has to run again."""
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
        # The size of the next batches is chosen so that a batch takes BATCH_S.
        mean_s = sum(outcome.seconds for outcome in found) / len(found)
        wanted = BATCH_S / max(mean_s, BATCH_S / BATCH_MAX)
        self._size = max(1, min(BATCH_MAX, round(wanted), 2 * self._size))
        return found

    def _suspect(self, batch: Batch, *, alone: bool) -> list[Outcome]:
        """Queue a batch to run alone, or its items. After DEATHS_MAX deaths, return a failure."""
        item, *others = batch
        if not alone:
            self._suspects.append(batch)
        elif others:
            self._suspects.extendleft([one] for one in reversed(batch))
        else:
            self._deaths[item.line] += 1
            if self._deaths[item.line] >= DEATHS_MAX:
                death = self._place.death()
                error = f"{item.audio}: its worker died {DEATHS_MAX} times, {death}"
                is_tried_again = death in (NO_SERVER, ENDED)
                return [failed_by_death(self._plain_recipe, item, error, is_tried_again)]
            self._suspects.appendleft(batch)
        return []
