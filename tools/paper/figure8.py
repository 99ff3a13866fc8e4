"""Figure 8: the vibration, its short-time spectrum, and the measured acceleration."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from audioflinger_hook.figures import palette, panels
from audioflinger_hook.figures.columns import spectrogram_db
from tools.paper import layout
from tools.paper.felt import BAND_HZ, Felt, share_in_band
from tools.paper.table import write_table

START_S, END_S = 1.45, 2.05
LIMITS_HZ = (0.0, 260.0)
COLUMNS_A_S, ROWS = 1_000, 131
WINDOW_S = 0.1
RANGE_DB = 30.0
BEFORE_S, AFTER_S = 0.03, 0.06
RESIDUAL_S = 0.05


def write_figure8(felt: Felt, folder: Path, name: str, undamped: Felt | None = None) -> list[Path]:
    """Write NAME.csv and NAME.png; return their paths.

    Columns: time_s from the recording's start, vibration and drive (full scale 1), acceleration in
        m/s^2, and over. The column over is 1 while the vibration is 0, so that any motion is
        residual.

    undamped: the same motion without damping, which the picture shows too.
    """
    table, picture = folder / f"{name}.csv", folder / f"{name}.png"
    part = felt.within(START_S, END_S)
    write_table(
        table,
        {
            "time_s": _times_s(part),
            "vibration": part.vibration,
            "drive": part.drive,
            "acceleration_m_s2": part.acceleration_m_s2,
            "over": part.over.astype(np.int8),
        },
    )
    _draw(felt, undamped, picture)
    return [table, picture]


def _times_s(part: Felt) -> np.ndarray:
    return START_S + np.arange(part.vibration.size) / part.samplerate


def _draw(felt: Felt, undamped: Felt | None, path: Path) -> None:
    figure, (vibration, spectra, acceleration, ending) = layout.sheet(
        "Vibration and acceleration" + (", with damping" if undamped else ""),
        "The same made recording; DAC, amplifier and actuator simulated, shown by laboratory "
        "instruments" + (";\nresonance inverse before the DAC" if undamped else ""),
        (
            (1.2, layout.NARROW_IN),
            (2.1, layout.NARROW_IN),
            (1.5, layout.WIDE_IN),
            (1.7, layout.LAST_IN),
        ),
    )
    part = felt.within(START_S, END_S)
    times_s = _times_s(part)
    _draw_vibration(vibration, part, times_s, damped=undamped is not None)
    _draw_spectra(figure, spectra, felt, part)
    others = [undamped.within(START_S, END_S)] if undamped else []
    highest = 1.08 * max(float(np.abs(f.acceleration_m_s2).max()) for f in (part, *others))
    _draw_acceleration(acceleration, part, times_s, highest)
    for axes in (vibration, spectra, acceleration):
        axes.set_xlim(START_S, END_S)
        axes.set_xticks(np.arange(START_S, END_S + 0.01, 0.05))
        if axes is not acceleration:
            axes.tick_params(axis="x", labelbottom=False)
    layout.label_horizontal(acceleration, "time (s)")
    _draw_ending(ending, felt, undamped)
    layout.save(figure, path)


def _draw_vibration(axes: Axes, part: Felt, times_s: np.ndarray, *, damped: bool) -> None:
    explanation = "wanted, full scale 1"
    if damped:
        axes.plot(times_s, part.drive, color=palette.HEARD_LIGHT, lw=1.0)
        explanation += "; light: the drive that damping makes of it, at the same strength felt"
    axes.plot(times_s, part.vibration, color=palette.FELT, lw=1.2)
    limit = 1.1 * float(np.abs([part.drive, part.vibration]).max())
    axes.set_ylim(-limit, limit)
    axes.grid(True, color=palette.HAIRLINE, lw=0.6, alpha=0.7)
    panels.label_values(axes, "full scale")
    panels.draw_heading(axes, "Vibration", explanation)


def _draw_spectra(figure: Figure, axes: Axes, felt: Felt, part: Felt) -> None:
    duration_s = felt.vibration.size / felt.samplerate
    level_db = spectrogram_db(
        felt.vibration, felt.samplerate, window_s=WINDOW_S,
        columns=round(COLUMNS_A_S * duration_s), rows_hz=np.linspace(*LIMITS_HZ, ROWS),
    )  # fmt: skip
    axes.set_ylim(*LIMITS_HZ)
    image = panels.draw_spectrogram(axes, level_db, duration_s, range_db=RANGE_DB)
    layout.colour_bar(figure, axes, image, "dBFS")
    for edge_hz in BAND_HZ:
        axes.axhline(edge_hz, color=palette.FELT, lw=0.9)
    axes.set_yticks([20.0, 60.0, 100.0, 140.0, 180.0, 220.0, 260.0])
    panels.label_values(axes, "frequency (Hz)")
    share = 100.0 * share_in_band(part.vibration, part.samplerate)
    panels.draw_heading(
        axes,
        "Vibration spectrum",
        f"lines: 20 and 220 Hz, with {share:.1f} % of its energy between; windows of 100 ms",
    )


def _draw_acceleration(axes: Axes, part: Felt, times_s: np.ndarray, highest: float) -> None:
    wanted = np.where(part.over, np.nan, part.acceleration_m_s2)
    left = np.where(part.over, part.acceleration_m_s2, np.nan)
    axes.plot(times_s, wanted, color=palette.HEARD, lw=1.2)
    axes.plot(times_s, left, color=palette.FELT, lw=1.4)
    axes.set_ylim(-highest, highest)
    axes.grid(True, color=palette.HAIRLINE, lw=0.6, alpha=0.7)
    panels.label_values(axes, "m/s²")
    panels.draw_heading(axes, "Acceleration", "measured; red: residual, where vibration is over")
    for end_s in part.ends_s(RESIDUAL_S):
        axes.annotate(
            f"residual {part.residual_db(end_s, RESIDUAL_S):.1f} dB".replace("-", "−"),
            (START_S + end_s + 0.008, 0.72 * highest), fontsize=panels.TICK_PT,
            fontfamily=panels.FONT, color=palette.INK,
        )  # fmt: skip


def _draw_ending(axes: Axes, felt: Felt, undamped: Felt | None) -> None:
    """Draw the motion around the first end of vibration, with and without damping."""
    end_s = next(end_s for end_s in felt.ends_s(RESIDUAL_S) if START_S < end_s < END_S)
    before, after = (round(span_s * felt.samplerate) for span_s in (BEFORE_S, AFTER_S))
    times_ms = 1e3 * np.arange(-before, after) / felt.samplerate
    shown = felt.within(end_s - BEFORE_S, end_s + AFTER_S).acceleration_m_s2
    told = f"{felt.residual_db(end_s, RESIDUAL_S):.1f} dB"
    if undamped:
        other = undamped.within(end_s - BEFORE_S, end_s + AFTER_S).acceleration_m_s2
        axes.plot(times_ms, other, color=palette.HEARD, lw=1.2, label="without")
        axes.plot(times_ms, shown, color=palette.FELT, lw=1.6, label="with damping")
        axes.legend(
            frameon=False, fontsize=panels.TICK_PT, labelcolor=palette.INK, loc="upper right"
        )
        told = f"{told} with damping, {undamped.residual_db(end_s, RESIDUAL_S):.1f} dB without"
    else:
        axes.plot(times_ms[:before], shown[:before], color=palette.HEARD, lw=1.6)
        axes.plot(times_ms[before:], shown[before:], color=palette.FELT, lw=1.6)
    axes.axvline(0.0, color=palette.INK, lw=0.9, ls=(0, (4, 3)))
    axes.set_xlim(-1e3 * BEFORE_S, 1e3 * AFTER_S)
    axes.grid(True, color=palette.HAIRLINE, lw=0.6, alpha=0.7)
    panels.label_values(axes, "m/s²")
    layout.label_horizontal(axes, "time since the vibration's end (ms)")
    panels.draw_heading(
        axes,
        f"Residual after {end_s:.2f} s",
        f"energy of 50 ms, against the 50 ms before: {told}".replace("-", "−"),
    )
