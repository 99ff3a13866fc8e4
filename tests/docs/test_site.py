"""The site of docs/: it builds without warnings, all links work, and it fetches nothing."""

from __future__ import annotations

import subprocess
import sys
from html.parser import HTMLParser
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote

import pytest

ROOT = Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.exhaustive


class Page(HTMLParser):
    """What a page of the site offers and refers to."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.fetched: list[str] = []
        self.feed(path.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = {name: value or "" for name, value in attrs}
        self.anchors |= {found[name] for name in ("id", "name") if name in found}
        if tag == "a" and "href" in found:
            self.links.append(found["href"])
        elif tag == "link" and found.get("rel") not in ("canonical", "prev", "next"):
            self.fetched.append(found["href"])
        elif "src" in found:
            self.fetched.append(found["src"])


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a site, just built; warnings are errors."""
    if find_spec("material") is None:
        pytest.skip("mkdocs-material is not installed: run `make docs` once")
    folder = tmp_path_factory.mktemp("site")
    # Without --quiet, which would count no warnings.
    command = [sys.executable, "-m", "mkdocs", "build", "--strict"]
    built = subprocess.run(
        [*command, "--site-dir", str(folder)], cwd=ROOT, capture_output=True, text=True
    )
    assert built.returncode == 0, built.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Page]:
    found = {path: Page(path) for path in site.rglob("*.html") if path.name != "404.html"}
    assert len(found) == len(list(ROOT.glob("docs/**/*.md")))
    return found


def test_every_internal_link_leads_to_a_file_and_an_anchor_that_exist(
    pages: dict[Path, Page],
) -> None:
    broken, followed = [], 0
    for path, page in pages.items():
        for link in page.links:
            name, _, anchor = unquote(link).partition("#")
            if ":" in name:
                continue  # another site
            followed += 1
            target = (path.parent / name).resolve() if name else path
            is_whole = target.exists() and (
                not anchor or target not in pages or anchor in pages[target].anchors
            )
            if not is_whole:
                broken.append(f"{path.name}: {link}")
    assert broken == []
    assert followed > 1_000


def test_no_page_fetches_anything_from_the_network(pages: dict[Path, Page], site: Path) -> None:
    fetched = {source for page in pages.values() for source in page.fetched}
    assert fetched
    assert [source for source in fetched if "//" in source] == []
    styles = "".join(path.read_text() for path in site.rglob("*.css"))
    assert "url(http" not in styles
    assert "@import" not in styles
