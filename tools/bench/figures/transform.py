"""Pictures of the transform: CPU time and onset lag."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from audioflinger_hook.figures import palette
from tools.bench.figures.sheet import (
    SMALL_PT,
    TEXT_PT,
    frame,
    legend,
    limit,
    number_beside,
    sheet,
    ticks_at,
)
from tools.bench.report import BenchReport
from tools.bench.sections.fidelity import LAG_P95
from tools.bench.sections.speed import BLOCKSIZES, SECOND_MS
from tools.bench.workbench import LIVE, REFERENCE

TICKS_MS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
BESIDE_LIMIT = 3.5  # on the log axis, a number beside a point reaches this multiple of the cost
COLOURS = {LIVE: palette.FELT, REFERENCE: palette.HEARD}


def cost(report: BenchReport) -> Figure:
    """Draw the CPU time for each scene as points, in one panel for each block size."""
    rows = [row for row in report.section("Cost of a second of sound").rows if row.unit == "ms"]
    scenes = list(dict.fromkeys(row.name.rsplit(", blocks of ", 1)[0] for row in rows))
    costs = [each for row in rows for each in (row.low, row.value, row.high) if each]
    machine = report.machine
    figure = sheet(
        "What a second of sound costs",
        "CPU time of one thread for 1 s of 48 kHz stereo, in ms: median, smallest and largest. "
        f"{machine.cpu}, one rfft(2048) {machine.rfft_us:.1f} µs",
        5.6,
    )
    legend(figure, 0.235, [("●", colour, name) for name, colour in COLOURS.items()]
           + [("- -", palette.INK, f"limit for {LIVE}: {SECOND_MS:g} ms")])  # fmt: skip
    axes = figure.subplots(1, len(BLOCKSIZES), sharey=True, sharex=True)
    figure.subplots_adjust(left=0.235, right=0.975, top=0.80, bottom=0.09, wspace=0.06)
    for axis, blocksize in zip(axes, BLOCKSIZES, strict=True):
        frame(axis, f"blocks of {blocksize} frames")
        limit(axis, SECOND_MS)
        for row in rows:
            scene, _, size = row.name.rpartition(", blocks of ")
            if size != str(blocksize) or not row.value:
                continue
            line = scenes.index(scene) + 0.26 * (list(COLOURS).index(row.column) - 0.5)
            low, high = row.low or row.value, row.high or row.value
            axis.plot([low, high], [line, line], color=COLOURS[row.column], lw=2.0, zorder=2)
            axis.plot([row.value], [line], "o", ms=5.5, color=COLOURS[row.column], zorder=3)
            left = high < SECOND_MS < BESIDE_LIMIT * high
            number_beside(axis, f"{row.value:.1f}", (low if left else high, line), left=left)
        axis.set_yticks(range(len(scenes)), scenes, fontsize=TEXT_PT, color=palette.INK)
        axis.set_ylim(len(scenes) - 0.45, -0.55)
        axis.set_xscale("log")
        axis.set_xlim(0.45 * min(costs), 2.2 * max(costs))
        ticks_at(axis, TICKS_MS, min(costs), 2.2 * max(costs))
        axis.tick_params(which="minor", length=0)
        axis.tick_params(axis="y", length=0)
    frame(axes[-1], unit="ms")
    axes[-1].tick_params(axis="y", length=0)
    return figure


def lag(report: BenchReport) -> Figure:
    """Draw the share of bursts whose vibration has reached half its level, by time since onset."""
    series = report.section("Onset lag").series
    figure = sheet(
        "How soon the vibration follows a sound",
        f"Share of {len(next(iter(series.values())))} tone bursts, 80 to 5000 Hz, whose vibration "
        "has passed half of its level, by the time since the sound began",
        4.4,
    )
    axis = figure.subplots()
    figure.subplots_adjust(left=0.075, right=0.975, top=0.84, bottom=0.125)
    frame(axis, grid=True, unit="ms")
    latest = 0.0
    for name, lags_ms in series.items():
        lags = np.sort(np.array(lags_ms))
        latest = max(latest, float(lags[-1]))
        share = 100.0 * np.arange(1, lags.size + 1) / lags.size
        colour, p95 = COLOURS[name], float(np.percentile(lags, 95))
        axis.step([lags[0], *lags], [0.0, *share], where="post", color=colour, lw=2.2)
        axis.plot([p95], [95.0], "o", ms=7, color=colour, mec=palette.WHITE, mew=1.2, zorder=5)
        axis.annotate(
            f"{name}\n95 % by {p95:.1f} ms", (float(np.percentile(lags, 60)), 60.0),
            xytext=(16, -16), textcoords="offset points", fontsize=TEXT_PT, color=colour,
        )  # fmt: skip
    limit(axis, LAG_P95.bound)
    axis.text(LAG_P95.bound + 0.4, 3.0, f"limit: 95 % by {LAG_P95.bound:g} ms", fontsize=SMALL_PT)
    axis.set_xlim(0.0, 5.0 * np.ceil((latest + 3.0) / 5.0))
    axis.set_ylim(0.0, 102.0)
    axis.set_yticks([0, 25, 50, 75, 95, 100], ["0", "25", "50", "75", "95", "100 %"])
    return figure
