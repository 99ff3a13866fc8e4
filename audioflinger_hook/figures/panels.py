"""The parts of the report's panels, each drawn into an Axes that is given.

Sizes are in points (pt, 1/72 inch), times in seconds; nothing is computed here but places.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.image import AxesImage
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator
from numpy.typing import NDArray

from audioflinger_hook.figures.palette import FELT, GREY, HAIRLINE, HEARD, INK, level_map

Principal = tuple[float, float, float, float]
Event = tuple[float, float, str]

FONT = "DejaVu Sans"
HEADING_PT = 10.5
LABEL_PT = 9.5
TICK_PT = 9.0

MAX_EVENT_LANES = 3

# Dots in one cell of this grid would hide one another: only the strongest is drawn.
DOT_GRID = (460, 150)
LARGEST_DOT_PT = 5.0  # the diameter at strength 1


def style_axes(axes: Axes) -> None:
    """Gives `axes` the frame that all panels share: quiet spines and ticks."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(HAIRLINE)
    axes.tick_params(
        which="both", color=HAIRLINE, labelcolor=GREY, labelsize=TICK_PT, labelfontfamily=FONT,
        length=3.5, width=0.8,
    )  # fmt: skip
    axes.set_axisbelow(True)


def draw_heading(axes: Axes, name: str, explanation: str, right: str = "") -> None:
    """Writes `name` and a grey `explanation` above the panel, and `right` at its right end."""
    title = axes.annotate(
        name, (0.0, 1.0), (0.0, 7.0), xycoords="axes fraction", textcoords="offset points",
        fontsize=HEADING_PT, fontfamily=FONT, fontweight="bold", color=INK, va="baseline",
    )  # fmt: skip
    axes.annotate(
        explanation, (1.0, 0.0), (8.0, 0.0), xycoords=title, textcoords="offset points",
        fontsize=LABEL_PT, fontfamily=FONT, color=GREY, va="bottom",
    )  # fmt: skip
    if right:
        axes.annotate(
            right, (1.0, 1.0), (0.0, 7.0), xycoords="axes fraction", textcoords="offset points",
            fontsize=LABEL_PT, fontfamily=FONT, color=INK, ha="right", va="baseline",
        )  # fmt: skip


def label_time_axis(axes: Axes, duration_s: float) -> None:
    """Limits, ticks and a label in seconds."""
    axes.set_xlim(0.0, duration_s)
    axes.xaxis.set_major_locator(MaxNLocator(nbins=16, steps=[1, 2, 2.5, 5, 10]))
    axes.set_xlabel("time (s)", fontsize=LABEL_PT, fontfamily=FONT, color=INK)


def label_values(axes: Axes, label: str) -> None:
    """Names the vertical axis; `label` holds the unit."""
    axes.set_ylabel(label, fontsize=LABEL_PT, fontfamily=FONT, color=INK)


def place_events(
    events: Sequence[Event], duration_s: float, width_pt: float
) -> list[tuple[int, float, Event]]:
    """(lane, time of the label's left end in s, event) for each event that finds a free lane.

    The axis is `width_pt` points wide. A label longer than its bar takes that room too, so no two
    labels meet. With all three lanes taken an event is left out. Bars are cut to the time axis.
    """
    lanes_end_s = [-np.inf] * MAX_EVENT_LANES
    placed = []
    for start_s, end_s, label in sorted(events):
        start_s, end_s = max(start_s, 0.0), min(end_s, duration_s)
        # 0.62 em is a generous mean width of a letter, and two letters are the gap to the next.
        label_s = 0.62 * LABEL_PT * (len(label) + 2) / width_pt * duration_s
        text_s = max(0.0, min(start_s, duration_s - label_s))
        free = [lane for lane, taken_s in enumerate(lanes_end_s) if taken_s <= text_s]
        if end_s > start_s and free:
            lanes_end_s[free[0]] = max(end_s, text_s + label_s)
            placed.append((free[0], text_s, (start_s, end_s, label)))
    return placed


def draw_events(axes: Axes, placed: Sequence[tuple[int, float, Event]], lanes: int) -> None:
    """Draws what `place_events` gives as bars under their labels; the first lane is the lowest."""
    axes.set_axis_off()
    axes.set_ylim(0.0, lanes)
    for lane, text_s, (start_s, end_s, label) in placed:
        axes.plot(
            [start_s, end_s], [lane + 0.1] * 2, color=HEARD, linewidth=2.4, solid_capstyle="butt"
        )
        axes.annotate(
            label, (text_s, lane + 0.1), (0.0, 4.0), textcoords="offset points", fontsize=LABEL_PT,
            fontfamily=FONT, color=INK, va="bottom", parse_math=False,
        )  # fmt: skip


def draw_waveform(
    axes: Axes,
    times_s: NDArray[np.float64],
    lowest: NDArray[np.floating],
    highest: NDArray[np.floating],
    colour: str,
    *,
    at_least: float,
) -> None:
    """Fills between `lowest` and `highest` of each column, on an axis symmetrical about zero.

    The axis reaches at least to `at_least`, so that silence is a line and not a magnified nothing.
    """
    axes.axhline(0.0, color=HAIRLINE, linewidth=0.8, zorder=0.5)
    axes.fill_between(times_s, lowest, highest, color=colour, linewidth=0.6)
    limit = max(at_least, 1.06 * float(np.max(np.abs([lowest, highest]))))
    axes.set_ylim(-limit, limit)
    axes.yaxis.set_major_locator(MaxNLocator(nbins=4, symmetric=True, steps=[1, 2, 5, 10]))
    axes.grid(axis="x", color=HAIRLINE, linewidth=0.6, alpha=0.7)


def draw_spectrogram(
    axes: Axes, level_db: NDArray[np.float64], duration_s: float, *, range_db: float
) -> AxesImage:
    """Draws `level_db` (rows, columns) and returns the image, for its colour bar.

    The rows fill the panel from bottom to top at even distances, so they must be spaced as the
    axis is scaled; set its limits before. The colours span `range_db` below the loudest place,
    rounded up to 5 dB.
    """
    loudest_db = float(np.max(level_db))
    top_db = 5.0 * np.ceil(loudest_db / 5.0) if loudest_db > -150.0 else 0.0
    # Placed by the height of the panel: on a logarithmic axis matplotlib would bend the rows.
    return axes.imshow(
        level_db.astype(np.float32),
        cmap=level_map(),
        vmin=top_db - range_db,
        vmax=top_db,
        extent=(0.0, duration_s, 0.0, 1.0),
        transform=axes.get_xaxis_transform(),
        origin="lower",
        aspect="auto",
        interpolation="bilinear",
        zorder=0.5,
    )


def use_audio_frequency_axis(axes: Axes, limits_hz: tuple[float, float]) -> None:
    """Makes the vertical axis logarithmic in Hz, with ticks at 1, 2 and 5 of each decade."""
    axes.set_yscale("log")
    axes.set_ylim(*limits_hz)
    decades = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0]
    ticks = [100.0 * tick for tick in [0.5, *decades] if limits_hz[0] <= 100 * tick <= limits_hz[1]]
    axes.yaxis.set_major_locator(FixedLocator(ticks))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(
        FuncFormatter(lambda hz, _: f"{hz / 1000:g}k" if hz >= 1000.0 else f"{hz:g}")
    )


def draw_principals(
    axes: Axes,
    times_s: NDArray[np.float64],
    frequencies_hz: NDArray[np.float64],
    strengths: NDArray[np.float64],
) -> None:
    """Marks principal frequencies as dots whose area grows with strength (0 to 1).

    Of dots that would hide one another only the strongest is drawn.
    """
    order = np.argsort(-strengths, kind="stable")
    places = axes.transData.transform(np.column_stack([times_s, frequencies_hz])[order])
    cells = np.floor(axes.transAxes.inverted().transform(places) * DOT_GRID)
    _, strongest = np.unique(cells, axis=0, return_index=True)
    chosen = order[strongest]
    strength = np.clip(strengths[chosen], 0.0, 1.0)
    # Floors of area and opacity: the weakest principal frequency is one all the same.
    colours = np.tile(to_rgba(FELT), (strength.size, 1))
    colours[:, 3] = 0.5 + 0.5 * np.sqrt(strength)
    area = LARGEST_DOT_PT**2 * (0.04 + 0.96 * strength)
    axes.scatter(times_s[chosen], frequencies_hz[chosen], s=area, color=colours, linewidths=0.0)
