"""All sections of the benchmarks, measured one after another."""

from __future__ import annotations

import time
from collections.abc import Callable

from tools.bench.machine import machine_facts
from tools.bench.report import COMMAND, BenchReport, Missing, Section
from tools.bench.sections import (
    catalogue,
    comparison,
    damping,
    exports,
    fidelity,
    fit,
    frequency_error,
    frontier,
    kept_records,
    mixing,
    model_selection,
    profiles,
    protection,
    real_sounds,
    rendering,
    rig,
    savings,
    scaling,
    speech_suppression,
    speed,
    tones,
)
from tools.bench.sounds.signals import examine_recordings
from tools.bench.workbench import FULL, QUICK, SUBJECTS, Bench, Effort, Workbench
from tools.records import now

Progress = Callable[[str, float], None]
"""Called with the current section and the finished share, 0 to 1."""

BENCHES: tuple[tuple[str, Bench, float], ...] = (
    ("recordings", fidelity.recordings, 0.1),
    ("steady tones", tones.steady_tones, 5.0),
    ("onset lag", fidelity.onset_lag, 2.0),
    ("energy above 250 Hz", fidelity.energy_above, 1.0),
    ("principal frequencies", fidelity.principal_frequencies, 0.5),
    ("frequency error", frequency_error.frequency_error, 2.0),
    ("cost of a second", speed.cost_of_a_second, 8.0),
    ("cost after pauses", speed.cost_after_pauses, 3.0),
    ("worst hop", speed.worst_hop, 5.0),
    ("scaling of cost", scaling.cost_scaling, 4.0),
    ("savings", savings.savings, 7.0),
    ("speech suppression", speech_suppression.speech_suppression, 8.0),
    ("the mixer", mixing.mixing, 6.0),
    ("rendering", rendering.render_speed, 4.0),
    ("catalogue", catalogue.catalogue, 12.0),
    ("exports", exports.exports, 6.0),
    ("cost against error", frontier.frontier, 4.0),
    ("baselines", comparison.compared, 3.0),
    ("profiles", profiles.profiles, 3.0),
    ("on real sounds", real_sounds.on_real_sounds, 8.0),
    ("simulated rig", rig.linear_model, 2.0),
    ("work and precision", rig.work_and_precision, 5.0),
    ("model selection", model_selection.model_selection, 3.0),
    ("hard cases", model_selection.hard_cases, 4.0),
    ("scaling of the rig's cost", scaling.rig_scaling, 3.0),
    ("residual vibration", damping.residual_vibration, 2.0),
    ("protection", protection.protection, 1.0),
    ("protection live", protection.live_cost, 3.0),
    ("fit", fit.fit, 10.0),
    ("live bursts", kept_records.live_bursts, 0.1),
    ("live latency", kept_records.live_latency, 0.1),
    ("soak", kept_records.transform_soak, 0.1),
    ("soak of the rig", kept_records.rig_soak, 0.1),
    ("soak of the identification", kept_records.identification_soak, 0.1),
)


def run_bench(
    quick: bool, progress: Progress | None = None, *, effort: Effort | None = None
) -> BenchReport:
    """Measure all sections on this machine and return the report.

    quick: whether to measure less material.
    progress: function to call with the current section and the finished share of the work.
    effort: amount of measurement, which replaces the amount chosen by `quick`.
    """
    start_s = time.monotonic()
    machine = machine_facts()
    date = now()
    bench = Workbench(effort or (QUICK if quick else FULL), SUBJECTS, *examine_recordings())
    total = sum(weight for _, _, weight in BENCHES)
    done = 0.0
    sections = []
    for name, measure, weight in BENCHES:
        if progress:
            progress(name, done / total)
        sections.append(_measured(name, measure, bench))
        done += weight
    if progress:
        progress("done", 1.0)
    return BenchReport(date, quick, time.monotonic() - start_s, machine, tuple(sections))


def _measured(name: str, measure: Bench, bench: Workbench) -> Section:
    try:
        return measure(bench)
    except Exception as error:
        title = name[0].upper() + name[1:]
        reason = f"its bench failed ({type(error).__name__}: {' '.join(str(error).split())})"
        gone = Missing(f"every row of {name}", reason, COMMAND)
        return Section(title, "This could not be measured here.", (), (gone,))
