"""The report: one picture of what was heard, what was found in it, and what was felt.

In the manner of the paper's Figures 7 and 8, five panels on one time axis: the audio, its spectrum
with the principal frequencies, the vibration made of them, its spectrum, and the acceleration of
the cushion. Needs matplotlib (an optional extra) and uses only its objects: no pyplot, and no
setting that another figure in the same process would see.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import BinaryIO

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import findfont, get_font
from numpy.typing import NDArray

from audioflinger_hook.figures import palette, panels
from audioflinger_hook.figures.columns import (
    column_times_s,
    envelope,
    short_time_rms,
    spectrogram_db,
)
from audioflinger_hook.figures.panels import Event, Principal
from device import write_bytes_atomically

WIDTH_PX, HEIGHT_PX, DPI = 1600, 1500, 150
LEFT, RIGHT, TOP, BOTTOM = 0.072, 0.935, 0.922, 0.05

# One column of numbers for each pixel across the panels, and half as many for spectra: at 15 s that
# is still two for each window, and the file is a third smaller.
COLUMNS = round((RIGHT - LEFT) * WIDTH_PX)
SPECTRUM_COLUMNS = COLUMNS // 2

AUDIO_LIMITS_HZ = (50.0, 12_000.0)
AUDIO_ROWS = 200
AUDIO_WINDOW_S = 0.04643  # the window in which the principal frequencies are found
AUDIO_RANGE_DB = 60.0

VIBRATION_LIMITS_HZ = (0.0, 260.0)
VIBRATION_BAND_HZ = (20.0, 220.0)
VIBRATION_ROWS = 131
# Longer than the audio's: 46 ms cannot tell 40 Hz from 80 Hz, and nobody feels in 46 ms either.
VIBRATION_WINDOW_S = 0.16
VIBRATION_RANGE_DB = 50.0

RMS_WINDOW_S = 0.05
STANDARD_GRAVITY_M_S2 = 9.80665

Samples = NDArray[np.floating]


def draw_report(
    path: str | os.PathLike[str] | BinaryIO,
    *,
    title: str,
    samplerate: int,
    audio: Samples,
    vibration: Samples,
    vibration_samplerate: int,
    acceleration_m_s2: Samples,
    acceleration_samplerate: int,
    principals: Sequence[Principal],
    events: Sequence[Event],
    facts: Sequence[str] = (),
    description: str = "",
) -> None:
    """Writes the report as a PNG of 1600 x 1500 pixels to `path`, a file name or a binary file.

    `audio` has the shape (frames, channels), `vibration` and `acceleration_m_s2` (frames,). Each
    has its own samplerate in Hz, and all start at the same moment. Audio and vibration have full
    scale 1. `principals` are (time in s, audio frequency in Hz, vibration frequency in Hz, strength
    from 0 to 1); `events` are (start in s, end in s, label); `facts` are short texts for the line
    under the title; `description` is not drawn but stored as the PNG's text chunk of that name.
    Samples that are not finite are drawn as zero.

    A file name gets the whole picture or stays as it was. Raises ValueError for arrays of the wrong
    shape or without frames, and what `device.AtomicFile` raises if the file cannot be written.
    """
    audio = _checked("audio", audio, samplerate, dimensions=2)
    vibration = _checked("vibration", vibration, vibration_samplerate, dimensions=1)
    acceleration = _checked(
        "acceleration_m_s2", acceleration_m_s2, acceleration_samplerate, dimensions=1
    )
    duration_s = max(
        audio.shape[0] / samplerate,
        vibration.size / vibration_samplerate,
        acceleration.size / acceleration_samplerate,
    )

    width_pt = (RIGHT - LEFT) * WIDTH_PX * 72.0 / DPI
    named = [(start_s, end_s, _drawable(label)) for start_s, end_s, label in events]
    placed = panels.place_events(named, duration_s, width_pt)
    lanes = 1 + max((lane for lane, *_ in placed), default=0)

    figure = Figure(figsize=(WIDTH_PX / DPI, HEIGHT_PX / DPI), dpi=DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    grid = figure.add_gridspec(
        6, 1, height_ratios=(0.32 * lanes, 1.0, 2.5, 1.0, 1.9, 1.25),
        left=LEFT, right=RIGHT, top=TOP, bottom=BOTTOM, hspace=0.36,
    )  # fmt: skip
    events_axes, *panel_axes = [figure.add_subplot(grid[row]) for row in range(6)]
    for axes in panel_axes:
        panels.style_axes(axes)
        panels.label_time_axis(axes, duration_s)
    for axes in panel_axes[:-1]:
        axes.set_xlabel("")
        axes.tick_params(axis="x", labelbottom=False)

    _draw_title(figure, title, facts)
    events_axes.set_xlim(0.0, duration_s)
    panels.draw_events(events_axes, placed, lanes)

    found = np.array(principals, dtype=np.float64).reshape(-1, 4)
    mono = audio.mean(axis=1)
    _draw_audio(panel_axes[0], audio, mono, samplerate)
    _draw_audio_spectrum(figure, panel_axes[1], mono, samplerate, found)
    _draw_vibration(panel_axes[2], vibration, vibration_samplerate)
    _draw_vibration_spectrum(figure, panel_axes[3], vibration, vibration_samplerate, found)
    _draw_acceleration(panel_axes[4], acceleration, acceleration_samplerate)

    # matplotlib's canvas is not typed yet everywhere
    canvas.draw()  # type: ignore[no-untyped-call, unused-ignore]
    rgba = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call, unused-ignore]
    picture = palette.indexed_png(rgba, DPI, description)
    if isinstance(path, (str, os.PathLike)):
        write_bytes_atomically(path, picture)
    else:
        path.write(picture)


def _draw_title(figure: Figure, title: str, facts: Sequence[str]) -> None:
    """The title at the top left and, under it, the facts in one line, shortened to the width."""
    figure.text(
        LEFT, 0.975, _drawable(_shortened(title, 80)), fontsize=16.0, fontfamily=panels.FONT,
        fontweight="bold", color=palette.INK, va="center", parse_math=False,
    )  # fmt: skip
    figure.text(
        LEFT, 0.9485, _drawable(_shortened("   ·   ".join(facts), 150)), fontsize=panels.LABEL_PT,
        fontfamily=panels.FONT, color=palette.GREY, va="center", parse_math=False,
    )  # fmt: skip


def _draw_audio(axes: Axes, audio: Samples, mono: Samples, samplerate: int) -> None:
    """Panel 1: the peaks of all channels in light, the RMS of their mean in dark."""
    times_s = column_times_s(mono.size / samplerate, COLUMNS)
    outlines = [envelope(audio[:, channel], COLUMNS) for channel in range(audio.shape[1])]
    lowest = np.min([low for low, _ in outlines], axis=0)
    highest = np.max([high for _, high in outlines], axis=0)
    panels.draw_waveform(axes, times_s, lowest, highest, palette.HEARD_LIGHT, at_least=0.01)
    rms = short_time_rms(mono, samplerate, COLUMNS, RMS_WINDOW_S)
    axes.fill_between(times_s, -rms, rms, color=palette.HEARD, linewidth=0.0)
    panels.label_values(axes, "full scale")
    peak = max(float(np.max(highest)), -float(np.min(lowest)))
    panels.draw_heading(axes, "Audio", "peaks, and in dark the RMS", _peak_in_dbfs(peak))


def _draw_audio_spectrum(
    figure: Figure, axes: Axes, mono: Samples, samplerate: int, found: NDArray[np.float64]
) -> None:
    """Panel 2: the audio's spectrum, with the principal frequencies as dots."""
    rows_hz = np.geomspace(*AUDIO_LIMITS_HZ, AUDIO_ROWS)
    panels.use_audio_frequency_axis(axes, AUDIO_LIMITS_HZ)
    _draw_spectrum(figure, axes, mono, samplerate, rows_hz, AUDIO_WINDOW_S, AUDIO_RANGE_DB)
    if found.size:
        panels.draw_principals(axes, found[:, 0], found[:, 1], found[:, 3])
    panels.draw_heading(axes, "Audio spectrum", "dots: principal frequencies, larger is stronger")


def _draw_vibration(axes: Axes, vibration: Samples, samplerate: int) -> None:
    """Panel 3: the vibration's waveform."""
    times_s = column_times_s(vibration.size / samplerate, COLUMNS)
    lowest, highest = envelope(vibration, COLUMNS)
    panels.draw_waveform(axes, times_s, lowest, highest, palette.FELT, at_least=0.01)
    panels.label_values(axes, "full scale")
    peak = max(float(np.max(highest)), -float(np.min(lowest)))
    panels.draw_heading(axes, "Vibration", "what the amplifier is given", _peak_in_dbfs(peak))


def _draw_vibration_spectrum(
    figure: Figure, axes: Axes, vibration: Samples, samplerate: int, found: NDArray[np.float64]
) -> None:
    """Panel 4: the vibration's spectrum and the band it is meant to stay in."""
    rows_hz = np.linspace(*VIBRATION_LIMITS_HZ, VIBRATION_ROWS)
    axes.set_ylim(*VIBRATION_LIMITS_HZ)
    window_s, range_db = VIBRATION_WINDOW_S, VIBRATION_RANGE_DB
    _draw_spectrum(figure, axes, vibration, samplerate, rows_hz, window_s, range_db)
    if found.size:
        strongest = _strongest_of_each_moment(found)
        panels.draw_principals(axes, strongest[:, 0], strongest[:, 2], strongest[:, 3])
    for edge_hz in VIBRATION_BAND_HZ:
        axes.axhline(edge_hz, color=palette.FELT, linewidth=0.9)
    axes.set_yticks([20.0, 60.0, 100.0, 140.0, 180.0, 220.0, 260.0])
    low_hz, high_hz = VIBRATION_BAND_HZ
    panels.draw_heading(
        axes,
        "Vibration spectrum",
        f"dots: the strongest frequency; lines: {low_hz:.0f} and {high_hz:.0f} Hz",
    )


def _draw_acceleration(axes: Axes, acceleration: Samples, samplerate: int) -> None:
    """Panel 5: the predicted acceleration of the cushion, with its short-time RMS."""
    times_s = column_times_s(acceleration.size / samplerate, COLUMNS)
    lowest, highest = envelope(acceleration, COLUMNS)
    panels.draw_waveform(axes, times_s, lowest, highest, palette.FELT_LIGHT, at_least=0.1)
    # Of long sound a column shows more than the window.
    window_s = max(RMS_WINDOW_S, acceleration.size / samplerate / COLUMNS)
    rms = short_time_rms(acceleration, samplerate, COLUMNS, window_s)
    axes.plot(times_s, rms, color=palette.INK, linewidth=1.2)
    panels.label_values(axes, "m/s²")
    peak = max(float(np.max(highest)), -float(np.min(lowest)))
    panels.draw_heading(
        axes,
        "Acceleration",
        f"of the cushion, predicted; dark line: RMS over {1000.0 * window_s:.0f} ms",
        f"peak {peak:.3g} m/s² ({peak / STANDARD_GRAVITY_M_S2:.2g} g)",
    )


def _strongest_of_each_moment(found: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of the rows of `found` that share a time, the one with the largest strength."""
    ordered = found[np.lexsort((-found[:, 3], found[:, 0]))]
    return ordered[np.unique(ordered[:, 0], return_index=True)[1]]


def _draw_spectrum(
    figure: Figure,
    axes: Axes,
    signal: Samples,
    samplerate: int,
    rows_hz: NDArray[np.float64],
    window_s: float,
    range_db: float,
) -> None:
    """A spectrogram on a prepared frequency axis, with a slim colour bar in the right margin."""
    level_db = spectrogram_db(
        signal, samplerate, window_s=window_s, columns=SPECTRUM_COLUMNS, rows_hz=rows_hz
    )
    panels.label_values(axes, "frequency (Hz)")
    image = panels.draw_spectrogram(axes, level_db, signal.size / samplerate, range_db=range_db)
    bar_axes = axes.inset_axes((1.008, 0.0, 0.0075, 1.0))
    figure.colorbar(image, cax=bar_axes)
    for line in bar_axes.spines.values():
        line.set_visible(False)
    bar_axes.tick_params(
        labelsize=panels.TICK_PT - 0.5, labelcolor=palette.GREY, labelfontfamily=panels.FONT,
        length=0.0, pad=3.0,
    )  # fmt: skip
    bar_axes.annotate(
        "dBFS", (0.0, 1.0), (0.0, 7.0), xycoords="axes fraction", textcoords="offset points",
        fontsize=panels.TICK_PT - 0.5, fontfamily=panels.FONT, color=palette.GREY, va="baseline",
    )  # fmt: skip


def _checked(name: str, signal: Samples, samplerate: int, *, dimensions: int) -> Samples:
    """`signal` with what is not finite replaced by 0, or a ValueError that says what is wrong."""
    signal = np.asarray(signal)
    shape = "(frames, channels)" if dimensions == 2 else "(frames,)"
    if signal.ndim != dimensions or signal.size == 0:
        raise ValueError(f"{name} has shape {signal.shape}, want {shape} with at least one frame")
    if samplerate <= 0:
        raise ValueError(f"{name}: samplerate={samplerate} is not above 0 Hz")
    if not np.issubdtype(signal.dtype, np.floating):
        raise ValueError(f"{name} is of {signal.dtype}, want floating point with full scale 1")
    return signal if np.isfinite(signal).all() else np.nan_to_num(signal, posinf=0.0, neginf=0.0)


def _peak_in_dbfs(peak: float) -> str:
    """`peak` (full scale 1) in words: "peak −3.0 dBFS", or "silent"."""
    return f"peak {20.0 * np.log10(peak):.1f} dBFS".replace("-", "−") if peak > 0.0 else "silent"


def _shortened(text: str, letters: int) -> str:
    return text if len(text) <= letters else text[: letters - 1].rstrip() + "…"


def _drawable(text: str) -> str:
    """`text` with every letter that the font lacks as "?": matplotlib would warn and draw a box."""
    known = get_font(findfont(panels.FONT)).get_charmap()
    return "".join(letter if ord(letter) in known else "?" for letter in text)
