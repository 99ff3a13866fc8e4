"""The list of the report's pictures, and functions that write them as PNG files."""

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
    """One picture of the report.

    name: file name without suffix.
    says: alternative text.
    section: title of the section that shows the picture.
    draw: MODULE.FUNCTION in this folder that draws the picture.
    by_series: whether the picture shows the section's single measurements instead of its rows.
    colours: upper limit of the number of colours in the file.
    """

    name: str
    says: str
    section: str
    draw: str
    by_series: bool = False
    colours: int = COLOURS

    @property
    def file_name(self) -> str:
        """The name of the PNG file."""
        return f"{self.name}.png"

    def drawn(self, report: BenchReport) -> Figure:
        """Draw the picture of a report and return the figure."""
        module, _, function = self.draw.partition(".")
        home = importlib.import_module(f"tools.bench.figures.{module}")
        draw: Callable[[BenchReport], Figure] = getattr(home, function)
        return draw(report)

    def can_be_drawn(self, report: BenchReport) -> bool:
        """Return whether the report contains the values that the picture shows."""
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


def draw_all(report: BenchReport, folder: Path) -> list[Path]:
    """Write a PNG file for each picture whose values the report contains, and return the paths.

    UsageError: matplotlib is not installed.
    """
    need_matplotlib()
    paths = []
    for picture in PICTURES:
        if picture.can_be_drawn(report):
            paths.append(folder / picture.file_name)
            write_bytes_atomically(paths[-1], _small_png(picture.drawn(report), picture.colours))
    return paths


def png_of(section: Section) -> bytes:
    """Draw the picture of a section, and return it as a PNG file.

    UsageError: matplotlib is not installed.
    """
    need_matplotlib()
    (picture,) = (each for each in PICTURES if each.section == section.title)
    report = BenchReport("", True, 0.0, machine_facts(), (section,))
    return _small_png(picture.drawn(report), picture.colours)


def _small_png(figure: Figure, colours: int) -> bytes:
    from PIL import Image

    drawn, small = io.BytesIO(), io.BytesIO()
    figure.savefig(drawn, format="png", dpi=DPI)
    picture = Image.open(drawn).convert("RGB")
    indexed = picture.quantize(colours, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    indexed.save(small, format="PNG", optimize=True, dpi=(DPI, DPI))
    return small.getvalue()


def need_matplotlib() -> None:
    """Raise UsageError if matplotlib is not installed."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError:
        raise UsageError(
            "matplotlib is not installed, so nothing can be drawn; "
            "install it: .venv/bin/python -m pip install matplotlib"
        ) from None


def shown_in(page: Path, drawn: Sequence[Path]) -> dict[str, str]:
    """Return, by section title, the Markdown that shows each picture of `drawn`.

    Pictures outside the folder of the page are left out.
    """
    home = page.parent.resolve()
    files = {path.name: path.resolve() for path in drawn if path.resolve().is_relative_to(home)}
    return {
        picture.section: f"![{picture.says}]({quote(Path(relpath(file, home)).as_posix())})"
        for picture in PICTURES
        if (file := files.get(picture.file_name))
    }
