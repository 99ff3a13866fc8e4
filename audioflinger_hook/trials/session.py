"""The loop of a session: a trial is chosen, somebody answers it, and the row is kept."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol, TypeVar

from audioflinger_hook.trials.record import Rows

Trial = TypeVar("Trial", covariant=True)


class Script(Protocol[Trial]):
    """Decides which trials a session has, from the rows so far.

    next_trial: returns the next trial, and its columns for the record; None at the end.
    take: takes a recorded row: the columns of the trial, and those of its answer.
    """

    def next_trial(self) -> tuple[Trial, Mapping[str, Any]] | None: ...  # noqa: D102

    def take(self, row: Mapping[str, Any]) -> None: ...  # noqa: D102


def run(
    record: Rows,
    script: Script[Trial],
    answer: Callable[[Trial], Mapping[str, Any]],
    pause: Callable[[], None] = lambda: None,
) -> Iterator[Mapping[str, Any]]:
    """Yield each row after it is recorded. Trials that are recorded already are not repeated.

    answer: lets somebody answer a trial, and returns the columns of the answer. pause: called
    before the first trial of each later "block". Errors of both and WriteError pass through.
    """
    block = 1
    for row in record.trials:
        script.take(row)
        block = row.get("block", 1)
    while (chosen := script.next_trial()) is not None:
        trial, columns = chosen
        if columns.get("block", 1) > block:
            pause()
            block = columns["block"]
        row = {**columns, **answer(trial)}
        record.append(row)
        script.take(row)
        yield row
