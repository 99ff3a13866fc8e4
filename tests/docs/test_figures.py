"""Figures that the pages repeat are those of the benchmarks."""

import json
from pathlib import Path

import pytest

from tools.docs.__main__ import ROOT
from tools.docs.figures import SENTENCES, Benchmarks, corrected, figures


def test_every_figure_is_said_somewhere_and_corrected_wherever_its_line_breaks() -> None:
    said = " ".join(sentence for sentences in SENTENCES.values() for sentence in sentences)
    assert [name for name in figures(Benchmarks()) if f"{{{name}}}" not in said] == []
    text = "It is quick: 7 ms\nlate, 1.5 % of\na core. It is 7 ms late elsewhere, too.\n"
    found = corrected("page", text, ("quick: {a} ms late, {b} % of a",), {"a": "12", "b": "-0.2"})
    assert found == text.replace("quick: 7", "quick: 12").replace("1.5", "-0.2")


@pytest.mark.parametrize("text", ["It is fast.", "It is 7 ms late. It is 8 ms late."])
def test_a_sentence_that_a_page_says_never_or_twice_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"page says 'is \{a\} ms late'"):
        corrected("page", text, ("is {a} ms late",), {"a": "9"})


def test_another_measurement_changes_the_figure(tmp_path: Path) -> None:
    document = json.loads((ROOT / "docs/benchmarks.json").read_text())
    [row] = [
        row
        for section in document["sections"]
        for row in section["rows"]
        if (section["title"], row["name"], row["column"])
        == ("Steady tones", "worst THD+N, 150 to 11000 Hz", "live")
    ]
    row["value"] = -71.9
    path = tmp_path / "benchmarks.json"
    path.write_text(json.dumps(document))
    assert figures(Benchmarks(path)) == {**figures(Benchmarks()), "thdn_db": "-71"}
