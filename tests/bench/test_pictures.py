"""The bench's pictures: on its page where they lie under its folder, and only of what there is."""

import os
import sys

import pytest

from tests.support.bench_runs import broken, run_benches
from tools.bench.figures.pictures import PICTURES, shown_in
from tools.bench.report import Row, Section

SERIES = {"live": (6.0, 7.0, 8.0, 9.5), "reference": (20.0, 35.0, 50.0, 58.0)}
"""What the picture of lags is drawn from: single lags in ms, for both forms."""


def lags(_):
    return Section("Onset lag", "How soon it is felt.", (Row("lag", 8.0, "ms"),), series=SERIES)


def ran(monkeypatch, page, folder, measure=lags):
    return run_benches(monkeypatch, "--out", page, "--plots", folder, lag=measure)


@pytest.fixture
def drawing():
    if os.environ.get("CI") != "true":
        pytest.importorskip("matplotlib")


def test_a_page_shows_the_pictures_of_its_folder_in_their_section(drawing, monkeypatch, tmp_path):
    (tmp_path / "pages").mkdir()
    assert ran(monkeypatch, tmp_path / "pages" / "page.md", tmp_path / "my images").code == 0
    assert "![" not in (tmp_path / "pages" / "page.md").read_text("utf-8")
    done = ran(monkeypatch, tmp_path / "page.md", tmp_path / "my images")
    assert done.code == 0
    page = (tmp_path / "page.md").read_text("utf-8")
    assert "## Onset lag\n\nHow soon it is felt.\n\n![" in page
    assert "](my%20images/lag.png)\n\n|" in page
    assert page in done.stdout
    assert [path.name for path in (tmp_path / "my images").iterdir()] == ["lag.png"]
    assert (tmp_path / "my images" / "lag.png").stat().st_size < 100_000


def test_what_could_not_be_measured_has_no_picture(drawing, monkeypatch, tmp_path):
    assert ran(monkeypatch, tmp_path / "page.md", tmp_path / "images", broken).code == 2
    assert list((tmp_path / "images").iterdir()) == []


def test_without_matplotlib_that_is_told_before_anything_is_measured(monkeypatch, tmp_path):
    measured: list[object] = []
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    done = ran(monkeypatch, tmp_path / "page.md", tmp_path / "images", measured.append)
    assert done.code == 2
    assert "matplotlib is not installed" in done.stderr
    assert measured == []
    assert not (tmp_path / "page.md").exists()


def test_every_picture_has_its_own_section_and_says_what_it_shows(tmp_path):
    assert len({picture.section for picture in PICTURES}) == len(PICTURES)
    drawn = [tmp_path / "images" / picture.file_name for picture in PICTURES]
    assert set(shown_in(tmp_path / "page.md", drawn)) == {picture.section for picture in PICTURES}
    assert all(picture.says and "]" not in picture.says for picture in PICTURES)
