from collections.abc import Callable

import pytest

from tests.support.commands import Done, call
from tools.bench import run
from tools.bench.__main__ import main
from tools.bench.report import Row, Section
from tools.bench.workbench import SUBJECTS, Effort, Workbench

LEAST = Effort(
    tones=2,
    low_tones=2,
    tone_s=1.0,
    bursts=3,
    onsets_a_burst=2,
    noisy_tones=8,
    frontier_sounds=2,
    compared_bursts=3,
    compared_recordings=1,
    settled_s=1.0,
    cost_repeats=1,
    slow_repeats=1,
    cost_s=0.2,
    cold_s=0.1,
    saving_repeats=1,
    saving_s=0.2,
    mix_rounds=2,
    scaling_s=1.6,
    channels_s=0.2,
    hops_timed=200,
    render_s=(1.0,),
    catalogue_s=(0.5,),
    catalogue_shared=(0.5, 2),
    rig_s=0.5,
    rig_timed_s=0.02,
    model_repeats=1,
    integrator_repeats=1,
    real_sounds=1,
)
"""Every section with as little as it can do: what it measures is not the point in most tests."""


def a_bench(found=(), absent=None):
    return Workbench(LEAST, SUBJECTS, found, absent or {})


def bench_command(*arguments: object) -> Done:
    return call(*arguments, program=main)


def run_benches(
    monkeypatch: pytest.MonkeyPatch, *arguments: object, **benches: Callable[[Workbench], Section]
) -> Done:
    chosen = tuple((name, measure, 1.0) for name, measure in benches.items())
    monkeypatch.setattr(run, "BENCHES", chosen)
    return bench_command("--quick", *arguments)


def fine(_: object) -> Section:
    return Section("Fine", "It works.", (Row("one", 1.0),))


def broken(_: object) -> Section:
    raise ValueError("the ground\nis gone")
