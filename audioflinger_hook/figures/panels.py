"""Functions that draw parts of the report into a matplotlib Axes. Sizes are in points (pt)."""

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

DOT_GRID = (460, 150)  # columns and rows; only the strongest dot in each cell is drawn
LARGEST_DOT_PT = 5.0  # diameter at strength 1


def style_axes(axes: Axes) -> None:
    """Set the style of spines and ticks that all panels share."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(HAIRLINE)
    axes.tick_params(
        which="both", color=HAIRLINE, labelcolor=GREY, labelsize=TICK_PT, labelfontfamily=FONT,
        length=3.5, width=0.8,
    )  # fmt: skip
    axes.set_axisbelow(True)


def draw_heading(axes: Axes, name: str, explanation: str, right: str = "") -> None:
    """Write `name` and a grey `explanation` above the panel, and `right` above its right end."""
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
    """Set limits, ticks and label of the time axis in seconds."""
    axes.set_xlim(0.0, duration_s)
    axes.xaxis.set_major_locator(MaxNLocator(nbins=16, steps=[1, 2, 2.5, 5, 10]))
    axes.set_xlabel("time (s)", fontsize=LABEL_PT, fontfamily=FONT, color=INK)


def label_values(axes: Axes, label: str) -> None:
    """Label the vertical axis; `label` contains the unit."""
    axes.set_ylabel(label, fontsize=LABEL_PT, fontfamily=FONT, color=INK)


def place_events(
    events: Sequence[Event], duration_s: float, width_pt: float
) -> list[tuple[int, float, Event]]:
    """Return (lane, time of the label's left end in s, event) for each event that has room.

    A lane is one of three rows for labelled bars. On an axis of `width_pt` points, labels do not
    overlap. An event is omitted if all lanes are occupied. Bars are clipped to the time axis.
    """
    lanes_end_s = [-np.inf] * MAX_EVENT_LANES
    placed = []
    for start_s, end_s, label in sorted(events):
        start_s, end_s = max(start_s, 0.0), min(end_s, duration_s)
        # The assumed mean width of a letter is 0.62 em. The gap between labels is two letters.
        label_s = 0.62 * LABEL_PT * (len(label) + 2) / width_pt * duration_s
        text_s = max(0.0, min(start_s, duration_s - label_s))
        free = [lane for lane, taken_s in enumerate(lanes_end_s) if taken_s <= text_s]
        if end_s > start_s and free:
            lanes_end_s[free[0]] = max(end_s, text_s + label_s)
            placed.append((free[0], text_s, (start_s, end_s, label)))
    return placed


def draw_events(axes: Axes, placed: Sequence[tuple[int, float, Event]], lanes: int) -> None:
    """Draw events from `place_events` as bars with labels above; lane 0 is the lowest."""
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
    """Fill the area between `lowest` and `highest` on a symmetric axis of at least +-`at_least`."""
    axes.axhline(0.0, color=HAIRLINE, linewidth=0.8, zorder=0.5)
    axes.fill_between(times_s, lowest, highest, color=colour, linewidth=0.6)
    limit = max(at_least, 1.06 * float(np.max(np.abs([lowest, highest]))))
    axes.set_ylim(-limit, limit)
    axes.yaxis.set_major_locator(MaxNLocator(nbins=4, symmetric=True, steps=[1, 2, 5, 10]))
    axes.grid(axis="x", color=HAIRLINE, linewidth=0.6, alpha=0.7)


def draw_spectrogram(
    axes: Axes, level_db: NDArray[np.float64], duration_s: float, *, range_db: float
) -> AxesImage:
    """Draw `level_db` (rows, columns) and return the image for a colour bar.

    Rows have equal heights, so their frequencies must be equally spaced on the axis. The
    colours end at the highest level, rounded up to a multiple of 5 dB, and span `range_db`.
    """
    loudest_db = float(np.max(level_db))
    top_db = 5.0 * np.ceil(loudest_db / 5.0) if loudest_db > -150.0 else 0.0
    # In data coordinates a logarithmic axis would distort the image, so use axes coordinates.
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
    """Make the vertical axis logarithmic in Hz, with ticks at 1, 2 and 5 of each decade."""
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
    """Draw principal frequencies as dots, whose area grows with the strength (0 to 1)."""
    order = np.argsort(-strengths, kind="stable")
    places = axes.transData.transform(np.column_stack([times_s, frequencies_hz])[order])
    cells = np.floor(axes.transAxes.inverted().transform(places) * DOT_GRID)
    _, strongest = np.unique(cells, axis=0, return_index=True)
    chosen = order[strongest]
    strength = np.clip(strengths[chosen], 0.0, 1.0)
    # The area and the opacity are never 0, so that weak principal frequencies are visible.
    colours = np.tile(to_rgba(FELT), (strength.size, 1))
    colours[:, 3] = 0.5 + 0.5 * np.sqrt(strength)
    area = LARGEST_DOT_PT**2 * (0.04 + 0.96 * strength)
    axes.scatter(times_s[chosen], frequencies_hz[chosen], s=area, color=colours, linewidths=0.0)
