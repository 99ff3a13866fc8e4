"""The report: a picture with five panels on one time axis, as in the paper's Figures 7 and 8."""

from collections.abc import Sequence

import numpy as np
import scipy.constants
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import findfont, get_font
from numpy.typing import NDArray

from audioflinger_hook.figures import columns, palette, panels
from audioflinger_hook.figures.panels import Event, Principal

WIDTH_PX, HEIGHT_PX, DPI = 1600, 1500, 150
LEFT, RIGHT, TOP, BOTTOM = 0.072, 0.935, 0.922, 0.05

# There is one column per pixel. Spectra have half as many columns, for a smaller file.
COLUMNS = round((RIGHT - LEFT) * WIDTH_PX)

AUDIO_LIMITS_HZ = (50.0, 12_000.0)
AUDIO_WINDOW_S = 0.04643  # same window as in the analysis of principal frequencies
AUDIO_RANGE_DB = 60.0

VIBRATION_LIMITS_HZ = (0.0, 260.0)
VIBRATION_BAND_HZ = (20.0, 220.0)

RMS_WINDOW_S = 0.05

Samples = NDArray[np.floating]


def report_png(
    *,
    title: str,
    samplerate: int,
    audio: Samples,
    vibration: Samples,
    acceleration_m_s2: Samples,
    principals: Sequence[Principal],
    events: Sequence[Event],
    facts: Sequence[str] = (),
    description: str = "",
) -> bytes:
    """Return the report as a PNG of 1600 x 1500 pixels.

    All signals start at the same time. samplerate: Hz. Non-finite samples are drawn as 0. audio:
    (frames, channels), full scale 1. vibration: (frames,), full scale 1. acceleration_m_s2:
    (frames,). principals: (time in s, audio frequency in Hz, vibration frequency in Hz, strength 0
    to 1). events: (start in s, end in s, label). facts: short texts for the line under the title.
    description: text for the PNG's "Description" chunk; not drawn. ValueError: an array has a wrong
    shape or type, or no frames, or samplerate is not above 0.
    """
    audio = _checked("audio", audio, samplerate, dimensions=2)
    vibration = _checked("vibration", vibration, samplerate, dimensions=1)
    acceleration = _checked("acceleration_m_s2", acceleration_m_s2, samplerate, dimensions=1)
    duration_s = max(len(one) for one in (audio, vibration, acceleration)) / samplerate

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
    _draw_audio_spectrum(panel_axes[1], mono, samplerate, found)
    _draw_vibration(panel_axes[2], vibration, samplerate)
    _draw_vibration_spectrum(panel_axes[3], vibration, samplerate, found)
    _draw_acceleration(panel_axes[4], acceleration, samplerate)

    # Some versions of matplotlib have no type annotations for the canvas.
    canvas.draw()  # type: ignore[no-untyped-call, unused-ignore]
    rgba = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call, unused-ignore]
    return palette.indexed_png(rgba, DPI, description)


def _draw_title(figure: Figure, title: str, facts: Sequence[str]) -> None:
    figure.text(
        LEFT, 0.975, _drawable(_shortened(title, 80)), fontsize=16.0, fontfamily=panels.FONT,
        fontweight="bold", color=palette.INK, va="center", parse_math=False,
    )  # fmt: skip
    figure.text(
        LEFT, 0.9485, _drawable(_shortened("   ·   ".join(facts), 150)), fontsize=panels.LABEL_PT,
        fontfamily=panels.FONT, color=palette.GREY, va="center", parse_math=False,
    )  # fmt: skip


def _draw_outline(
    axes: Axes, signal: Samples, samplerate: int, colour: str, at_least: float, unit: str
) -> tuple[NDArray[np.float64], float]:
    """Draw the extremes of all channels. Return each column's time in s, and the largest peak."""
    times_s = columns.column_times_s(len(signal) / samplerate, COLUMNS)
    outlines = [columns.envelope(channel, COLUMNS) for channel in signal.T]
    lowest = np.min([low for low, _ in outlines], axis=0)
    highest = np.max([high for _, high in outlines], axis=0)
    panels.draw_waveform(axes, times_s, lowest, highest, colour, at_least=at_least)
    panels.label_values(axes, unit)
    return times_s, max(float(np.max(highest)), -float(np.min(lowest)))


def _draw_audio(axes: Axes, audio: Samples, mono: Samples, samplerate: int) -> None:
    times_s, peak = _draw_outline(axes, audio, samplerate, palette.HEARD_LIGHT, 0.01, "full scale")
    rms = columns.short_time_rms(mono, samplerate, COLUMNS, RMS_WINDOW_S)
    axes.fill_between(times_s, -rms, rms, color=palette.HEARD, linewidth=0.0)
    panels.draw_heading(axes, "Audio", "peaks, and in dark the RMS", _peak_in_dbfs(peak))


def _draw_audio_spectrum(
    axes: Axes, mono: Samples, samplerate: int, found: NDArray[np.float64]
) -> None:
    rows_hz = np.geomspace(*AUDIO_LIMITS_HZ, 200)
    panels.use_audio_frequency_axis(axes, AUDIO_LIMITS_HZ)
    _draw_spectrum(axes, mono, samplerate, rows_hz, AUDIO_WINDOW_S, AUDIO_RANGE_DB)
    if found.size:
        panels.draw_principals(axes, found[:, 0], found[:, 1], found[:, 3])
    panels.draw_heading(axes, "Audio spectrum", "dots: principal frequencies, larger is stronger")


def _draw_vibration(axes: Axes, vibration: Samples, samplerate: int) -> None:
    _, peak = _draw_outline(axes, vibration[:, None], samplerate, palette.FELT, 0.01, "full scale")
    panels.draw_heading(axes, "Vibration", "what the amplifier is given", _peak_in_dbfs(peak))


def _draw_vibration_spectrum(
    axes: Axes, vibration: Samples, samplerate: int, found: NDArray[np.float64]
) -> None:
    rows_hz = np.linspace(*VIBRATION_LIMITS_HZ, 131)
    axes.set_ylim(*VIBRATION_LIMITS_HZ)
    window_s, range_db = 0.16, 50.0  # long enough to separate 40 Hz from 80 Hz
    _draw_spectrum(axes, vibration, samplerate, rows_hz, window_s, range_db)
    if found.size:
        # Keep only the strongest frequency at each time.
        ordered = found[np.lexsort((-found[:, 3], found[:, 0]))]
        strongest = ordered[np.unique(ordered[:, 0], return_index=True)[1]]
        panels.draw_principals(axes, strongest[:, 0], strongest[:, 2], strongest[:, 3])
    for edge_hz in VIBRATION_BAND_HZ:
        axes.axhline(edge_hz, color=palette.FELT, linewidth=0.9)
    axes.set_yticks([20.0, 60.0, 100.0, 140.0, 180.0, 220.0, 260.0])
    legend = "dots: the strongest frequency; lines: {:.0f} and {:.0f} Hz".format(*VIBRATION_BAND_HZ)
    panels.draw_heading(axes, "Vibration spectrum", legend)


def _draw_acceleration(axes: Axes, acceleration: Samples, samplerate: int) -> None:
    signal = acceleration[:, None]
    times_s, peak = _draw_outline(axes, signal, samplerate, palette.FELT_LIGHT, 0.1, "m/s²")
    rms = columns.short_time_rms(acceleration, samplerate, COLUMNS, RMS_WINDOW_S)
    axes.plot(times_s, rms, color=palette.INK, linewidth=1.2)
    legend = f"of the cushion, predicted; dark line: RMS over {1000.0 * RMS_WINDOW_S:.0f} ms"
    in_g = peak / scipy.constants.g
    panels.draw_heading(axes, "Acceleration", legend, f"peak {peak:.3g} m/s² ({in_g:.2g} g)")


def _draw_spectrum(
    axes: Axes,
    signal: Samples,
    samplerate: int,
    rows_hz: NDArray[np.float64],
    window_s: float,
    range_db: float,
) -> None:
    """Draw a spectrogram on a prepared frequency axis, with a colour bar on the right."""
    level_db = columns.spectrogram_db(
        signal, samplerate, window_s=window_s, columns=COLUMNS // 2, rows_hz=rows_hz
    )
    panels.label_values(axes, "frequency (Hz)")
    image = panels.draw_spectrogram(axes, level_db, signal.size / samplerate, range_db=range_db)
    bar_axes = axes.inset_axes((1.008, 0.0, 0.0075, 1.0))
    figure = axes.figure
    assert figure is not None
    figure.colorbar(image, cax=bar_axes)
    bar_axes.spines[:].set_visible(False)
    bar_axes.tick_params(
        labelsize=panels.TICK_PT - 0.5, labelcolor=palette.GREY, labelfontfamily=panels.FONT,
        length=0.0, pad=3.0,
    )  # fmt: skip
    bar_axes.annotate(
        "dBFS", (0.0, 1.0), (0.0, 7.0), xycoords="axes fraction", textcoords="offset points",
        fontsize=panels.TICK_PT - 0.5, fontfamily=panels.FONT, color=palette.GREY, va="baseline",
    )  # fmt: skip


def _checked(name: str, signal: Samples, samplerate: int, *, dimensions: int) -> Samples:
    """Return `signal` with 0 in place of non-finite samples. ValueError: wrong shape or type."""
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
    """Return a peak (full scale 1) as text such as "peak −3.0 dBFS", or "silent" for 0."""
    return f"peak {20.0 * np.log10(peak):.1f} dBFS".replace("-", "−") if peak > 0.0 else "silent"


def _shortened(text: str, letters: int) -> str:
    return text if len(text) <= letters else text[: letters - 1].rstrip() + "…"


def _drawable(text: str) -> str:
    """Return `text` with "?" in place of letters that are not in the font."""
    known = get_font(findfont(panels.FONT)).get_charmap()
    return "".join(letter if ord(letter) in known else "?" for letter in text)
