import csv
import json
import os
import sys
from typing import Any

import fastjsonschema
import pytest

from tests.support.bench_runs import a_bench, bench_command, broken, fine, run_benches
from tests.support.commands import noise, sound
from tests.support.recordings import require_recordings
from tools.bench import workbench
from tools.bench.figures.pictures import PICTURES, shown_in
from tools.bench.machine import machine_facts
from tools.bench.report import BenchReport, Missing, Must, Row, Section
from tools.bench.sections import comparison, fidelity, kept_records, savings, speed
from tools.bench.sounds.signals import KNOWN, RECORDINGS_VARIABLE, examine_recordings
from tools.bench.workbench import QUICK
from tools.records import PROJECT_ROOT

SCHEMA = json.loads((PROJECT_ROOT / "tools/bench/report.schema.json").read_text())


def partly(_):
    row = Row("one", 1.0, must=Must("<=", 2.0))
    return Section("Partly", "Some of it.", (row,), (Missing("two", "it is gone", "fetch it"),))


@pytest.mark.parametrize(
    "spoil",
    [
        lambda report, section: report.pop("machine"),
        lambda report, section: report.update(schema=2),
        lambda report, section: report.update(duration_s="long"),
        lambda report, section: report["sections"].clear(),
        lambda report, section: section.pop("missing"),
        lambda report, section: section["rows"][0].update(value="much"),
        lambda report, section: section["rows"][0].update(must={"relation": "<"}),
        lambda report, section: section["missing"].append({"name": "x"}),
    ],
)
def test_the_schema_refuses_what_is_no_report(spoil):
    whole = BenchReport("2026-01-01T00:00:00Z", True, 1.0, machine_facts(), (fine(None),))
    report = json.loads(json.dumps(whole.to_json()))
    fastjsonschema.validate(SCHEMA, report)
    spoil(report, report["sections"][0])
    with pytest.raises(fastjsonschema.JsonSchemaException):
        fastjsonschema.validate(SCHEMA, report)


def test_what_is_missing_is_named_and_the_rest_is_printed(monkeypatch, tmp_path):
    page = tmp_path / "report.md"
    run = run_benches(monkeypatch, "--out", page, broken=broken, works=fine, part=partly)
    assert run.code == 2
    *rows, error = run.stderr.splitlines()
    assert "every row of broken: its bench failed (ValueError: the ground is gone)" in rows[0]
    assert "2 rows could not be measured, so no report was written" in error
    assert "| one | 1 |" in run.stdout
    assert "| one | 1 | ≤ 2 | met |\n| two | **missing** |  |  |\n" in run.stdout
    assert "Not measured: two: it is gone" in run.stdout
    assert "fetch it" in run.stdout
    assert not page.exists()


@pytest.fixture
def folder(monkeypatch, tmp_path):
    """A folder that holds every recording, as short ones of ours."""
    for name in KNOWN:
        path = tmp_path / "recordings" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        ogg: Any = {} if path.suffix == ".wav" else {"format": "OGG", "subtype": "VORBIS"}
        sound(path, noise(20_000), **ogg)
    monkeypatch.setenv(RECORDINGS_VARIABLE, str(tmp_path / "recordings"))
    return tmp_path / "recordings"


def test_the_list_of_recordings_is_what_is_fetched():
    folder = require_recordings()[0].parents[1]
    there = {f"{path.parent.name}/{path.name}" for path in folder.glob("*/*")}
    assert there == set(KNOWN)


def test_a_recording_that_is_gone_or_no_sound_is_named(folder):
    found, absent = examine_recordings()
    assert (len(found), absent) == (len(KNOWN), {})
    section = fidelity.recordings(a_bench(found, absent))
    assert (section.missing, section.rows[0].value) == ((), len(KNOWN))
    (folder / KNOWN[0]).unlink()
    (folder / KNOWN[-1]).write_text("no sound")
    found, absent = examine_recordings()
    assert (len(found), set(absent)) == (len(KNOWN) - 2, {KNOWN[0], KNOWN[-1]})
    section = fidelity.recordings(a_bench(found, absent))
    by_name = {gone.name: gone for gone in section.missing}
    assert "it is not in" in by_name[f"recording {KNOWN[0]}"].reason
    assert "it cannot be read" in by_name[f"recording {KNOWN[-1]}"].reason
    assert all("fetch_recordings.sh" in gone.command for gone in section.missing)


@pytest.mark.parametrize(
    "measure",
    [
        fidelity.recordings,
        fidelity.energy_above,
        fidelity.principal_frequencies,
        pytest.param(comparison.compared, marks=pytest.mark.exhaustive),
        pytest.param(speed.cost_of_a_second, marks=pytest.mark.exhaustive),
        pytest.param(savings.savings, marks=pytest.mark.exhaustive),
    ],
)
def test_without_a_folder_every_section_on_recordings_says_so(monkeypatch, tmp_path, measure):
    monkeypatch.setenv(RECORDINGS_VARIABLE, str(tmp_path / "none"))
    assert examine_recordings() == ((), {})
    missing = measure(a_bench()).missing
    assert missing
    assert all("fetch_recordings.sh" in gone.command for gone in missing)


@pytest.mark.parametrize(
    ("result", "kept"),
    [
        (kept_records.live_latency, "docs/live.json"),
        (kept_records.transform_soak, "docs/soak.json"),
        (kept_records.rig_soak, "docs/soak.json"),
        (kept_records.identification_soak, "docs/soak.json"),
    ],
)
def test_a_record_that_is_gone_empty_or_spoiled_is_named(monkeypatch, tmp_path, result, kept):
    path = tmp_path / "record.json"
    monkeypatch.setattr(kept_records, "record_path", lambda _: path)
    (gone,) = result(a_bench()).missing
    assert "never run" in gone.reason
    records = json.loads((PROJECT_ROOT / kept).read_text())["records"]
    whole = json.dumps({"records": records})
    spoiled = [whole[: len(whole) // 2], "[]", "{}", "", "\x00\xff"]
    spoiled += [json.dumps({"records": bad}) for bad in ([1], list[Any]([{}]), [])]
    for field in ("cpu", "more", "hops", "samples", "rigs", "lag_median_ms", "lags_ms"):
        if field in ("cpu", "more") or any(field in record for record in records):
            wrong = 3 if field in ("cpu", "more") else "many"
            spoiled.append(json.dumps({"records": [{**one, field: wrong} for one in records]}))
    for text in spoiled:
        path.write_text(text)
        section = result(a_bench())
        assert section.rows == ()
        assert len(section.missing) == 1, text
        assert section.missing[0].reason
    path.write_text(whole)
    section = result(a_bench())
    assert section.missing == ()
    assert section.rows


def test_a_quick_run_measures_no_row_less_than_a_full_one_but_for_the_long_rendering():
    assert QUICK.render_s == workbench.FULL.render_s[:1]
    for name in vars(QUICK):
        assert getattr(QUICK, name) <= getattr(workbench.FULL, name), name
    assert QUICK.hops_timed >= 1_000  # else no 99.9th percentile


@pytest.mark.parametrize(
    ("option", "path", "words"),
    [("--out", ".", "it is a folder"), ("--tables", "none/tables", "does not exist")],
)
def test_a_file_that_cannot_be_written_is_refused_before_anything_is_measured(
    monkeypatch, tmp_path, option, path, words
):
    done = run_benches(monkeypatch, option, tmp_path / path, broken=broken)
    assert (done.code, done.stdout) == (2, "")
    (error,) = done.stderr.splitlines()
    assert error.startswith("bench: error: ")
    assert words in error
    assert list(tmp_path.iterdir()) == []


def test_json_is_one_document_by_the_schema_even_if_something_is_missing_and_no_file(
    monkeypatch, tmp_path
):
    monkeypatch.chdir(tmp_path)
    for benches, code in (({"works": fine}, 0), ({"broken": broken, "works": fine}, 2)):
        done = run_benches(monkeypatch, "--json", **benches)
        assert (done.code, not done.stderr) == (code, not code)
        report = json.loads(done.stdout)
        fastjsonschema.validate(SCHEMA, report)
        missing = [len(section["missing"]) for section in report["sections"]]
        assert missing == [1] * bool(code) + [0]
    assert report["sections"][-1]["title"] == "Fine"
    for option in ("--out", "--plots", "--tables"):
        assert bench_command("--json", option, tmp_path / "new").code == 2
    assert list(tmp_path.iterdir()) == []


def test_the_tables_hold_every_row_as_json_and_as_csv(monkeypatch, tmp_path):
    tables = ("--tables", tmp_path / "tables")
    assert run_benches(monkeypatch, "--out", tmp_path / "page.md", *tables, works=fine).code == 0
    (section,) = json.loads((tmp_path / "tables.json").read_text())["sections"]
    with (tmp_path / "tables.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == len(section["rows"]) >= 1
    for line, row in zip(lines, section["rows"], strict=True):
        assert (line["section"], line["row"]) == (section["title"], row["name"])
        assert float(line["value"] or "nan") == pytest.approx(row["value"] or 0.0, rel=1e-5)
        assert line["met"] == {None: "", True: "yes", False: "no"}[row["met"]]


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
