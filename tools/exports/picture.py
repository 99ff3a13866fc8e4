"""Draws the demo scene, its vibration, and the rendering of each export format.

python -m tools.exports.picture [OUT]       default: docs/images/exports.png
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
import soundfile
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.signal import spectrogram

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.exports.export import ExportOptions, export
from audioflinger_hook.figures.palette import (
    FELT,
    GREY,
    HEARD,
    HEARD_LIGHT,
    INK,
    indexed_png,
    level_map,
)
from audioflinger_hook.scenes import demo_scene
from audioflinger_hook.sources import FramesTap, TapClient, mixdown
from device.atomic_file import write_bytes_atomically
from device.units import FloatArray
from tools.exports.measures import ENVELOPE_S, births_in, envelope, likeness
from tools.exports.renderers import RENDERERS
from tools.records import PROJECT_ROOT

PLAYED_HZ, SOUND_HZ = 2_000, 48_000
BLOCK_FRAMES = 32_768
SHORT_ENVELOPE_S = 0.03
TITLES = {
    "partials": "partial tracks", "hjif": "HJIF", "ahap": "AHAP", "haptic": ".haptic",
    "vibration-xml": "Android XML",
}  # fmt: skip
FLOOR_DB, TOP_HZ = -50.0, 250.0
DOTS_PER_INCH = 110


def main() -> None:
    """Write the figure."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    default = PROJECT_ROOT / "docs/images/exports.png"
    parser.add_argument("out", nargs="?", type=Path, default=default)
    figure = draw(mixdown(demo_scene()))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    pixels = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
    write_bytes_atomically(parser.parse_args().out, indexed_png(pixels, DOTS_PER_INCH))


def draw(sound: NDArray[np.float32]) -> Figure:
    """Return the figure for a sound. sound: (frames, channels) at 48 kHz."""
    settings, original = Settings(profile="cinema"), None
    births_s: list[float] = []
    made: dict[str, tuple[FloatArray, int]] = {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "out"
        for name in ("wav", *TITLES):
            rate = PLAYED_HZ if name == "wav" else None
            client = TapClient(FramesTap(sound, SOUND_HZ, BLOCK_FRAMES))
            export(client, path, settings, ExportOptions(name, rate))
            if name == "wav":
                original = _read(path)
                continue
            assert original is not None
            content = path.read_bytes()
            births_s = births_s or births_in(content)
            played = RENDERERS[name](content, original.size / PLAYED_HZ, PLAYED_HZ)
            made[name] = (played[: original.size], len(content))
    assert original is not None
    return _figure(sound, original, births_s, made)


def _read(path: Path) -> FloatArray:
    frames, _ = soundfile.read(path, always_2d=True)
    found: FloatArray = frames[:, 0]
    return found


def _figure(
    sound: NDArray[np.float32],
    original: FloatArray,
    births_s: list[float],
    made: dict[str, tuple[FloatArray, int]],
) -> Figure:
    seconds = original.size / PLAYED_HZ
    figure = Figure(figsize=(12.0, 10.5), layout="constrained", dpi=DOTS_PER_INCH)
    axes = figure.subplots(2 + len(made), 2, sharex=True, width_ratios=(1.0, 1.0))
    times = np.arange(original.size) / PLAYED_HZ
    wanted = envelope(original, PLAYED_HZ, SHORT_ENVELOPE_S)
    top = 1.1 * float(wanted.max())
    step = SOUND_HZ // PLAYED_HZ
    blocks = np.abs(sound.mean(axis=1))[: original.size * step].reshape(-1, step).max(axis=1)
    axes[0, 0].fill_between(times[: blocks.size], -blocks, blocks, color=HEARD, linewidth=0)
    axes[0, 0].set_title("the sound", loc="left", color=INK, fontsize=11)
    axes[0, 1].set_axis_off()
    axes[0, 1].text(
        0.0, 0.5,
        "Left: envelopes. The line is what a player makes of the file,\n"
        "the area is the vibration. Right: its frequencies, 0 to 250 Hz.\n"
        f"r: correlation of envelopes over {1e3 * ENVELOPE_S:.0f} ms.",
        transform=axes[0, 1].transAxes, color=GREY, fontsize=11, va="center",
    )  # fmt: skip
    rows = {"the vibration": (original, 0), **{TITLES[name]: one for name, one in made.items()}}
    for (left, right), (title, (vibration, size)) in zip(axes[1:], rows.items(), strict=True):
        left.fill_between(times, wanted, color=HEARD_LIGHT, linewidth=0)
        text = title
        if size:
            found = likeness(original, vibration, PLAYED_HZ, births_s)
            left.plot(
                times, envelope(vibration, PLAYED_HZ, SHORT_ENVELOPE_S), color=FELT, linewidth=0.9
            )
            text += f": r = {found.envelope:.3f}, {size / 1e3:.0f} kB"
        left.set_ylim(0.0, top)
        left.set_title(text, loc="left", color=INK, fontsize=11)
        _spectrum(right, vibration)
    for axis in axes.ravel():
        axis.spines[["top", "right"]].set_visible(False)
        axis.tick_params(colors=GREY, labelsize=9)
    for axis in axes[-1]:
        axis.set_xlabel("time in s", color=GREY)
    axes[0, 0].set_xlim(0.0, seconds)
    return figure


def _spectrum(axis: Axes, vibration: FloatArray) -> None:
    hz, at_s, power = spectrogram(vibration, PLAYED_HZ, "hann", 256, 224, 1024)
    kept = hz <= TOP_HZ
    level = 10.0 * np.log10(np.maximum(power[kept], 1e-14))
    axis.pcolormesh(
        at_s, hz[kept], level, cmap=level_map(), vmin=-20.0 + FLOOR_DB, vmax=-20.0,
        shading="nearest", rasterized=True,
    )  # fmt: skip
    axis.set_yticks([0, 100, 200], ["0 Hz", "100", "200"])


if __name__ == "__main__":
    main()
