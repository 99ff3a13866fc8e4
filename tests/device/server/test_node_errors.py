"""The server's counts of late cycles are those that `pw-top` prints."""

import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from device.server.node_errors import INTERVAL_S, NodeErrors, errors_in

LISTING = """\
S   ID  QUANT   RATE    WAIT    BUSY   W/Q   B/Q  ERR FORMAT           NAME
S   51      0      0    ---     ---   ---   ---     0                  cushion-9-1.tap
S   ID  QUANT   RATE    WAIT    BUSY   W/Q   B/Q  ERR FORMAT           NAME
R   26   1024  48000 123.4us   6.5us  0.01  0.00    7     F32P 2 48000 desktop
R   51   1024  48000  69.7us  24.8us  0.00  0.00   18     F32P 2 48000  + cushion-9-1.tap
R   52   1024  48000  61.7us  22.8us  0.00  0.00    2     F32P 1 48000  + cushion-9-1.vibration
R   53   1024  48000  61.7us  22.8us  0.00  0.00    4     F32P 1 48000  + a program of two words
"""
NAMES = ("cushion-9-1.tap", "cushion-9-1.vibration")


def test_the_latest_listing_counts_and_other_nodes_do_not():
    assert errors_in(LISTING, NAMES) == dict(zip(NAMES, (18, 2), strict=True))
    assert errors_in("", NAMES) == {}


def looked(errors: NodeErrors, *times_s: float, names: tuple[str, ...] = NAMES) -> None:
    for now_s in times_s:
        errors.update(names, now_s)
        end_s = time.monotonic() + 10.0
        while errors.process is not None and time.monotonic() < end_s:
            os.sched_yield()
            errors.update(names, now_s)


@pytest.fixture
def pw_top(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Make a program of that name that runs this text."""
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)

    def make(text: str) -> None:
        (tmp_path / "pw-top").write_text(f"#!/bin/sh\n{text}\n")
        (tmp_path / "pw-top").chmod(0o755)

    return make


def test_each_stream_has_its_count_and_that_of_a_chain_that_has_gone_is_kept(pw_top):
    errors = NodeErrors()
    assert errors.count(".tap") is None
    pw_top(f"cat <<'END'\n{LISTING}END")
    looked(errors, 0.0)
    pw_top(f"cat <<'END'\n{LISTING.replace('-9-1', '-9-2')}END")
    looked(errors, INTERVAL_S, names=tuple(name.replace("-9-1", "-9-2") for name in NAMES))
    assert (errors.count(".tap"), errors.count(".vibration")) == (36, 4)


def test_a_program_without_a_batch_mode_is_asked_once_and_the_counts_stay_unknown(pw_top, tmp_path):
    pw_top(f"echo asked >> {tmp_path / 'log'}; exit 255")
    errors = NodeErrors()
    looked(errors, 0.0, INTERVAL_S, 2.0 * INTERVAL_S)
    assert errors.count(".tap") is None
    assert (tmp_path / "log").read_text() == "asked\n"
