"""What takes minutes; `make soak` runs it, and the bench shows the last results."""

import pytest

from device.rig.parameters import Model
from tests.support.random_rigs import SHARES
from tests.support.rig_soak import soak_energy
from tests.support.soak import soak_identification, soak_scene, soak_tone
from tools.records import PROJECT_ROOT
from tools.soak_record import HOPS, RECORD, RIGS, SAMPLES, SoakRecord, keep_record


def kept(record: SoakRecord) -> SoakRecord:
    """The record, once it stands in docs/soak.json: a failure is kept as well."""
    keep_record(record, PROJECT_ROOT / RECORD)
    return record


@pytest.mark.soak
@pytest.mark.parametrize("soaked", [soak_scene, soak_tone])
def test_a_million_hops_leave_nothing_in_memory_and_a_tone_as_loud_and_pure_as_at_first(soaked):
    record = kept(soaked())
    assert (record.hops or 0) >= HOPS
    assert record.passed, record


@pytest.mark.soak
@pytest.mark.parametrize("model", ["linear", "nonlinear"])
def test_over_a_hundred_million_samples_no_energy_creeps_up(model: Model) -> None:
    record = kept(soak_energy(model))
    assert (record.samples or 0) >= SAMPLES
    assert record.passed, record


@pytest.mark.soak
@pytest.mark.parametrize("share", SHARES)
def test_two_hundred_random_rigs_are_identified_and_their_intervals_hold(share: float) -> None:
    record = kept(soak_identification(share))
    assert record.rigs == RIGS
    assert record.passed, record
