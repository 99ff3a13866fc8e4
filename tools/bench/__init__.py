"""The bench: what the transform and the simulated rig cost and how far they are off, measured here.

    signals, recordings --.
                          |-> benches (tones, fidelity, speed, growth, savings, mixing, rendering,
    subjects (live, ...) -'        measures, cost,       rig, ...)         |
    comparators                    likeness                               |
                                                                           v
           soak record, live record ------------------------------------> report -> Markdown, JSON
                 ^                                                         '----> drawing
                 '- live_latency (live_daemon, live_recording, arrival, lag), by tools/latency.py

    report = run_bench(quick=True, progress=None)
    drawn = plots(report, Path("docs/images"))
    print(report.to_markdown(pictures_in(Path("docs/benchmarks.md"), drawn)))

Nothing in a report is typed in: benches return rows, and limits are compared by the report.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from tools.bench.machine import machine_facts
from tools.bench.report import COMMAND, BenchReport, Missing, Must, Row, Section
from tools.bench.sections import (
    attacks,
    damping,
    damping_levels,
    damping_recordings,
    fidelity,
    frequency_error,
    frontier,
    identification,
    levels,
    mixing,
    onset_detection,
    protection,
    recordings,
    rendering,
    rig,
    savings,
    speech_suppression,
    speed,
    tones,
)
from tools.bench.sections import baselines as comparison
from tools.bench.sections import live_latency as live_report
from tools.bench.sections import model_by_second as rungs_by_second
from tools.bench.sections import model_selection as rungs
from tools.bench.sections import profiles as profile_measures
from tools.bench.sections import rig_precision as precision
from tools.bench.sections import rig_scaling as rig_growth
from tools.bench.sections import scaling as growth
from tools.bench.sections import soaks as soak_report
from tools.bench.soak_record import now
from tools.bench.sounds.signals import examine_recordings
from tools.bench.workbench import FULL, QUICK, SUBJECTS, Bench, Effort, Workbench

__all__ = [
    "BENCHES",
    "BenchReport",
    "Missing",
    "Must",
    "Row",
    "Section",
    "pictures_in",
    "plots",
    "run_bench",
]

Progress = Callable[[str, float], None]
"""Told what is measured now, and the share of the work done before it, 0 to 1."""

BENCHES: tuple[tuple[str, Bench, float], ...] = (
    ("recordings", recordings.recordings, 0.1),
    ("steady tones", tones.steady_tones, 5.0),
    ("onset lag", fidelity.onset_lag, 2.0),
    ("onsets found", onset_detection.onsets_found, 4.0),
    ("attacks", attacks.attacks, 2.0),
    ("energy above 250 Hz", fidelity.energy_above, 1.0),
    ("principal frequencies", fidelity.principal_frequencies, 0.5),
    ("frequency error", frequency_error.frequency_error, 2.0),
    ("gain", tones.gain_over_samplerates, 2.0),
    ("splits", fidelity.any_split, 3.0),
    ("cost of a second", speed.cost_of_a_second, 8.0),
    ("cost after pauses", speed.cost_after_pauses, 3.0),
    ("worst hop", speed.worst_hop, 5.0),
    ("growth of cost", growth.cost_growth, 4.0),
    ("savings", savings.savings, 7.0),
    ("speech suppression", speech_suppression.speech_suppression, 8.0),
    ("effects under speech", speech_suppression.effects_under_speech, 0.5),
    ("the mixer", mixing.mixing, 6.0),
    ("rendering", rendering.render_speed, 4.0),
    ("cost against error", frontier.frontier, 4.0),
    ("comparators", comparison.comparison, 3.0),
    ("level", levels.level, 3.0),
    ("profiles", profile_measures.profiles, 3.0),
    ("simulated rig", rig.linear_model, 2.0),
    ("rungs of the rig", precision.work_and_precision, 5.0),
    ("ladder of the rig", rungs.ladder_of_rungs, 3.0),
    ("ladder by second", rungs_by_second.rungs_by_second, 1.0),
    ("growth of the rig's cost", rig_growth.rig_growth, 3.0),
    ("residual vibration", damping.residual_energy, 2.0),
    ("settling", damping.settling_time, 0.5),
    ("residual vibration by level", damping_levels.residual_energy_by_level, 2.0),
    ("settling by level", damping_levels.settling_time_by_level, 0.1),
    ("damping on recordings", damping_recordings.damping_on_recordings, 7.0),
    ("protection", protection.protection, 1.0),
    ("live cost of the three", protection.live_cost, 3.0),
    ("exposure", protection.weighting, 0.1),
    ("identification", identification.identification, 8.0),
    ("memory", growth.memory_held, 4.0),
    ("live record", live_report.live_result, 0.1),
    ("soak record", soak_report.soak_result, 0.1),
    ("soak of the rig", soak_report.rig_soak_result, 0.1),
    ("soak of the identification", soak_report.identified_result, 0.1),
)
"""Every bench in the order of the report: its name, the bench, and about how long it takes."""


def run_bench(
    quick: bool,
    progress: Progress | None = None,
    *,
    effort: Effort | None = None,
) -> BenchReport:
    """Measure everything on this machine and return the report.

    quick: the same rows from less material, in under a minute instead of about five. effort: other
    counts than those two. The calling thread does the work; costs are its own CPU time.
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
    """Return what a bench gives; where it fails a section that says so: the others go on."""
    try:
        return measure(bench)
    except Exception as error:
        title = name[0].upper() + name[1:]
        reason = f"its bench failed ({type(error).__name__}: {' '.join(str(error).split())})"
        gone = Missing(f"every row of {name}", reason, COMMAND)
        return Section(title, "This could not be measured here.", (), (gone,))


def plots(report: BenchReport, folder: Path) -> list[Path]:
    """Write the pictures of a report, PNG, into a folder that exists; return their paths.

    What could not be measured has no picture.

    Raises
    ------
    UsageError
        matplotlib is not installed, or the folder cannot be written.
    """
    from tools.bench.figures.pictures import draw_all

    return draw_all(report, folder)


def pictures_in(page: Path, drawn: Sequence[Path]) -> dict[str, str]:
    """Return what `to_markdown` takes to show pictures that `plots` drew under a page's folder."""
    from tools.bench.figures.pictures import shown_in

    return shown_in(page, drawn)
