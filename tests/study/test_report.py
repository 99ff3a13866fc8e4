"""From `new` to the report; what is simulated says so, and tables can be read by others."""

import csv
import json

import pytest

from audioflinger_hook.study.records import columns
from tests.support.commands import call, document
from tests.support.data import table
from tests.support.studies import QUESTIONS, TRUTHS, make_study
from tests.support.trials import PLAYED

PLAYED_COLUMNS = (*vars(PLAYED), "vibration_sha256", "weighted_db")
DESIGNS = ("cinema", "delay", "identify")


@pytest.mark.parametrize("design", DESIGNS)
def test_a_built_in_design_goes_from_new_to_the_report(tmp_path, design):
    study = tmp_path / "first"
    assert call("study", "new", study, "--design", design).code == 0
    checked = call("study", "check", study, "--no-power", "--json")
    told = json.loads(checked.stdout)
    assert (checked.code, checked.stderr) == (0, "")
    assert (
        json.loads((study / "preregistration.json").read_text())["sha256"]["design.toml"]
        == told["sha256"]
    )
    people = json.loads((study / "people.json").read_text()) | {"people": 6}
    (study / "few.json").write_text(json.dumps(people))
    assert call("study", "run", study, "--simulate", study / "few.json").code == 0
    assert call("study", "report", study).code == 0
    page = (study / "report.html").read_text()
    assert '"simulated": true' in page
    assert told["sha256"] in page
    again = call("study", "new", study)
    assert (again.code, "name a new folder" in again.stderr) == (2, True)


def test_the_report_has_every_question_and_the_table_every_column_of_the_codebook(tmp_path):
    make_study(tmp_path, *QUESTIONS, participants=4, more="reference_share = 1")
    people = tmp_path / "people.json"
    people.write_text(json.dumps({"people": 4, "questions": TRUTHS}))
    assert call("study", "run", tmp_path, "--simulate", people).code == 0
    with (tmp_path / "data/trials.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == list(columns())
    filled = {name for row in rows for name, value in row.items() if value}
    assert {name for name in columns() if name not in filled} <= {
        *("excluded", *(f"{name}_{i}" for name in PLAYED_COLUMNS for i in (1, 2))),
    }
    found = document("study", "report", tmp_path)["questions"]
    assert list(found) == list(QUESTIONS)
    for question in found.values():
        for one in question["estimates"].values():
            assert one["low"] <= one["value"] <= one["high"]


def test_who_rates_the_hidden_reference_low_is_excluded(tmp_path):
    make_study(tmp_path, "rating", participants=3)
    people = tmp_path / "people.json"
    people.write_text(json.dumps({"people": 3, "questions": {"rating": {"rating": {"a": 60}}}}))
    assert call("study", "run", tmp_path, "--simulate", people).code == 0
    done = call("study", "report", tmp_path)
    assert done.code == 2
    assert "rated the hidden reference under 90" in done.stderr


@pytest.mark.parametrize(
    ("content", "words"),
    table("people-mistakes.toml")["mistakes"],
)
def test_a_mistake_in_the_simulated_people_is_told(tmp_path, content, words):
    make_study(tmp_path, "preference")
    (tmp_path / "people.json").write_text(content)
    done = call("study", "run", tmp_path, "--simulate", tmp_path / "people.json")
    assert (done.code, words in done.stderr) == (2, True), done


def test_an_unknown_built_in_design_makes_no_folder(tmp_path):
    done = call("study", "new", tmp_path / "s", "--design", "cinma")
    assert (done.code, "did you mean cinema?" in done.stderr) == (2, True)
    assert not (tmp_path / "s").exists()


def test_nobody_took_part_is_said(tmp_path):
    make_study(tmp_path, "preference")
    done = call("study", "report", tmp_path)
    assert (done.code, "nobody began" in done.stderr) == (2, True)
