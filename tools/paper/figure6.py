"""Figure 6: the frequency response of the actuator, 5 to 300 Hz."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from audioflinger_hook.figures import palette, panels
from tools.paper import layout
from tools.paper.response import SHOWN_HZ, TAKES, Response
from tools.paper.table import write_table


def write_figure6(response: Response, folder: Path) -> list[Path]:
    """Write figure6.csv and figure6.png; return their paths.

    The table has these columns:

    frequency_hz: frequencies at which the response was measured.
    magnitude: acceleration in m/s^2 per A of current.
    phase_deg: phase of the acceleration relative to the current, -90 to 270. At 90 degrees, force
        and velocity are in phase.
    magnitude_per_volt: acceleration in m/s^2 per V at the amplifier's output.
    coherence: coherence of acceleration and sweep, 0 to 1.
    """
    table, picture = folder / "figure6.csv", folder / "figure6.png"
    write_table(
        table,
        {
            "frequency_hz": response.frequency_hz,
            "magnitude": np.abs(response.per_ampere),
            "phase_deg": 90.0 + np.degrees(np.angle(response.per_ampere / 1j)),
            "magnitude_per_volt": np.abs(response.per_volt),
            "coherence": response.coherence,
        },
    )
    _draw(response, picture)
    return [table, picture]


def _draw(response: Response, path: Path) -> None:
    figure, (per_ampere, per_volt) = layout.sheet(
        "Frequency response of the actuator",
        f"The simulated rig, measured as in a laboratory: {TAKES} exponential sweeps, at most "
        f"{100.0 * response.excursion_share:.0f} % of Xmax,\n"
        "through DAC, amplifier, actuator, accelerometer, conditioning amplifier and DAQ",
        ((3.1, layout.NARROW_IN + 0.2), (2.0, layout.LAST_IN)),
    )
    hz = response.frequency_hz
    curves = (
        (per_ampere, np.abs(response.per_ampere), palette.FELT, 2.0, "m/s² per A", "Acceleration",
         "per ampere of the coil: mass, spring and friction alone"),
        (per_volt, np.abs(response.per_volt), palette.HEARD, 1.6, "m/s² per V", "Acceleration",
         "per volt at the amplifier's output, which brakes the motion as well"),
    )  # fmt: skip
    for axes, magnitude, colour, width, unit, name, explanation in curves:
        axes.plot(hz, magnitude, color=colour, lw=width)
        axes.set_xlim(0.0, SHOWN_HZ[1])
        axes.set_ylim(0.0, 1.12 * magnitude.max())
        axes.set_xticks(np.arange(0.0, SHOWN_HZ[1] + 1.0, 30.0))
        axes.grid(True, color=palette.HAIRLINE, lw=0.7, alpha=0.7)
        panels.label_values(axes, unit)
        panels.draw_heading(axes, name, explanation)
        peak = int(np.argmax(magnitude))
        axes.plot(hz[peak], magnitude[peak], "o", ms=6, color=colour, mec=palette.WHITE, mew=1.2)
        what = "resonance" if axes is per_ampere else "peak"
        axes.annotate(
            f"{what} {hz[peak]:.1f} Hz", (hz[peak], magnitude[peak]), (14.0, 0.0),
            textcoords="offset points", fontsize=panels.LABEL_PT, fontfamily=panels.FONT,
            color=palette.INK, va="center",
        )  # fmt: skip
    layout.label_horizontal(per_volt, "frequency (Hz)")
    layout.save(figure, path)
