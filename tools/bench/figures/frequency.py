"""The picture of frequency errors: each form and the Cramer-Rao bound, by signal to noise.

Needs matplotlib, an optional extra, and uses only its objects.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tools.bench.report import BenchReport
from tools.bench.sections.frequency_error import (
    BOUND,
    FORMS,
    LIMITED_SNRS_DB,
    RANGES_HZ,
    TIMES_BOUND,
    TITLE,
)
from tools.bench.sounds.signals import SAMPLERATE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH_IN, HEIGHT_IN = 10.0, 4.6
TEXT_PT, SMALL_PT, TITLE_PT = 10.0, 9.0, 14.0


def frequency_figure(report: BenchReport) -> Figure:
    """Errors in Hz over signal to noise, a field for each range, with the bound and the limit."""
    from matplotlib.figure import Figure

    from audioflinger_hook.figures import palette

    series = report.section(TITLE).series
    snr_db, bound = np.array(series["SNR"]), np.array(series[BOUND])
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), facecolor=palette.WHITE)
    figure.text(0.02, 0.945, "How far off a frequency is found", fontsize=TITLE_PT,
                color=palette.INK, va="center")  # fmt: skip
    figure.text(
        0.02, 0.885, f"Root mean square error in Hz of one tone in white noise at {SAMPLERATE} Hz, "
        "over the ratio of signal to noise, against the Cramer-Rao bound", fontsize=SMALL_PT,
        color=palette.GREY, va="center",
    )  # fmt: skip
    axes = figure.subplots(1, len(RANGES_HZ), sharex=True, sharey=True)
    figure.subplots_adjust(left=0.07, right=0.885, top=0.78, bottom=0.125, wspace=0.08)
    colours = dict(zip(FORMS, (palette.FELT, palette.HEARD), strict=True))
    for axis, (low_hz, high_hz) in zip(axes, RANGES_HZ, strict=True):
        span = f"{low_hz:g} to {high_hz:g} Hz"
        for side in ("top", "right", "left"):
            axis.spines[side].set_visible(False)
        axis.spines["bottom"].set_color(palette.HAIRLINE)
        axis.tick_params(labelsize=SMALL_PT, colors=palette.GREY, length=3, color=palette.HAIRLINE)
        axis.tick_params(which="minor", length=0)
        axis.grid(True, axis="y", color=palette.HAIRLINE, lw=0.8)
        axis.set_title(span, fontsize=TEXT_PT, color=palette.INK)
        axis.set_yscale("log")
        axis.plot(snr_db, bound, color=palette.INK, lw=1.2, ls=(0, (4, 3)))
        for form in FORMS:
            axis.plot(snr_db, series[f"{form}, {span}"], "o-", ms=4, lw=2.0, color=colours[form])
        if low_hz >= RANGES_HZ[1][0]:
            limited = snr_db <= LIMITED_SNRS_DB[-1]
            limit = TIMES_BOUND.bound * bound[limited]
            axis.plot(snr_db[limited], limit, color=palette.GREY, lw=4.0, alpha=0.35)
    ends = {form: series[f"{form}, {span}"][-1] for form in FORMS} | {BOUND: bound[-1]}
    for name, end in ends.items():
        axes[-1].annotate(
            name, (snr_db[-1], end), xytext=(8, 0), textcoords="offset points", va="center",
            fontsize=SMALL_PT, color=colours.get(name, palette.INK), annotation_clip=False,
        )  # fmt: skip
    axes[1].text(
        0.03, 0.05, f"grey: {TIMES_BOUND.bound:g} times the bound,\nthe limit asked",
        fontsize=SMALL_PT, color=palette.GREY, transform=axes[1].transAxes, va="bottom",
    )  # fmt: skip
    axes[-1].set_xlabel("dB", fontsize=TEXT_PT, color=palette.GREY, loc="right", labelpad=2)
    axes[0].set_ylabel("Hz", rotation=0, fontsize=TEXT_PT, color=palette.GREY, loc="top")
    return figure
