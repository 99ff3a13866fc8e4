"""Figure 7: a signal, its spectrogram, and principal frequencies of one unit (analysis window)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullLocator

from audioflinger_hook.figures import palette, panels
from audioflinger_hook.figures.columns import column_times_s, envelope, spectrogram_db
from audioflinger_hook.transform import FloatArray
from tools.paper import layout
from tools.paper.table import write_table
from tools.paper.units import UnitSequence

LIMITS_HZ = (50.0, 12_000.0)
COLUMNS, ROWS = 1_268, 200
WINDOW_S = 0.04643
RANGE_DB = 60.0
CROWDED = 1.6  # labels of two frequencies with a smaller ratio are placed on opposite sides


def write_figure7(
    mono: FloatArray, samplerate: int, unit: UnitSequence, folder: Path
) -> list[Path]:
    """Write figure7.csv and figure7.png; return their paths.

    The table has the unit's spectrum up to 12 kHz. Each principal frequency has an additional row
    with principal = 1. This row also has the half-power bandwidth, r (docs/transform.md) and the
    vibration frequency, in Hz.
    """
    table, picture = folder / "figure7.csv", folder / "figure7.png"
    write_table(table, _columns(unit))
    _draw(mono, samplerate, unit, picture)
    return [table, picture]


def _columns(unit: UnitSequence) -> dict[str, FloatArray]:
    shown = unit.frequency_hz <= LIMITS_HZ[1]
    bins, found = int(shown.sum()), unit.principals
    none = np.full(bins, np.nan)
    columns = {
        "frequency_hz": np.concatenate([unit.frequency_hz[shown], found.audio_hz]),
        "magnitude": np.concatenate([unit.amplitude[shown], found.amplitude]),
        "principal": np.repeat([0, 1], [bins, len(found)]),
        "bandwidth_hz": np.concatenate([none, found.bandwidth_hz]),
        "r_hz": np.concatenate([none, found.r]),
        "vibration_hz": np.concatenate([none, unit.vibration_hz]),
        "unit_start_s": np.full(bins + len(found), unit.start_s),
        "unit_end_s": np.full(bins + len(found), unit.end_s),
    }
    order = np.argsort(columns["frequency_hz"], kind="stable")
    return {name: column[order] for name, column in columns.items()}


def _draw(mono: FloatArray, samplerate: int, unit: UnitSequence, path: Path) -> None:
    figure, (signal, spectra, samples, spectrum) = layout.sheet(
        "Principal frequencies of a unit sequence",
        "A made recording of things struck in a room; the unit by the transform's reference form",
        (
            (1.15, layout.NARROW_IN),
            (2.3, layout.WIDE_IN),
            (1.15, layout.WIDE_IN),
            (2.7, layout.LAST_IN),
        ),
    )
    duration_s = mono.size / samplerate
    times_s = column_times_s(duration_s, COLUMNS)
    panels.draw_waveform(signal, times_s, *envelope(mono, COLUMNS), palette.HEARD, at_least=0.01)
    panels.label_values(signal, "full scale")
    named = f"the unit, {unit.start_s:.3f} to {unit.end_s:.3f} s"
    panels.draw_heading(signal, "Signal", f"mean of both channels; marked: {named}")
    _draw_spectra(figure, spectra, mono, samplerate)
    for axes in (signal, spectra):
        axes.axvspan(unit.start_s, unit.end_s, color=palette.FELT, alpha=0.28, lw=0.0, zorder=3)
        panels.label_time_axis(axes, duration_s)
    signal.set_xlabel("")
    signal.tick_params(axis="x", labelbottom=False)
    times_s = unit.start_s + np.arange(unit.samples.size) / samplerate
    samples.plot(times_s, unit.samples, color=palette.HEARD, lw=1.0)
    samples.set_xlim(unit.start_s, unit.end_s)
    samples.grid(axis="x", color=palette.HAIRLINE, lw=0.6, alpha=0.7)
    panels.label_values(samples, "full scale")
    layout.label_horizontal(samples, "time (s)")
    panels.draw_heading(samples, "Unit sequence", "after the band-pass, 50 Hz to 12 kHz")
    _draw_spectrum(spectrum, unit)
    layout.save(figure, path)


def _draw_spectra(figure: Figure, axes: Axes, mono: FloatArray, samplerate: int) -> None:
    rows_hz = np.geomspace(*LIMITS_HZ, ROWS)
    level_db = spectrogram_db(
        mono, samplerate, window_s=WINDOW_S, columns=COLUMNS // 2, rows_hz=rows_hz
    )
    panels.use_audio_frequency_axis(axes, LIMITS_HZ)
    image = panels.draw_spectrogram(axes, level_db, mono.size / samplerate, range_db=RANGE_DB)
    layout.colour_bar(figure, axes, image, "dBFS")
    panels.label_values(axes, "frequency (Hz)")
    panels.draw_heading(axes, "Short-time spectrum", "Hamming windows of 46.43 ms")


def _draw_spectrum(axes: Axes, unit: UnitSequence) -> None:
    axes.set_xscale("log")
    axes.set_xlim(*LIMITS_HZ)
    ticks = [50, 100, 200, 500, 1_000, 2_000, 5_000, 10_000]
    axes.set_xticks(ticks)
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda hz, _: f"{hz:.0f}"))
    axes.plot(unit.frequency_hz[1:], unit.amplitude[1:], color=palette.HEARD, lw=1.5)
    found = unit.principals
    axes.set_ylim(0.0, 1.42 * float(max(found.amplitude, default=unit.amplitude.max())))
    axes.plot(found.audio_hz, found.amplitude, "o", ms=6, color=palette.FELT, mec=palette.WHITE)
    # A label next to a close neighbour is shifted sideways.
    crowded = (found.audio_hz[1:] / found.audio_hz[:-1] < CROWDED).tolist()
    after, before = [*crowded, False], [False, *crowded]
    for place, (hz, amplitude, felt_hz) in enumerate(
        zip(found.audio_hz, found.amplitude, unit.vibration_hz, strict=True)
    ):
        align, shift = "center", 0.0
        if after[place] != before[place]:
            align, shift = ("right", 8.0) if after[place] else ("left", -8.0)
        axes.annotate(
            f"{hz:.0f} Hz\nfelt as {felt_hz:.1f} Hz", (hz, amplitude), (shift, 8.0),
            textcoords="offset points", ha=align, va="bottom", fontsize=panels.TICK_PT,
            fontfamily=panels.FONT, color=palette.INK, linespacing=1.3,
        )  # fmt: skip
    axes.grid(True, color=palette.HAIRLINE, lw=0.7, alpha=0.7)
    panels.label_values(axes, "amplitude (full scale)")
    layout.label_horizontal(axes, "frequency (Hz)")
    panels.draw_heading(axes, "Spectrum of the unit", "dots: the principal frequencies, r > 0.3 Hz")
