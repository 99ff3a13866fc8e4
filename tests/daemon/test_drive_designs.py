"""Designs of rigs are made by a process, once, and what plays goes on where that fails."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from audioflinger_hook.config.settings import LiveSettings, Settings
from audioflinger_hook.daemon.native import plan as module
from audioflinger_hook.daemon.native.chains import Chains
from audioflinger_hook.daemon.native.plan import LONGEST_WAIT_S, ChainPlan, DriveDesigns
from audioflinger_hook.daemon.native.taps import Tap
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.sources import parse_tap
from device.address import parse_device
from device.drive.design import DriveDesign, DrivePlan
from device.errors import LostError, UsageError

ROOT = Path(__file__).parents[2]
CARE = {"protection": "on", "damping": "auto", "exposure_cap": "action"}
PAPER = DrivePlan.of("paper", 48_000, "auto", "on", "action")
CONSUMER = DrivePlan.of("consumer", 48_000, "off", "on", "off")


def made(designs: DriveDesigns, *plans: DrivePlan | None) -> list[DriveDesign | None]:
    deadline_s = time.monotonic() + 30.0
    while (found := designs.of(plans, time.monotonic())) is None:
        assert time.monotonic() < deadline_s
        assert designs.is_busy
        time.sleep(0.01)
    assert not designs.is_busy
    return found


def test_designs_of_a_process_are_those_that_would_be_made_here() -> None:
    designs = DriveDesigns()
    assert designs.of([None], 0.0) == [None]
    found = made(designs, PAPER, None, CONSUMER, PAPER)
    assert found[1] is None
    assert found[0] is found[3]
    for plan, design in ((PAPER, found[0]), (CONSUMER, found[2])):
        assert plan
        assert design
        here = plan.design()
        assert design == here
        assert design.worst_second == here.worst_second
        assert design.bounds().warmest == here.bounds().warmest
        for name, value in here.records.items():
            np.testing.assert_array_equal(design.records[name], value)
    # nothing more is made, whatever is asked for again
    assert designs.of([CONSUMER], 0.0) == [found[2]]


def test_another_wish_takes_the_place_of_one_under_way() -> None:
    designs, now_s = DriveDesigns(), time.monotonic()
    assert designs.of([PAPER], now_s) is None
    first = designs._call
    assert designs.of([CONSUMER], now_s) is None
    assert first
    assert first._process.returncode is not None
    assert made(designs, CONSUMER)[0]


def test_a_rate_that_is_too_low_is_the_users_mistake() -> None:
    with pytest.raises(UsageError, match="samplerate=4000 Hz is too low"):
        made(DriveDesigns(), DrivePlan.of("paper", 4_000, "off", "on", "off"))


def failing(*_: object) -> list[DriveDesign]:
    raise ZeroDivisionError("no design")


def test_a_process_that_fails_is_tried_again_later_and_later(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    started = []

    class Ended:
        def __init__(self, *_: object) -> None:
            started.append(now_s)

        def is_over(self, _now_s: float) -> bool:
            return True

        def result(self) -> None:
            raise LostError("it failed")

    monkeypatch.setattr(module, "Call", Ended)
    designs, now_s, failed = DriveDesigns(), 0.0, []
    while now_s < 200.0:
        try:
            assert designs.of([PAPER], now_s) is None
        except LostError:
            failed.append(now_s)
        assert designs.failure == "it failed"
        now_s += 0.5
    assert failed == started
    assert 8 < len(started) < 16
    assert np.diff(started)[-1] == LONGEST_WAIT_S
    with pytest.raises(LostError):
        designs.of([CONSUMER], now_s)
    assert started[-1] == now_s  # another wish is tried at once


def test_a_chain_plays_on_where_the_next_ones_design_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = RunConfig(
        parse_tap("default"), parse_device("sink:dac"), Settings(), LiveSettings(device="sink:dac")
    )
    tap = Tap("desk", ("FL", "FR"), "desk")
    before = ChainPlan.of(Settings(), tap, 48_000)
    wanted = ChainPlan.of(Settings(**cast(Any, CARE)), tap, 48_000)
    chains = Chains(config, tmp_path, lambda *_: None, DriveDesigns())
    monkeypatch.setattr(module, "designs_of", failing)
    current: Any = SimpleNamespace(chain=SimpleNamespace(plan=before), stands_s=lambda _: 0.0)
    chains.current = current
    deadline_s = time.monotonic() + 20.0
    while not chains.problem:
        chains.make(wanted, time.monotonic())
        assert time.monotonic() < deadline_s
        time.sleep(0.01)
    assert chains.problem == (
        "the former settings play on: damping and protection cannot be computed: "
        "ZeroDivisionError: no design"
    )
    assert chains.current is current
    assert chains.following is None
    chains.make(before, time.monotonic())
    assert not chains.problem
    chains.current = None  # nothing plays: the engine fails
    with pytest.raises(LostError, match="cannot be computed"):  # noqa: PT012
        while True:
            chains.make(wanted, time.monotonic())
            assert time.monotonic() < deadline_s
            time.sleep(0.01)


def test_the_daemon_does_not_import_what_takes_most_memory() -> None:
    code = (
        "import sys, audioflinger_hook.cli.run, audioflinger_hook.daemon.native.engine\n"
        "from audioflinger_hook.config.profiles import PROFILES, parameters_of\n"
        "from audioflinger_hook.transform.design import LiveDesign\n"
        "from device.rig import PAPER\n"
        "from device.rig.thermal import Temperatures\n"
        "for name in PROFILES: LiveDesign.of(parameters_of(name), 48_000).to_bytes()\n"
        "Temperatures(PAPER.thermal).step(0.3)\n"
        "print(*sys.modules)"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert "audioflinger_hook.daemon.native.engine" in loaded
    parts = ("signal", "optimize", "stats", "linalg", "fft", "special", "interpolate")
    heavy = {f"scipy.{part}" for part in parts}
    heavy |= {"numpy.random", "numpy.testing", "asyncio", "ssl", "hashlib", "rich.progress"}
    assert sorted(loaded & heavy) == []
