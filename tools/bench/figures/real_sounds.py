"""The picture of real sounds: felt over heard by profile, a drum, a swell and a steady chord."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from audioflinger_hook.config.profiles import PROFILES
from audioflinger_hook.figures import palette
from tools.bench.figures.sheet import SMALL_PT, frame, legend, sheet
from tools.bench.report import BenchReport
from tools.bench.sections.felt_levels import END_S, FELT, HEARD, KIND, LAW, SWELL, WITHIN_DB
from tools.bench.sections.felt_times import CHORD, CHORD_STEP_S, DRUM, DRUM_BEFORE_S
from tools.bench.sounds.real_sounds import KINDS

CLASSES = {"explosions": palette.FELT, "speech": palette.HEARD}
OTHERS = "#b9c0c7"
COLOURS = {
    "paper": palette.GREY, "cinema": palette.FELT, "game": palette.FELT_LIGHT, "music": palette.INK,
}  # fmt: skip
HEIGHT_IN = 8.2

Series = Mapping[str, tuple[float, ...]]


def real_sounds(report: BenchReport) -> Figure:
    """Draw a scatter for every profile above; drum, swell and chord of all profiles below."""
    series = report.section("On real sounds").series
    names = [name for name in PROFILES if f"{FELT}{name}" in series]
    figure = sheet(
        "What is felt of real sounds",
        f"Each dot is one of {len(series[HEARD])} sounds of a programme. Grey: the law of the "
        f"profile, ±{WITHIN_DB:g} dB",
        HEIGHT_IN,
    )
    entries = [("●", colour, name) for name, colour in CLASSES.items()]
    legend(figure, 0.06, [*entries, ("●", OTHERS, "the other six classes")])
    above = figure.add_gridspec(
        1, len(names), left=0.06, right=0.985, top=0.86, bottom=0.545, wspace=0.12
    )
    first: Axes | None = None
    for place, name in enumerate(names):
        axis = figure.add_subplot(above[0, place], sharey=first, sharex=first)
        _scatter(axis, series, name)
        if first is None:
            first = axis
            axis.set_ylabel("felt, dB over the median", fontsize=SMALL_PT, color=palette.GREY)
        else:
            axis.tick_params(labelleft=False)
    below = figure.add_gridspec(1, 3, left=0.07, right=0.985, top=0.43, bottom=0.065, wspace=0.24)
    _drum(figure.add_subplot(below[0, 0]), series, names)
    _swell(figure.add_subplot(below[0, 1]), series, names)
    _chord(figure.add_subplot(below[0, 2]), series, names)
    return figure


def _scatter(axis: Axes, series: Series, name: str) -> None:
    heard, felt = np.array(series[HEARD]), np.array(series[f"{FELT}{name}"])
    kinds = np.array(series[KIND])
    felt = felt - np.median(felt)
    (law,) = series[f"{LAW}{name}"]
    # The law fixes differences only: it goes through the middle of all dots.
    middle = float(np.median(felt - law * heard))
    ends = np.array([60.0, 105.0])
    axis.fill_between(
        ends, law * ends + middle - WITHIN_DB, law * ends + middle + WITHIN_DB,
        color=palette.HAIRLINE, lw=0, zorder=1,
    )  # fmt: skip
    special = [KINDS.index(kind) for kind in CLASSES]
    rest = ~np.isin(kinds, special)
    axis.plot(heard[rest], felt[rest], "o", ms=3.5, color=OTHERS, mec="white", mew=0.3, zorder=2)
    for kind, colour in CLASSES.items():
        mine = kinds == KINDS.index(kind)
        axis.plot(
            heard[mine], felt[mine], "o", ms=4.5, color=colour, mec="white", mew=0.4, zorder=3
        )
    frame(axis, f"{name}: {law:.3g} dB a phon", grid=True, unit="heard, phon")
    axis.set_xlim(*ends)
    axis.set_ylim(-26.0, 18.0)


def _drum(axis: Axes, series: Series, names: list[str]) -> None:
    """Draw a drum's envelopes, each as a share of its own peak."""
    shown = {"sound": palette.HEARD} | {name: COLOURS.get(name, OTHERS) for name in names}
    for line, (name, colour) in enumerate(shown.items()):
        level = np.array(series[f"{DRUM}{name}"])
        time_ms = np.arange(level.size) - 1e3 * DRUM_BEFORE_S
        share = 0.85 * level / max(float(level.max()), 1e-9)
        axis.fill_between(time_ms, -line, share - line, color=palette.HAIRLINE, lw=0)
        axis.plot(time_ms, share - line, color=colour, lw=1.4)
        half = time_ms[int((share >= 0.5 * share.max()).argmax())]
        axis.plot([half], [0.425 - line], "o", ms=4.5, color=colour, mec="white", mew=0.6)
    frame(axis, "a drum; dots: half of the peak", unit="ms")
    axis.set_yticks([0.25 - line for line in range(len(shown))], list(shown))
    axis.tick_params(axis="y", length=0, labelcolor=palette.INK)
    axis.axvline(0.0, color=palette.HAIRLINE, lw=0.8, zorder=0)


def _swell(axis: Axes, series: Series, names: list[str]) -> None:
    """Draw loudness and felt strength of a swell, each against its own lowest point."""
    shown = {"heard, phon": ("sound", palette.HEARD)}
    shown |= {f"{name}, dB": (name, COLOURS.get(name, OTHERS)) for name in names}
    for label, (name, colour) in shown.items():
        level = np.array(series[f"{SWELL}{name}"])
        time_s = (np.arange(level.size) + 0.5) * END_S
        level = level - level[round(8.0 / END_S) - 1 : round(8.0 / END_S) + 1].mean()
        axis.plot(time_s, level, color=colour, lw=1.6, label=label)
    frame(axis, "a swell of 30 dB up and down", grid=True, unit="s")
    axis.set_xlim(0.0, 40.0)
    axis.legend(fontsize=SMALL_PT - 1.0, frameon=False, loc="upper left", handlelength=1.2)


def _chord(axis: Axes, series: Series, names: list[str]) -> None:
    """Draw the envelope of a steady chord's vibration over its mean."""
    for line, name in enumerate(names):
        level = np.array(series[f"{CHORD}{name}"])
        time_s = np.arange(level.size) * CHORD_STEP_S
        share = level / max(float(level.mean()), 1e-9)
        axis.plot([0.0, time_s[-1]], [1.0 - 2.0 * line] * 2, color=palette.HAIRLINE, lw=0.8)
        axis.plot(time_s, share - 2.0 * line, color=COLOURS.get(name, OTHERS), lw=1.2)
    frame(axis, "a steady A-major chord", unit="s")
    axis.set_yticks([1.0 - 2.0 * line for line in range(len(names))], names)
    axis.tick_params(axis="y", length=0, labelcolor=palette.INK)
