"""A million hops of the live form; `make soak` runs them and the bench shows their last result."""

import pytest

from audioflinger_hook.bench.signals import PROJECT_ROOT
from audioflinger_hook.bench.soak import (
    HOPS,
    RECORD,
    SoakRecord,
    keep_record,
    soak_scene,
    soak_tone,
)


def kept(record: SoakRecord) -> SoakRecord:
    """The record, once it stands in docs/soak.json: a failure is kept as well."""
    keep_record(record, PROJECT_ROOT / RECORD)
    return record


@pytest.mark.soak
def test_a_million_hops_of_the_demo_scene_leave_nothing_in_memory() -> None:
    record = kept(soak_scene())
    assert record.hops >= HOPS
    assert record.passed, record


@pytest.mark.soak
def test_a_tone_is_as_loud_and_as_pure_after_a_million_hops_as_at_first() -> None:
    record = kept(soak_tone())
    assert record.hops >= HOPS
    assert record.passed, record
