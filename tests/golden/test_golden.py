import json

import pytest

from tests.golden.golden import DIGESTS, digests, machine, quick
from tests.support.recordings import require_recordings


def test_a_sample_of_all_outputs_has_its_golden_digests() -> None:
    require_recordings()
    golden = json.loads(DIGESTS.read_text())
    if golden["machine"] != machine():
        pytest.skip("this machine rounds logarithms, spectra or matrices differently")
    found = digests(quick)
    assert len(found) > 10
    assert found == {name: golden[name] for name in golden if quick(name)}
