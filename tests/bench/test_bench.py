import json
import math
import os
import re
from dataclasses import fields

import fastjsonschema
import numpy as np
import pytest
from scipy.fft import rfft

from audioflinger_hook.transform.principal import Principals
from tests.support import soak
from tests.support.bench_runs import LEAST
from tools import soak_record
from tools.bench import run as bench
from tools.bench.cost import in_ffts, interleaved, rfft_unit_s
from tools.bench.figures import pictures
from tools.bench.machine import MachineFacts
from tools.bench.measures import vibration as measures
from tools.bench.report import BenchReport, Missing, Must, Row, Section, number
from tools.bench.sections import mixing, scaling
from tools.bench.sounds.real_sounds import sounds_folder
from tools.bench.sounds.signals import tone
from tools.records import PROJECT_ROOT

RATE = 48_000

TOLD: list[tuple[str, float]] = []
"""What the progress callback of the report was told."""


@pytest.fixture(scope="module")
def report():
    return bench.run_bench(True, lambda label, share: TOLD.append((label, share)), effort=LEAST)


def a_report(*rows, missing=(), series=None):
    machine = MachineFacts("a processor", 2, "Linux", 0.5, "3.11", "2.0", "1.13", 7.5)
    section = Section("A section", "What it means.", rows, missing, series or {})
    return BenchReport("2026-01-01T00:00:00Z", True, 1.0, machine, (section,))


@pytest.mark.parametrize("frequency_hz", [21.5, 46.6, 103.737, 219.9])
def test_a_sine_is_found_with_its_frequency_amplitude_and_residual(frequency_hz):
    noise = 1e-4 * np.random.default_rng(0).standard_normal(2 * RATE)
    fit = measures.sine_fit(tone(frequency_hz, 0.3, 2.0) + noise, RATE)
    assert fit.frequency_hz == pytest.approx(frequency_hz, abs=1e-4)
    assert fit.amplitude == pytest.approx(0.3, rel=1e-4)
    # noise of 1e-4 r.m.s. under a sine of 0.3 peak
    assert fit.residual_db == pytest.approx(20 * math.log10(1e-4 * math.sqrt(2) / 0.3), abs=0.1)
    distorted = tone(frequency_hz, 0.5, 2.0) + tone(2 * frequency_hz, 0.005, 2.0)
    assert measures.sine_fit(distorted, RATE).residual_db == pytest.approx(-40.0, abs=0.05)
    assert measures.sine_fit(np.zeros(RATE), RATE).amplitude == 0.0


def test_a_later_onset_is_later_by_as_much_and_energy_above_a_corner_is_a_share():
    lags_s = []
    for delay_s in (0.0, 0.0371):
        start, vibration = round((0.3 + delay_s) * RATE), np.zeros(RATE)
        vibration[start : start + RATE // 4] = tone(100.0, 0.3, 0.25)
        lags_s.append(measures.onset_lag_s(vibration, RATE, 0.3))
    # the envelope's own rise takes a few milliseconds either way
    assert abs(lags_s[0]) < 0.005
    assert lags_s[1] - lags_s[0] == pytest.approx(0.0371, abs=0.001)
    assert math.isnan(measures.onset_lag_s(np.zeros(RATE), RATE, 0.3))
    vibration = tone(100.0, 1.0, 1.0) + tone(400.0, 0.01, 1.0)
    assert measures.energy_above_db(vibration, RATE) == pytest.approx(-40.0, abs=0.01)
    assert measures.energy_above_db(tone(100.0, 1.0, 1.0), RATE) < -200.0
    assert measures.energy_above_db(np.zeros(100), RATE) == -math.inf


def principals(*row_hz):
    row, hz = np.array(row_hz, dtype=float).reshape(-1, 2).T
    return Principals(row.astype(np.intp), hz, hz, hz, hz)


def test_agreement_counts_hits_within_reach_in_the_same_unit_only():
    found = principals((0, 100.0), (0, 500.0), (1, 300.0))
    wanted = principals((0, 103.0), (1, 500.0), (1, 306.0), (2, 100.0))
    assert measures.agreement(found, wanted, 5.0).tolist() == [1, 3, 1, 4]
    assert measures.agreement(principals(), wanted, 5.0).tolist() == [0, 0, 0, 4]


def test_the_exponent_is_one_for_linear_and_two_for_quadratic_cost():
    sizes = [1.0, 2.0, 4.0, 8.0]
    assert scaling.exponent(sizes, [3 * n for n in sizes]) == pytest.approx(1.0)
    assert scaling.exponent(sizes, [3 * n * n for n in sizes]) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("repeats", "rounds"), [([3, 3], ["ab"] * 4), ([4, 2, 1], ["abc", "a", "ab", "a", "abc"])]
)
def test_works_take_turns_after_a_round_that_does_not_count(repeats, rounds):
    order: list[str] = []
    works = [lambda name=name: order.append(name) for name in "abc"[: len(repeats)]]
    timings = interleaved(works, repeats)
    assert "".join(order) == "".join(rounds)
    assert [len(timing.seconds) for timing in timings] == repeats


@pytest.mark.exhaustive
def test_the_ffts_beside_a_cost_are_the_same_cost(report):
    section = report.section("Cost of a second of sound")
    # Denormal numbers of both widths are held against normal ones as weak.
    ratios = [row for row in section.rows if "over tiny" in row.name and row.column == "live"]
    assert len(ratios) == 4
    assert all(row.must and row.unit == "times" for row in ratios)
    by_place = {(row.name, row.column): row for row in section.rows}
    scenes = [row for row in section.rows if row.column == "live" and row.unit == "ms"]
    assert scenes
    for row in scenes:
        ffts = by_place[row.name, "live, FFTs"]
        unit_us = 1e3 * row.value / max(ffts.value, 1.0)
        # one repeat here, so the ratio is that of one pair; the machine may be busy
        assert report.machine.rfft_us / 4 < unit_us < report.machine.rfft_us * 6
        assert ffts.must == Must("<=", in_ffts(1e-3 * row.must.bound))


def test_what_has_to_be_done_before_a_work_is_done_before_each_run_of_it_and_not_timed():
    order: list[str] = []

    def slow() -> None:
        order.append("fill")
        rfft(np.zeros(1 << 18))

    (timing,) = interleaved([lambda: order.append("run")], 2, before=[slow])
    assert order == ["fill", "run"] * 3
    assert max(timing.seconds) < 1e-3


def test_costs_are_given_in_units_of_the_fft_timed_with_them():
    frames = np.zeros(2048, np.float32)
    (timing,) = interleaved([lambda: [rfft(frames) for _ in range(1_000)]], 5)
    # a thousand of them, a little more for the loop; the machine may be busy
    assert 400 < timing.median_units < 2_500
    assert rfft_unit_s() > 0.0


def test_met_is_computed_and_not_a_number_is_never_met():
    assert Row("a", 1.0, must=Must("<=", 1.0)).met is True
    assert Row("a", 1.1, must=Must("<=", 1.0)).met is False
    assert Row("a", 1.1, must=Must(">=", 1.0)).met is True
    assert Row("a", math.nan, must=Must("<=", 1.0)).met is False
    assert Row("a", 1.0).met is None


def test_numbers_have_three_digits_that_mean_something():
    values = (0.0, 12.0, 1_000_208.0, 0.000937, 2.5e-13, -56.086, 9.996, 1234.6, -math.inf)
    assert ", ".join(map(number, values)) == (
        "0, 12, 1 000 208, 0.000937, 2.5e-13, -56.1, 10.0, 1 235, -∞"
    )


def test_the_page_puts_columns_side_by_side_with_limit_and_verdict():
    page = a_report(
        Row("lag", 40.0, "ms", "live", Must("<=", 45.0), note="the worst"),
        Row("lag", 56.0, "ms", "reference"),
        Row("cost", 16.0, "ms", "live", Must("<=", 15.0), low=15.5, high=17.0),
    ).to_markdown()
    assert "| lag | 40 ms | 56 ms | ≤ 45 ms | met | the worst |" in page
    assert "| cost | 16 ms (15.5 to 17) |  | ≤ 15 ms | **not met** |  |" in page
    assert "1 of 2 limits met" in page
    assert "not met: A section: cost (live), 16 ms (15.5 to 17), must ≤ 15 ms" in page


def test_limits_of_time_that_are_met_in_ffts_stand_apart_from_faults():
    report = a_report(
        Row("slow", 16.0, "ms", "live", Must("<=", 15.0), ffts_column="live, FFTs"),
        Row("slow", 90.0, "FFTs", "live, FFTs", Must("<=", 100.0)),
        Row("dear", 17.0, "ms", "live", Must("<=", 15.0), ffts_column="live, FFTs"),
        Row("dear", 110.0, "FFTs", "live, FFTs", Must("<=", 100.0)),
        Row("wrong", 2.0, "dB", "live", Must("<=", 1.0)),
    )
    assert report.met_in_ffts == {"A section: slow (live)"}
    page = report.to_markdown()
    assert "1 of 5 limits met; of the other 4, 1 passes in FFTs." in page
    assert page.count("not met: A section: ") == 3
    assert "  - not met in ms, met in FFTs: A section: slow (live), 16 ms, must ≤ 15 ms" in page
    must = report.to_json()["must"]
    assert (must["met"], len(must["not_met"])) == (1, 4)
    assert must["met_in_ffts"] == ["A section: slow (live)"]


def test_the_json_document_has_exactly_the_fields_of_the_dataclasses():
    gone, row = Missing("a", "b", "c"), Row("leak", -math.inf, "dB", must=Must("<=", -50.0))
    document = a_report(row, missing=(gone,), series={"live": (1.0, math.nan)}).to_json()
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    head = {"schema", "date", "quick", "duration_s", "machine", "must", "sections"}
    assert set(document) == head
    assert set(document["machine"]) == {field.name for field in fields(MachineFacts)}
    (section,) = document["sections"]
    assert set(section) == {field.name for field in fields(Section)}
    (written,) = section["rows"]
    assert set(written) == {field.name for field in fields(Row)} | {"met"}
    assert written["value"] is None
    assert written["met"] is True
    assert written["must"] == {"relation": "<=", "bound": -50.0}
    assert section["missing"] == [{"name": "a", "reason": "b", "command": "c"}]
    assert section["series"] == {"live": [1.0, None]}


@pytest.mark.exhaustive
def test_a_limit_of_cpu_time_has_a_twin_in_ffts_on_its_line(report):
    named = 0
    for section in report.sections:
        for row in section.rows:
            is_cost = row.unit in ("µs", "x real time") or "x real time" in row.column
            is_cost |= section.title in ("Cost of a second of sound", "Cost after pauses")
            if row.must and is_cost and row.unit not in ("FFTs", "times"):
                assert row.ffts_column, (section.title, row)
            if row.ffts_column:
                line = [each for each in section.rows if each.name == row.name]
                (twin,) = (each for each in line if each.column == row.ffts_column)
                assert twin.unit == "FFTs", (section.title, row)
                assert bool(row.must) == bool(twin.must), (section.title, row)
                assert not twin.must or twin.must.relation == "<="
                named += 1
    assert named > 12


@pytest.mark.exhaustive
def test_every_bench_gives_rows_that_stand_in_whole_tables_under_what_they_mean(report):
    page = report.to_markdown()
    assert len(report.sections) == len(bench.BENCHES)
    for section in report.sections:
        assert section.rows or section.missing, section.title
        assert section.explanation.endswith(".")
        assert page.count(f"## {section.title}\n") == 1
        for name in {row.name for row in section.rows}:
            assert page.count(f"\n| {name} |") >= 1, name
    tables = re.findall(r"(?:^\|.*\n)+", page, re.MULTILINE)
    assert tables
    for table in tables:  # as many cells in every line as in the heading
        assert len({line.count("|") for line in table.splitlines()}) == 1
    assert "measures or computes all" in page
    schema = json.loads((PROJECT_ROOT / "tools/bench/report.schema.json").read_text())
    fastjsonschema.validate(schema, json.loads(json.dumps(report.to_json(), allow_nan=False)))
    shares = [share for _, share in TOLD]
    assert shares[0] == 0.0
    assert shares == sorted(shares)
    assert TOLD[-1] == ("done", 1.0)


@pytest.mark.parametrize(("tracks", "samplerate"), [(1, RATE), (8, RATE), (3, 44_100)])
def test_every_timed_cycle_mixes_every_track(tracks, samplerate):
    bank = mixing.TrackBank(tracks, samplerate)
    assert bank.frames == 960
    for _ in range(4):
        bank.fill()
        assert bank.run() == tracks * mixing.CYCLES_AT_ONCE


@pytest.mark.exhaustive
def test_the_mixer_s_rows_agree_with_one_another(report):
    section = report.section("The mixer")
    by_name = {(row.name, row.column): row.value for row in section.rows}
    counts = ("1 track", "8 tracks", "32 tracks")
    us = [by_name[f"{count} of 48 kHz", mixing.TIME] for count in counts]
    assert us == sorted(us)
    (growth,) = (row for row in section.rows if row.must)
    assert growth.value == pytest.approx((us[2] - us[1]) / 24 / ((us[1] - us[0]) / 7))


@pytest.mark.exhaustive
def test_a_short_soak_of_the_scene_counts_hops_and_memory():
    record = soak.soak_scene(hops=500)
    assert (record.hops or 0) >= 500
    assert record.memory_growth_kb is not None


def test_a_short_soak_finds_the_tone_the_same_and_its_record_keeps_the_latest_of_each(tmp_path):
    record = soak.soak_tone(hops=900)
    assert record.passed
    assert (record.hops or 0) >= 900
    assert (record.thdn_end_db or 0.0) <= -60.0
    path = tmp_path / "docs" / "soak.json"
    assert soak_record.read_records(path) == ()
    other = soak_record.SoakRecord("another", "2026-01-01", "cpu", 1.0, 1.0, False, hops=1)
    for kept in (other, record, record):
        soak_record.keep_record(kept, path)
    assert set(soak_record.read_records(path)) == {other, record}
    assert [entry.name for entry in path.parent.iterdir()] == ["soak.json"]


@pytest.mark.exhaustive
def test_the_plots_are_pictures(report, tmp_path):
    if os.environ.get("CI") != "true":
        pytest.importorskip("matplotlib")
    paths = pictures.draw_all(report, tmp_path)
    names = ["cost", "lag", "frontier", "baselines", "models", "damping"]
    if sounds_folder():
        names.append("real_sounds")
    assert sorted(path.name for path in paths) == sorted(f"{name}.png" for name in names)
    for path in paths:
        content = path.read_bytes()
        assert content.startswith(b"\x89PNG")
        assert len(content) < 100_000  # they are kept with the documentation
