"""What takes minutes; `make soak` runs it, and the bench shows the last results."""

from collections.abc import Callable
from functools import partial

import pytest

from tests.support.random_rigs import SHARES
from tests.support.soak import soak_energy, soak_identification, soak_scene, soak_tone
from tools.records import PROJECT_ROOT
from tools.soak_record import HOPS, RECORD, RIGS, SAMPLES, SoakRecord, keep_record

SOAKS: dict[str, tuple[Callable[[], SoakRecord], int]] = {
    "nothing is left in memory": (soak_scene, HOPS),
    "a tone is as loud and pure as at first": (soak_tone, HOPS),
    "no energy of the linear rig creeps up": (partial(soak_energy, "linear"), SAMPLES),
    "no energy of the non-linear rig creeps up": (partial(soak_energy, "nonlinear"), SAMPLES),
}
for each in SHARES:
    what = f"rigs are identified at {each} Xmax, and their intervals hold"
    SOAKS[what] = (partial(soak_identification, each), RIGS)


@pytest.mark.soak
@pytest.mark.parametrize("what", SOAKS)
def test_after_a_million_hops_a_hundred_million_samples_and_two_hundred_rigs(what):
    soaked, least = SOAKS[what]
    record = soaked()
    keep_record(record, PROJECT_ROOT / RECORD)  # a failure is kept as well
    assert (record.hops or record.samples or record.rigs or 0) >= least
    assert record.passed, record
