"""The bench where something is not there: what, in every section, and an exit code that tells."""

import csv
import json

import fastjsonschema
import pytest

from tests.support.bench_runs import a_bench, bench_command
from tests.support.commands import noise, sound
from tests.support.recordings import require_recordings
from tools.bench import run as bench
from tools.bench import workbench
from tools.bench.machine import machine_facts
from tools.bench.report import BenchReport, Missing, Must, Row, Section
from tools.bench.sections import comparison, fidelity, kept_records, speed
from tools.bench.sounds.signals import (
    KNOWN,
    RECORDINGS_VARIABLE,
    cost_scenes,
    examine_recordings,
)
from tools.bench.workbench import LIVE, QUICK
from tools.records import PROJECT_ROOT

SCHEMA = json.loads((PROJECT_ROOT / "tools/bench/report.schema.json").read_text())


def a_report(*sections):
    return BenchReport("2026-01-01T00:00:00Z", True, 1.0, machine_facts(), sections)


@pytest.fixture
def short_scenes(monkeypatch):
    """Only scenes of the length that is asked for: the demo scene is always whole."""

    def short(duration_s, recordings):
        scenes = cost_scenes(duration_s, recordings)
        del scenes["demo scene"]
        return scenes

    monkeypatch.setattr(speed, "cost_scenes", short)


def ran(monkeypatch, tmp_path, *benches, options=()):
    """Run the command with these benches, as a user without a report to replace does."""
    monkeypatch.setattr(bench, "BENCHES", tuple((name, each, 1.0) for name, each in benches))
    monkeypatch.chdir(tmp_path)
    out = [] if "--json" in options else ["--out", tmp_path / "report.md"]
    return bench_command("--quick", *out, *options)


def fine(_):
    return Section("Fine", "It works.", (Row("one", 1.0),))


def broken(_):
    raise ValueError("the ground\nis gone")


# ------------------------------------------------------------------------------------- the schema


@pytest.mark.exhaustive
def test_a_real_report_is_what_the_schema_says(short_scenes):
    measures = [each for name, each, _ in bench.BENCHES if name in TAKEN]
    found, absent = examine_recordings()
    sections = tuple(each(a_bench(found, absent)) for each in measures)
    assert len(sections) == len(TAKEN)
    document = json.loads(json.dumps(a_report(*sections).to_json()))
    fastjsonschema.validate(SCHEMA, document)
    assert SCHEMA["properties"]["schema"]["const"] == document["schema"]


TAKEN = (
    "recordings",
    "onset lag",
    "cost of a second",
    "worst hop",
    "baselines",
    "model selection",
    "live latency",
    "soak",
    "soak of the rig",
    "soak of the identification",
)
"""Sections with every kind of row: limits, spreads, notes, series, footnotes, absent values."""


@pytest.mark.parametrize(
    "spoil",
    [
        lambda document: document.pop("machine"),
        lambda document: document.update(schema=2),
        lambda document: document.update(duration_s="long"),
        lambda document: document["sections"][0].pop("missing"),
        lambda document: document["sections"][0]["rows"][0].update(value="much"),
        lambda document: document["sections"][0]["rows"][0].update(must={"relation": "<"}),
        lambda document: document["sections"][0]["missing"].append({"name": "x"}),
        lambda document: document["sections"].clear(),
    ],
)
def test_the_schema_refuses_what_is_no_report(spoil):
    document = json.loads(json.dumps(a_report(fine(None)).to_json()))
    fastjsonschema.validate(SCHEMA, document)
    spoil(document)
    with pytest.raises(fastjsonschema.JsonSchemaException):
        fastjsonschema.validate(SCHEMA, document)


# ------------------------------------------------------------------------------- a missing anything


def test_a_bench_that_fails_is_named_and_the_others_are_printed(monkeypatch, tmp_path):
    done = ran(monkeypatch, tmp_path, ("what fails", broken), ("what works", fine))
    assert done.code == 2
    row, error = done.stderr.splitlines()
    assert "every row of what fails" in row
    assert "ValueError: the ground is gone" in row
    assert "1 row could not be measured, so no report was written" in error
    assert "| one | 1 |" in done.stdout
    assert not (tmp_path / "report.md").exists()


def test_json_with_something_missing_is_still_one_document_by_the_schema(monkeypatch, tmp_path):
    benches = [("what fails", broken), ("what works", fine)]
    done = ran(monkeypatch, tmp_path, *benches, options=["--json"])
    assert done.code == 2
    assert list(tmp_path.iterdir()) == []
    document = json.loads(done.stdout)
    fastjsonschema.validate(SCHEMA, document)
    assert [len(section["missing"]) for section in document["sections"]] == [1, 0]


def test_what_is_missing_is_a_line_of_its_table(monkeypatch, tmp_path):
    def partly(_):
        gone = Missing("two", "it is gone", "fetch it")
        row = Row("one", 1.0, must=Must("<=", 2.0))
        return Section("Partly", "Some of it.", (row,), (gone,))

    done = ran(monkeypatch, tmp_path, ("part", partly))
    assert done.code == 2
    assert "| one | 1 | ≤ 2 | met |\n| two | **missing** |  |  |\n" in done.stdout


# ------------------------------------------------------------------------------------- recordings


@pytest.fixture
def folder(monkeypatch, tmp_path):
    """A folder that holds every recording, as short ones of ours."""
    for name in KNOWN:
        path = tmp_path / "recordings" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".wav":
            sound(path, noise(20_000))
        else:
            sound(path, noise(20_000), format="OGG", subtype="VORBIS")
    monkeypatch.setenv(RECORDINGS_VARIABLE, str(tmp_path / "recordings"))
    return tmp_path / "recordings"


def test_with_every_recording_nothing_is_missing(folder):
    found, absent = examine_recordings()
    assert (len(found), absent) == (len(KNOWN), {})
    section = fidelity.recordings(a_bench(found, absent))
    assert section.missing == ()
    assert section.rows[0].value == len(KNOWN)


def test_the_list_of_recordings_is_what_is_fetched():
    folder = require_recordings()[0].parents[1]
    there = {f"{path.parent.name}/{path.name}" for path in folder.glob("*/*")}
    assert there == set(KNOWN)


def test_a_recording_that_is_gone_or_no_sound_is_named(folder):
    (folder / KNOWN[0]).unlink()
    (folder / KNOWN[-1]).write_text("no sound")
    found, absent = examine_recordings()
    assert len(found) == len(KNOWN) - 2
    assert set(absent) == {KNOWN[0], KNOWN[-1]}
    section = fidelity.recordings(a_bench(found, absent))
    by_name = {gone.name: gone for gone in section.missing}
    assert "it is not in" in by_name[f"recording {KNOWN[0]}"].reason
    assert "it cannot be read" in by_name[f"recording {KNOWN[-1]}"].reason
    assert all("fetch_recordings.sh" in gone.command for gone in section.missing)


def test_the_command_tells_of_a_recording_that_is_gone(folder, monkeypatch, tmp_path):
    (folder / KNOWN[3]).unlink()
    done = ran(monkeypatch, tmp_path, ("recordings", fidelity.recordings))
    assert done.code == 2
    assert f"recording {KNOWN[3]}: it is not in" in done.stderr
    assert f"| recording {KNOWN[3]} | **missing** |" in done.stdout


def test_without_a_folder_every_section_on_recordings_says_so(monkeypatch, tmp_path):
    monkeypatch.setenv(RECORDINGS_VARIABLE, str(tmp_path / "none"))
    found, absent = examine_recordings()
    assert (found, absent) == ((), {})
    for each in (
        fidelity.recordings,
        fidelity.energy_above,
        fidelity.principal_frequencies,
        comparison.compared,
    ):
        missing = each(a_bench()).missing
        assert missing, each
        assert all("fetch_recordings.sh" in gone.command for gone in missing)


# --------------------------------------------------------------------------------------- records


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
    document = json.loads((PROJECT_ROOT / kept).read_text())
    whole = json.dumps(document)
    spoiled = [
        whole[: len(whole) // 2],
        "[]",
        "{}",
        '{"records": [1]}',
        '{"records": [{}]}',
        '{"records": []}',
        json.dumps({"records": [{**record, "cpu": 3} for record in document["records"]]}),
        json.dumps({"records": [{**record, "more": 3} for record in document["records"]]}),
        "",
        "\x00\xff",
    ]
    for field in ("hops", "samples", "rigs", "lag_median_ms", "lags_ms"):
        if any(field in record for record in document["records"]):
            records = [{**record, field: "many"} for record in document["records"]]
            spoiled.append(json.dumps({"records": records}))
    assert not result(a_bench()).rows
    for text in [None, *spoiled]:
        if text is not None:
            path.write_text(text)
        section = result(a_bench())
        assert section.rows == ()
        assert len(section.missing) == 1, text
        assert section.missing[0].reason
    path.write_text(whole)
    section = result(a_bench())
    assert section.missing == ()
    assert section.rows


# ------------------------------------------------------------------------------------- quick, full


def test_denormal_numbers_of_both_widths_are_held_against_normal_ones_as_weak(short_scenes):
    rows = speed.cost_of_a_second(a_bench()).rows
    ratios = [row for row in rows if "over tiny" in row.name and row.column == LIVE]
    assert len(ratios) == 4
    assert all(row.must and row.unit == "times" for row in ratios)


def test_a_quick_run_measures_no_row_less_than_a_full_one_but_for_the_long_rendering():
    assert QUICK.render_s == workbench.FULL.render_s[:1]
    for name in vars(QUICK):
        assert getattr(QUICK, name) <= getattr(workbench.FULL, name), name
    assert QUICK.hops_timed >= 1_000  # else no 99.9th percentile


def test_a_report_that_cannot_be_written_is_refused_before_anything_is_measured(
    monkeypatch, tmp_path
):
    monkeypatch.setattr(bench, "BENCHES", (("broken", broken, 1.0),))
    done = bench_command("--out", tmp_path)
    assert (done.code, done.stdout) == (2, "")
    (error,) = done.stderr.splitlines()
    assert error.startswith("bench: error: ")
    assert "it is a folder" in error
    assert list(tmp_path.iterdir()) == []


def test_json_writes_no_file(monkeypatch, tmp_path):
    done = ran(monkeypatch, tmp_path, ("what works", fine), options=["--json"])
    assert (done.code, done.stderr) == (0, "")
    assert json.loads(done.stdout)["sections"][0]["title"] == "Fine"
    assert list(tmp_path.iterdir()) == []
    for option in ("--out", "--plots", "--tables"):
        assert bench_command("--json", option, tmp_path / "new").code == 2
    assert list(tmp_path.iterdir()) == []


def test_the_tables_hold_every_row_as_json_and_as_csv(monkeypatch, tmp_path):
    done = ran(
        monkeypatch, tmp_path, ("what works", fine), options=["--tables", tmp_path / "tables"]
    )
    assert done.code == 0
    report = json.loads((tmp_path / "tables.json").read_text())
    (section,) = report["sections"]
    with (tmp_path / "tables.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == len(section["rows"]) >= 1
    for line, row in zip(lines, section["rows"], strict=True):
        assert (line["section"], line["row"]) == (section["title"], row["name"])
        assert float(line["value"] or "nan") == pytest.approx(row["value"] or 0.0, rel=1e-5)
        assert line["met"] == {None: "", True: "yes", False: "no"}[row["met"]]


def test_tables_without_a_folder_are_refused_before_anything_is_measured(monkeypatch, tmp_path):
    monkeypatch.setattr(bench, "BENCHES", (("broken", broken, 1.0),))
    done = bench_command("--tables", tmp_path / "none" / "tables")
    assert (done.code, done.stdout) == (2, "")
    assert "does not exist" in done.stderr
