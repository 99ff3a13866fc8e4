"""Colours of all figures, and PNG files that contain only these colours."""

import io

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, to_rgb
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

WHITE = "#ffffff"
INK = "#24303c"
GREY = "#66717d"
HAIRLINE = "#d9dee2"
HEARD = "#44698a"
HEARD_LIGHT = "#a9c0d3"
FELT = "#e4572e"
FELT_LIGHT = "#f4ae98"

# The CIELAB lightness decreases from 98 to 18 in equal steps, at hues of 225 to 274 degrees. Equal
# steps of level therefore look equally large, in colour and in grey.
LEVEL_COLOURS = (
    "#f7fafb", "#d7e9f2", "#b9d8e9", "#9dc7df", "#83b5d3", "#6ba3c7", "#5692b9",
    "#4580aa", "#366e99", "#2c5d86", "#254c72", "#1f3c5c", "#1a2d46",
)  # fmt: skip

# (colour of the foreground, colour of the background, number of antialiasing steps between them)
_BLENDS = (
    (INK, WHITE, 16), (GREY, WHITE, 16), (HAIRLINE, WHITE, 4), (HEARD, WHITE, 10),
    (HEARD_LIGHT, WHITE, 6), (HEARD, HEARD_LIGHT, 4), (FELT, WHITE, 14), (FELT_LIGHT, WHITE, 6),
    (INK, FELT_LIGHT, 8),
)  # fmt: skip
_LEVELS, _LEVELS_UNDER_FELT, _STEPS_ON_LEVELS = 110, 10, 6


def level_map() -> LinearSegmentedColormap:
    """Return the colour map of levels, from nearly white (low) to dark blue (high)."""
    return LinearSegmentedColormap.from_list("level", LEVEL_COLOURS)


def indexed_png(rgba: NDArray[np.uint8], dots_per_inch: int, description: str = "") -> bytes:
    """Return an opaque picture `rgba` (height, width, 4) as a PNG with one byte per pixel.

    Each pixel gets the nearest of 256 colours. description: text for the PNG's "Description" chunk.
    """
    colours = [np.array(to_rgb(WHITE)), *level_map()(np.linspace(0.0, 1.0, _LEVELS))[:, :3]]
    for over, under, steps in _BLENDS:
        colours += _blend(over, np.array(to_rgb(under)), steps)
    for level in level_map()(np.linspace(0.0, 0.95, _LEVELS_UNDER_FELT)):
        colours += _blend(FELT, level[:3], _STEPS_ON_LEVELS)
    # Pillow requires 256 colours. The last colour fills the rest.
    colours += [colours[-1]] * (256 - len(colours))
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.round(255.0 * np.array(colours)).astype(np.uint8).tobytes())
    indexed = Image.fromarray(rgba[:, :, :3]).quantize(palette=palette, dither=Image.Dither.NONE)
    content, texts = io.BytesIO(), PngInfo()
    if description:
        texts.add_text("Description", description)
    dpi = (dots_per_inch, dots_per_inch)
    indexed.save(content, format="PNG", optimize=True, dpi=dpi, pnginfo=texts)
    return content.getvalue()


def _blend(over: str, under: NDArray[np.float64], steps: int) -> list[NDArray[np.float64]]:
    """Return `steps` blends of colour `over` on colour `under`, of opacities 1/steps to 1."""
    top = np.array(to_rgb(over))
    return [under + (top - under) * (step / steps) for step in range(1, steps + 1)]
