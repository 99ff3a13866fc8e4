"""The site of docs/: it builds without warnings, as of broken links, and it fetches nothing."""

import subprocess
import sys
from html.parser import HTMLParser
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.exhaustive


class Fetched(HTMLParser):
    def __init__(self, path: Path) -> None:
        super().__init__()
        self.sources: list[str] = []
        self.feed(path.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = {name: value or "" for name, value in attrs}
        if tag == "link" and found.get("rel") not in ("canonical", "prev", "next"):
            self.sources.append(found["href"])
        elif "src" in found:
            self.sources.append(found["src"])


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
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


def test_no_page_fetches_anything_from_the_network(site: Path) -> None:
    pages = [path for path in site.rglob("*.html") if path.name != "404.html"]
    assert len(pages) == len(list(ROOT.glob("docs/**/*.md")))
    fetched = {source for path in pages for source in Fetched(path).sources}
    assert fetched
    assert [source for source in fetched if "//" in source] == []
    styles = "".join(path.read_text() for path in site.rglob("*.css"))
    assert "url(http" not in styles
    assert "@import" not in styles
