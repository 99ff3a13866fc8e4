"""The fast tier of the transform's sweeps: a few cases that cover the values of every parameter."""

from collections import defaultdict
from pathlib import Path

import pytest

HERE = Path(__file__).parent
CASES_MAX = 6


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark as exhaustive all cases but those with a value of a parameter that no case before had;
    of more than `CASES_MAX` of those, the first, the last and some between them stay."""
    cases: dict[str, list[pytest.Function]] = defaultdict(list)
    for item in items:
        if isinstance(item, pytest.Function) and HERE in item.path.parents:
            cases[item.nodeid.partition("[")[0]].append(item)
    for sweep in cases.values():
        if len(sweep) == 1:
            continue
        fresh = _with_new_values(sweep)
        step = max(1.0, (len(fresh) - 1) / (CASES_MAX - 1))
        kept = {fresh[round(at * step)] for at in range(min(len(fresh), CASES_MAX))}
        for item in sweep:
            if item not in kept:
                item.add_marker(pytest.mark.exhaustive)


def _with_new_values(sweep: list[pytest.Function]) -> list[pytest.Function]:
    known: set[tuple[str, object]] = set()
    fresh = []
    for item in sweep:
        values: set[tuple[str, object]] = {
            (name, value if isinstance(value, str | int | float) else id(value))
            for name, value in item.callspec.params.items()
        }
        if not values <= known:
            fresh.append(item)
        known |= values
    return fresh
