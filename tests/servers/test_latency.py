"""Live latency on real servers: the tool measures it, and it stays what it is."""

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from audioflinger_hook.config.profiles import LIVE_DEFAULT, parameters_of
from audioflinger_hook.transform import HapticTransform
from tests.servers.daemons import ROOT, environment, running
from tests.servers.listening import ATTEMPTS, RATE_HZ, need
from tools.bench.sections.kept_records import CPU_PERCENT, LAG, NO_GROWTH_MS, USUAL_BLOCK_FRAMES
from tools.latency import main
from tools.live_latency.record import RECORD, TRUSTED_MS, LiveRecord, keep_records, read_records
from tools.sound_server import PROGRAMS, missing_programs

pytestmark = pytest.mark.calm

SOAK_S = float(os.environ.get("CUSHION_LATENCY_SOAK_S", "600"))
"""How long the latency is watched in the soak."""


def latency(*arguments: str, environ: dict[str, str] | None = None) -> Any:
    command = [sys.executable, str(ROOT / "tools/latency.py"), *arguments]
    pipes: Any = {"stdin": subprocess.DEVNULL, "capture_output": True, "text": True}
    return subprocess.run(command, env=environ, timeout=120.0, **pipes)


def measured(arguments: list[str], environ: dict[str, str] | None = None) -> Any:
    for attempt in range(1, ATTEMPTS + 1):
        done = latency("--json", *arguments, environ=environ)
        assert done.stderr == ""
        document = json.loads(done.stdout)
        assert document["schema"] == 1
        (found,) = document["records"]
        assert set(found) == {field.name for field in fields(LiveRecord)}
        record = LiveRecord(**found)
        print(record)
        usable = record.trusted and record.lag_median_ms is not None
        assert done.returncode == (0 if usable else 1)
        if usable or attempt == ATTEMPTS:
            return record
    raise AssertionError("unreachable")


@pytest.mark.servers
@pytest.mark.parametrize("kind", ["pipewire", pytest.param("pulse", marks=pytest.mark.soak)])
def test_the_tool_finds_a_plausible_lag_and_no_error_of_its_own(kind, tmp_path):
    need(missing_programs(kind))
    kept = tmp_path / "live.json"
    record = measured(["--kind", kind, "--seconds", "12", "--out", str(kept)])
    assert kind in record.server.lower()
    assert record.trusted
    assert abs(record.check_median_ms or 0.0) <= TRUSTED_MS
    assert 20.0 < record.lag_median_ms < 150.0
    # the budget leaves out what servers hold back, and no more than that
    assert -5.0 < record.lag_median_ms - record.budget_ms < 60.0
    transform = HapticTransform(RATE_HZ, 2, parameters_of(LIVE_DEFAULT))
    assert record.transform_ms == pytest.approx(1e3 * transform.latency_s, abs=0.1)
    assert (len(record.lags_ms), [each.name for each in read_records(kept)]) == (4, [record.name])


@pytest.mark.servers
def test_a_daemon_that_already_runs_is_measured_where_it_is(pipewire):
    done = latency("--here", environ=environment(pipewire))
    assert done.returncode == 1
    assert done.stderr == "latency: error: no daemon plays here; start one with `cushion run`\n"
    with running(pipewire):
        record = measured(["--here", "--play", "--seconds", "6"], environment(pipewire))
    assert record.block_frames is None
    assert 20.0 < record.lag_median_ms < 150.0
    assert abs(record.check_median_ms or 0.0) <= TRUSTED_MS


@pytest.mark.soak
@pytest.mark.parametrize("kind", sorted(PROGRAMS))
def test_the_latency_is_short_and_does_not_grow(kind, monkeypatch):
    need(missing_programs(kind))
    with tempfile.TemporaryDirectory(prefix="cushion-") as folder:
        out = Path(folder) / "live.json"
        arguments = ["--kind", kind, "--seconds", str(SOAK_S), "--out", str(out)]
        monkeypatch.setattr(sys, "argv", ["latency.py", *arguments])
        code = main()
        record: Any = read_records(out)[0]
    keep_records([record], ROOT / RECORD)  # a failure is kept as well
    assert code == 0
    assert record.block_frames == USUAL_BLOCK_FRAMES
    if record.busy:
        pytest.skip(f"load over {record.cores}, where nothing is promised: {record}")
    assert LAG.met(record.lag_median_ms), record
    assert NO_GROWTH_MS.met(abs(record.hidden_growth_ms)), record
    assert NO_GROWTH_MS.met(abs(record.growth_ms)), record
    assert CPU_PERCENT.met(record.cpu_percent), record
