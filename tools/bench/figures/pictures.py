"""Pictures of a report, `PICTURES`, and how a page shows them.

Three are drawn here, the others in the modules *_figure.
Needs matplotlib, an optional extra, and uses only its objects: no pyplot, no global setting.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from os.path import relpath
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

import numpy as np

from device.atomic_file import write_bytes_atomically
from device.errors import UsageError
from tools.bench.figures.baselines import comparison_figure
from tools.bench.figures.damping import damping_figure
from tools.bench.figures.frequency import frequency_figure
from tools.bench.figures.frontier import frontier_figure
from tools.bench.figures.levels import levels_figure
from tools.bench.figures.speech import speech_figure
from tools.bench.report import BenchReport, Row
from tools.bench.sections.baselines import TITLE as COMPARISON_TITLE
from tools.bench.sections.damping import TITLE as DAMPING_TITLE
from tools.bench.sections.fidelity import LAG_P95
from tools.bench.sections.frequency_error import TITLE as FREQUENCY_TITLE
from tools.bench.sections.frontier import TITLE as FRONTIER_TITLE
from tools.bench.sections.levels import TITLE as LEVELS_TITLE
from tools.bench.sections.rig_precision import TITLE as RUNGS_TITLE
from tools.bench.sections.speech_suppression import EFFECTS_TITLE as SPEECH_TITLE
from tools.bench.sections.speed import BLOCKSIZES, SECOND, SECOND_FFTS
from tools.bench.workbench import LIVE, REFERENCE, TWIN

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COST_TITLE, LAG_TITLE = "Cost of a second of sound", "Onset lag"
DPI = 150
COLOURS = 48
WIDTH_IN = 10.0
COST_HEIGHT_IN, LAG_HEIGHT_IN = 5.6, 4.4
LINE = 0.26
CURVE_MARKERS, POINT_MARKERS = "osD^v<", "*PXp"
"""What tells curves, and single points, from each other where their tones are close."""
COST_TICKS_MS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
BESIDE_LIMIT = 3.5
"""By so much over a cost its number ends, on the axis of costs."""
TEXT_PT, TITLE_PT, SMALL_PT = 10.0, 14.0, 9.0


@dataclass(frozen=True)
class Picture:
    """One picture of a report: what is in it, in which section it is shown, and how it is drawn.

    by_series: whether it shows single measurements, not rows.
    """

    name: str
    says: str
    section: str
    draw: Callable[[BenchReport], Figure]
    by_series: bool = False

    @property
    def file_name(self) -> str:
        """Its file's name."""
        return f"{self.name}.png"

    def can_be_drawn(self, report: BenchReport) -> bool:
        """Return whether what it shows was measured."""
        shown = [section for section in report.sections if section.title == self.section]
        return any(bool(each.series if self.by_series else each.rows) for each in shown)


def draw_all(report: BenchReport, folder: Path) -> list[Path]:
    """Write every picture into the folder and return the paths; see `bench.plots`."""
    need_matplotlib()
    paths = []
    for picture in PICTURES:
        if picture.can_be_drawn(report):
            paths.append(folder / picture.file_name)
            write_bytes_atomically(paths[-1], _small_png(picture.draw(report)))
    return paths


def _small_png(figure: Figure) -> bytes:
    """Return the figure as a PNG of few colours: what smooths an edge needs no more."""
    from PIL import Image

    drawn, small = io.BytesIO(), io.BytesIO()
    figure.savefig(drawn, format="png", dpi=DPI)
    picture = Image.open(drawn).convert("RGB")
    indexed = picture.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    indexed.save(small, format="PNG", optimize=True, dpi=(DPI, DPI))
    return small.getvalue()


def need_matplotlib() -> None:
    """Raise UsageError where matplotlib is not installed: better told before all is measured."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError:
        raise UsageError(
            "matplotlib is not installed, so no plots can be drawn; "
            "install it: .venv/bin/python -m pip install matplotlib"
        ) from None


def shown_in(page: Path, drawn: Sequence[Path]) -> dict[str, str]:
    """Return what shows each of these pictures in a page, as Markdown, by its section's title.

    drawn: from `draw_all`. Pictures that do not lie under the page's folder are not shown in it:
    whoever moves the page with its folder takes them along.
    """
    home = page.parent.resolve()
    files = {path.name: path.resolve() for path in drawn if path.resolve().is_relative_to(home)}
    return {
        picture.section: f"![{picture.says}]({quote(Path(relpath(file, home)).as_posix())})"
        for picture in PICTURES
        if (file := files.get(picture.file_name))
    }


def cost_figure(report: BenchReport) -> Figure:
    """The cost of each scene as points, one for each way: small blocks left, large blocks right."""
    from matplotlib.figure import Figure

    from audioflinger_hook.figures import palette

    ways = (
        (LIVE, palette.FELT, 0.235),
        (TWIN, palette.FELT_LIGHT, 0.31),
        (REFERENCE, palette.HEARD, 0.46),
    )

    rows = [row for row in report.section(COST_TITLE).rows if row.unit == "ms"]
    by_place = {(row.name, row.column): row for row in rows}
    scenes = list(dict.fromkeys(row.name.rsplit(", blocks of ", 1)[0] for row in rows))
    costs = [cost for row in rows for cost in (row.low, row.value, row.high) if cost]
    figure = Figure(figsize=(WIDTH_IN, COST_HEIGHT_IN), facecolor=palette.WHITE)
    _headline(
        figure,
        "What a second of sound costs",
        f"CPU time of one thread for 1 s of 48 kHz stereo, in ms: median, smallest and largest. "
        f"{report.machine.cpu}, one rfft(2048) {report.machine.rfft_us:.1f} µs",
    )
    axes = figure.subplots(1, len(BLOCKSIZES), sharey=True, sharex=True)
    figure.subplots_adjust(left=0.235, right=0.975, top=0.76, bottom=0.09, wspace=0.06)
    for axis, blocksize in zip(axes, BLOCKSIZES, strict=True):
        _plain(axis)
        axis.set_title(f"blocks of {blocksize} frames", fontsize=TEXT_PT, color=palette.INK)
        axis.axvline(SECOND.bound, color=palette.INK, lw=0.9, ls=(0, (4, 3)), zorder=1)
        for side, (column, colour, _) in enumerate(ways):
            for line, scene in enumerate(scenes):
                row = by_place.get((f"{scene}, blocks of {blocksize}", column))
                if row:
                    _point(axis, line + (side - 1) * LINE, row, colour)
        axis.set_yticks(range(len(scenes)), scenes, fontsize=TEXT_PT, color=palette.INK)
        axis.set_ylim(len(scenes) - 0.45, -0.55)
        axis.set_xscale("log")
        axis.set_xlim(0.45 * min(costs), 2.2 * max(costs))
        ticks = [tick for tick in COST_TICKS_MS if min(costs) <= tick <= 2.2 * max(costs)]
        axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axis.tick_params(axis="x", which="minor", length=0)
        axis.tick_params(axis="y", length=0)
    axes[-1].set_xlabel("ms", fontsize=TEXT_PT, color=palette.GREY, loc="right", labelpad=2)
    x = 0.62
    figure.text(x, 0.835, "- -", color=palette.INK, fontsize=TEXT_PT + 2, va="center")
    limit = f"limit for {LIVE}: {SECOND.bound:g} ms, {SECOND_FFTS.bound:g} rfft"
    figure.text(x + 0.027, 0.835, limit, color=palette.INK, fontsize=TEXT_PT, va="center")
    for column, colour, x in ways:
        figure.text(x, 0.835, "●", color=colour, fontsize=TEXT_PT + 2, va="center")
        figure.text(x + 0.019, 0.835, column, color=palette.INK, fontsize=TEXT_PT, va="center")
    return figure


def lag_figure(report: BenchReport) -> Figure:
    """The share of bursts that are felt by a time, for both forms, with the limit."""
    from matplotlib.figure import Figure

    from audioflinger_hook.figures import palette

    section = report.section(LAG_TITLE)
    figure = Figure(figsize=(WIDTH_IN, LAG_HEIGHT_IN), facecolor=palette.WHITE)
    count = len(next(iter(section.series.values())))
    _headline(
        figure,
        "How soon a sound is felt",
        f"Share of {count} tone bursts, 80 to 5000 Hz, whose vibration has passed half of its "
        "level, by the time since the sound began",
    )
    axis = figure.subplots()
    figure.subplots_adjust(left=0.075, right=0.975, top=0.80, bottom=0.125)
    _plain(axis)
    latest = 0.0
    for (column, lags_ms), colour in zip(
        section.series.items(), (palette.FELT, palette.HEARD), strict=False
    ):
        lags = np.sort(np.array(lags_ms))
        latest = max(latest, float(lags[-1]))
        share = 100.0 * np.arange(1, lags.size + 1) / lags.size
        # A step for each burst, from nobody to everybody.
        axis.step([lags[0], *lags], [0.0, *share], where="post", color=colour, lw=2.2, label=column)
        p95 = float(np.percentile(lags, 95))
        axis.plot([p95], [95.0], "o", ms=7, color=colour, mec=palette.WHITE, mew=1.2, zorder=5)
        _label_curve(axis, column, lags, p95, colour)
    axis.axvline(LAG_P95.bound, color=palette.INK, lw=0.9, ls=(0, (4, 3)), zorder=1)
    axis.text(
        LAG_P95.bound + 0.4, 3.0, f"limit: 95 % by {LAG_P95.bound:g} ms", fontsize=SMALL_PT,
        color=palette.INK,
    )  # fmt: skip
    axis.set_xlim(0.0, 5.0 * np.ceil((latest + 3.0) / 5.0))
    axis.set_ylim(0.0, 102.0)
    axis.set_yticks([0, 25, 50, 75, 95, 100], ["0", "25", "50", "75", "95", "100 %"])
    axis.set_xlabel("ms", fontsize=TEXT_PT, color=palette.GREY, loc="right", labelpad=2)
    axis.grid(True, axis="y", color=palette.HAIRLINE, lw=0.8)
    return figure


def rungs_figure(report: BenchReport) -> Figure:
    """The error of the rig's rungs and of SciPy's integrators over their cost."""
    from matplotlib.figure import Figure

    from audioflinger_hook.figures import palette

    section = report.section(RUNGS_TITLE)
    figure = Figure(figsize=(WIDTH_IN, LAG_HEIGHT_IN), facecolor=palette.WHITE)
    _headline(
        figure,
        "What an error of the simulated motion costs",
        "The non-linear equations, driven to nine tenths of Xmax: largest error of the "
        "displacement over its peak, by CPU time for a second of signal",
    )
    axis = figure.subplots()
    figure.subplots_adjust(left=0.085, right=0.725, top=0.80, bottom=0.125)
    _plain(axis)
    axis.set_xscale("log")
    axis.set_yscale("log")
    points = -1
    for place, (name, values) in enumerate(section.series.items()):
        costs_ms, errors = 1e3 * np.array(values[::2]), np.array(values[1::2])
        single = len(costs_ms) == 1
        if single:
            points += 1
            marker = POINT_MARKERS[points % len(POINT_MARKERS)]
            colour = palette.FELT if name.endswith("rung") else palette.INK
        else:
            marker = CURVE_MARKERS[place % len(CURVE_MARKERS)]
            tones = (palette.INK, palette.HEARD, palette.GREY, palette.HEARD_LIGHT)
            colour = tones[(place - 1) % len(tones)] if place else palette.FELT
        axis.plot(
            costs_ms, errors, marker=marker, ls="none" if single else "-", ms=7 if single else 5.5,
            lw=2.2 if place == 0 else 1.2, color=colour, label=name, zorder=3 if place else 4,
        )  # fmt: skip
    # Curves cross and end close together: names stand beside all of them.
    axis.legend(
        loc="center left", bbox_to_anchor=(1.02, 0.5), frameon=False, fontsize=SMALL_PT,
        labelcolor=palette.INK, labelspacing=0.9, handlelength=2.2,
    )  # fmt: skip
    axis.tick_params(which="minor", length=0)
    axis.set_xlabel("CPU time, ms", fontsize=TEXT_PT, color=palette.GREY, loc="right", labelpad=2)
    axis.set_title("error over peak", loc="left", fontsize=SMALL_PT, color=palette.GREY, x=-0.06)
    axis.grid(True, axis="y", color=palette.HAIRLINE, lw=0.8)
    return figure


def _label_curve(axis: Axes, column: str, lags: np.ndarray, p95: float, colour: str) -> None:
    """Write whose curve it is, with its 95th percentile, in the free space beside it."""
    left = column == LIVE
    share = 60.0 if left else 80.0
    axis.annotate(
        f"{column}\n95 % by {p95:.1f} ms",
        (float(np.percentile(lags, share)), share),
        xytext=(-14, 14) if left else (14, -22),
        textcoords="offset points",
        ha="right" if left else "left",
        va="center",
        fontsize=TEXT_PT,
        linespacing=1.35,
        color=colour,
    )


def _point(axis: Axes, place: float, row: Row, colour: str) -> None:
    """Draw one cost with its spread and its number."""
    from audioflinger_hook.figures import palette

    value = row.value or 0.0
    low, high = row.low or value, row.high or value
    # To the right of a point just under the limit its number would stand on the limit's line.
    left = high < SECOND.bound < BESIDE_LIMIT * high
    axis.plot([low, high], [place, place], color=colour, lw=2.0, zorder=2)
    axis.plot([value], [place], "o", ms=5.5, color=colour, zorder=3)
    axis.annotate(
        f"{value:.1f}", (low if left else high, place), xytext=(-6 if left else 6, 0),
        textcoords="offset points", ha="right" if left else "left",
        fontsize=SMALL_PT - 0.5, color=palette.GREY, va="center_baseline", zorder=4,
        bbox={"facecolor": palette.WHITE, "edgecolor": "none", "pad": 0.4},
    )  # fmt: skip


def _headline(figure: Figure, title: str, explanation: str) -> None:
    from audioflinger_hook.figures import palette

    figure.text(0.02, 0.945, title, fontsize=TITLE_PT, color=palette.INK, va="center")
    figure.text(0.02, 0.890, explanation, fontsize=SMALL_PT, color=palette.GREY, va="center")


def _plain(axis: Axes) -> None:
    """Leave of the frame only what carries the scale."""
    from audioflinger_hook.figures import palette

    for side in ("top", "right", "left"):
        axis.spines[side].set_visible(False)
    axis.spines["bottom"].set_color(palette.HAIRLINE)
    axis.tick_params(labelsize=SMALL_PT, colors=palette.GREY, length=3, color=palette.HAIRLINE)


PICTURES = (
    Picture("cost", "CPU time of a second of each scene", COST_TITLE, cost_figure),
    Picture("lag", "Share of bursts felt by a time", LAG_TITLE, lag_figure, by_series=True),
    Picture("frequency", "Frequency error over the ratio of signal to noise, against the bound",
            FREQUENCY_TITLE, frequency_figure, by_series=True),
    Picture("frontier", "Four errors over cost, by setting", FRONTIER_TITLE, frontier_figure),
    Picture("comparators", "Cost, lag and likeness of each way from sound to vibration",
            COMPARISON_TITLE, comparison_figure),
    Picture("levels", "Levels of vibration by profile", LEVELS_TITLE, levels_figure),
    Picture("speech", "Vibration of speech with and without suppression", SPEECH_TITLE,
            speech_figure, by_series=True),
    Picture("rungs", "Error of the motion over cost", RUNGS_TITLE, rungs_figure, by_series=True),
    Picture("damping", "Residual vibration over the true f0", DAMPING_TITLE, damping_figure,
            by_series=True),
)  # fmt: skip
"""Every picture, in the order of the report."""
