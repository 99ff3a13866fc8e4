"""A picture of fits: sensitivity by frequency, with its uncertainty."""

import io
from collections.abc import Sequence

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from audioflinger_hook.config.fits import Fit
from audioflinger_hook.figures.palette import FELT, GREY, HAIRLINE, HEARD, INK
from audioflinger_hook.transform.design.sensitivity import FIT_BOOST_DB

COLOURS = (FELT, HEARD, INK, GREY)


def plot_png(fits: Sequence[Fit]) -> bytes:
    """Return a PNG of 1200 x 750 pixels. fits: the first has its uncertainty as a band."""
    figure = Figure(figsize=(8.0, 5.0), dpi=150, layout="constrained")
    axes = figure.add_subplot(
        xscale="log", xlabel="frequency (Hz)", ylabel="sensitivity relative to 70 Hz (dB)"
    )
    for fit, colour in zip(fits, COLOURS, strict=False):
        hz, level_db = [*map(float, fit.curve_db)], [*fit.curve_db.values()]
        spread_db = [fit.uncertainty_db[one] for one in fit.curve_db]
        low, high = (
            [db + sign * sd for db, sd in zip(level_db, spread_db, strict=True)] for sign in (-1, 1)
        )
        label = f"{fit.name}, {len(fit.trials)} trials, {fit.made[:10]}"
        axes.plot(hz, level_db, "o-", color=colour, label=label)
        if fit is fits[0]:
            axes.fill_between(hz, low, high, color=colour, alpha=0.2, label="± standard deviation")
    weakest = "below: the gain stays +12 dB"
    axes.axhline(-FIT_BOOST_DB, color=GREY, linestyle=":", label=weakest)
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    ticks = [float(hz) for hz in fits[0].curve_db]
    axes.set_xticks(ticks, [f"{hz:.0f}" for hz in ticks])
    axes.set_xticks([], minor=True)
    axes.grid(color=HAIRLINE)
    axes.legend(frameon=False)
    content = io.BytesIO()
    # Some versions of matplotlib have no type annotations for the canvas.
    FigureCanvasAgg(figure).print_png(content)  # type: ignore[no-untyped-call, unused-ignore]
    return content.getvalue()
