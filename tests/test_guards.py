"""The list of safety guards is up to date; `tools/guards.py` takes each out and runs its test."""

from pathlib import Path

import pytest

from tools.guards import MUTATIONS, Mutation

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize("mutation", MUTATIONS, ids=[one.guard for one in MUTATIONS])
def test_each_guard_is_where_the_list_says_and_has_its_test(mutation: Mutation) -> None:
    assert (ROOT / mutation.file).read_text("utf-8").count(mutation.old) == 1
    file, _, name = mutation.test.partition("::")
    assert f"def {name}" in (ROOT / file).read_text("utf-8")
