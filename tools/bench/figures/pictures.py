"""The list of a report's pictures, their PNG files, and how a page shows them."""

from __future__ import annotations

import importlib
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from os.path import relpath
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from device.atomic_file import write_bytes_atomically
from device.errors import UsageError
from tools.bench.machine import machine_facts
from tools.bench.report import BenchReport, Section

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 150
COLOURS = 48


@dataclass(frozen=True)
class Picture:
    """One picture: its file's name, its description, its section, and its function.

    draw: module of this package and function. by_series: whether it shows the section's single
    measurements and not its rows. colours: most of them in the file.
    """

    name: str
    says: str
    section: str
    draw: str
    by_series: bool = False
    colours: int = COLOURS

    @property
    def file_name(self) -> str:
        """The name of its file."""
        return f"{self.name}.png"

    def drawn(self, report: BenchReport) -> Figure:
        """Return the picture of a report."""
        module, _, function = self.draw.partition(".")
        home = importlib.import_module(f"tools.bench.figures.{module}")
        draw: Callable[[BenchReport], Figure] = getattr(home, function)
        return draw(report)

    def can_be_drawn(self, report: BenchReport) -> bool:
        """Return whether what it shows was measured."""
        shown = [section for section in report.sections if section.title == self.section]
        return any(bool(each.series if self.by_series else each.rows) for each in shown)


PICTURES = (
    Picture("cost", "CPU time of a second of each scene", "Cost of a second of sound",
            "transform.cost"),
    Picture("lag", "Share of bursts that vibrate by a time", "Onset lag", "transform.lag", True),
    Picture("frontier", "Four errors over cost, by setting", "Cost against error",
            "frontier.frontier"),
    Picture("baselines", "Cost, lag and similarity of each baseline", "Baselines",
            "baselines.baselines"),
    Picture("real_sounds", "A film heard and felt; a drum, a swell and a chord, by profile",
            "On real sounds", "real_sounds.real_sounds", True, 64),
    Picture("models", "Error of the simulated motion over cost", "Work and precision",
            "rig.models", True),
    Picture("damping", "Residual vibration over the true f0", "Residual vibration",
            "rig.damping", True),
)  # fmt: skip
"""Every picture, in the order of the report."""


def draw_all(report: BenchReport, folder: Path) -> list[Path]:
    """Write every picture into the folder and return the paths; see `bench.plots`."""
    need_matplotlib()
    paths = []
    for picture in PICTURES:
        if picture.can_be_drawn(report):
            paths.append(folder / picture.file_name)
            write_bytes_atomically(paths[-1], _small_png(picture.drawn(report), picture.colours))
    return paths


def png_of(section: Section) -> bytes:
    """Return the picture of one section as a PNG; it must have one. UsageError: no matplotlib."""
    need_matplotlib()
    (picture,) = (each for each in PICTURES if each.section == section.title)
    report = BenchReport("", True, 0.0, machine_facts(), (section,))
    return _small_png(picture.drawn(report), picture.colours)


def _small_png(figure: Figure, colours: int) -> bytes:
    """Return the figure as a PNG of few colours, a third of the usual size."""
    from PIL import Image

    drawn, small = io.BytesIO(), io.BytesIO()
    figure.savefig(drawn, format="png", dpi=DPI)
    picture = Image.open(drawn).convert("RGB")
    indexed = picture.quantize(colours, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    indexed.save(small, format="PNG", optimize=True, dpi=(DPI, DPI))
    return small.getvalue()


def need_matplotlib() -> None:
    """Raise UsageError where matplotlib is not installed."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError:
        raise UsageError(
            "matplotlib is not installed, so nothing can be drawn; "
            "install it: .venv/bin/python -m pip install matplotlib"
        ) from None


def shown_in(page: Path, drawn: Sequence[Path]) -> dict[str, str]:
    """Return the Markdown of each drawn picture, by its section's title.

    A picture outside the page's folder is left out: it would not move with the page.
    """
    home = page.parent.resolve()
    files = {path.name: path.resolve() for path in drawn if path.resolve().is_relative_to(home)}
    return {
        picture.section: f"![{picture.says}]({quote(Path(relpath(file, home)).as_posix())})"
        for picture in PICTURES
        if (file := files.get(picture.file_name))
    }
