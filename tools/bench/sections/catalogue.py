"""Section "Catalogue": speed of rendering many files, by format and by length of the files."""

from __future__ import annotations

import pickle
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from audioflinger_hook.catalogue.manifest import Manifest
from audioflinger_hook.catalogue.recipe import Recipe
from audioflinger_hook.catalogue.run import Run
from audioflinger_hook.catalogue.timing import Timing
from audioflinger_hook.catalogue.work import do_batch, open_sound
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.exports.options import FORMATS, ExportOptions
from audioflinger_hook.offline.batch import LocalWorkers, Place, usable_cores
from tools.bench.report import Missing, Must, Row, Section
from tools.bench.sections.rendering import write_sound
from tools.bench.workbench import Workbench

TIMING = Timing(time.perf_counter, time.sleep)
LOW_RATE_HZ = 1_000
TWO_WORKERS = Must(">=", 1.8)
A_SKIP_MS = Must("<=", 2.0)
SKIPPED = 500
SHORT_S = 1.0
COUNTS = {1.0: 20, 60.0: 2}  # number of rendered files of each length; one file of other lengths
LONGEST_TIMED_S = 40.0  # largest CPU time in s for which a format is timed


def catalogue(bench: Workbench) -> Section:
    """Measure the speed of `cushion catalogue` by format, file length and number of workers."""
    rows: list[Row] = []
    missing: list[Missing] = []
    with tempfile.TemporaryDirectory(prefix="cushion-bench-") as folder:
        root = Path(folder)
        costs: dict[str, float] = {}
        for length_s in bench.effort.catalogue_s:
            library = _library(root, length_s, COUNTS.get(length_s, 1))
            rows += _by_format(library, length_s, costs)
        if usable_cores() >= 2:
            rows.append(_two_workers(_library(root / "two", *bench.effort.catalogue_shared)))
        else:
            missing.append(Missing("two workers", "there is one core", "make bench on two cores"))
        rows.append(_skipped(_library(root / "done", SHORT_S, 1), root))
    return Section(
        "Catalogue",
        "`cushion catalogue` renders files with the repeated demo scene, 48 kHz stereo, 16 bit, "
        "with the live form. The table shows how many hours of sound one core renders in an hour "
        "of CPU time, for each format and duration of the files. The CPU time includes writing "
        "the JSON record of each file, but not the start of the process. The column *reading "
        "alone* shows the throughput of reading without rendering. If a format would take over "
        f"{LONGEST_TIMED_S:g} s of CPU time for files of one duration, it is not measured for "
        "this duration (*as before*). The row *two workers* shows the throughput of two workers "
        "relative to one, by wall time. The row *a done item* shows the CPU time of the check "
        "that an item is finished.",
        tuple(rows),
        tuple(missing),
    )


def _library(folder: Path, length_s: float, count: int) -> Path:
    target = folder / f"{length_s:g}"
    target.mkdir(parents=True)
    write_sound(target / "0.wav", length_s)
    for number in range(1, count):
        (target / f"{number}.wav").hardlink_to(target / "0.wav")
    return target


def _options() -> dict[str, ExportOptions]:
    waveforms = {
        "wav": ExportOptions("wav"),
        "wav, 1 kHz": ExportOptions("wav", LOW_RATE_HZ),
        "flac, 1 kHz": ExportOptions("flac", LOW_RATE_HZ),
    }
    others = {name: ExportOptions(name) for name in FORMATS if name not in ("wav", "flac")}
    return waveforms | others


def _by_format(library: Path, length_s: float, costs: dict[str, float]) -> list[Row]:
    """Return the hours of sound that are rendered in an hour of CPU time, for each format.

    costs: CPU time for one second of sound, by format; the function updates it.
    """
    name = f"{length_s:g} s" if length_s < 60.0 else f"{length_s / 60.0:g} min"
    sources = sorted(library.iterdir())
    recipe = Recipe("", Settings(), ExportOptions("wav"))
    items = list(Manifest(str(library), "/dev/null").items())
    start_s = time.process_time()
    for source, item in zip(sources, items, strict=True):
        tap = open_sound(source, item, recipe)
        while tap.read() is not None:
            pass
        tap.close()
    reading_s = time.process_time() - start_s
    rows = [Row(name, round(len(items) * length_s / reading_s), "", "reading alone")]
    for column, options in _options().items():
        if costs.get(column, 0.0) * length_s > LONGEST_TIMED_S:
            rows.append(Row(name, None, "", column, note="as before"))
            continue
        with tempfile.TemporaryDirectory(dir=library.parent) as out:
            spent_s, why = _core_seconds(library, Path(out), options)
        costs[column] = spent_s / (len(items) * length_s)
        value = round(len(items) * length_s / spent_s) if not why else None
        rows.append(Row(name, value, "", column, note=why))
    return rows


def _core_seconds(library: Path, out: Path, options: ExportOptions) -> tuple[float, str]:
    items = list(Manifest(str(library), str(out)).items())
    warm = pickle.dumps(Recipe(str(out / "warm"), Settings(), options))
    (out / "warm").mkdir()
    if len(items) > 1:  # the first item includes the design of filters
        do_batch(warm, items[:1], TIMING)
    recipe = pickle.dumps(Recipe(str(out), Settings(), options))
    start_s = time.process_time()
    outcomes = do_batch(recipe, items, TIMING)
    spent_s = time.process_time() - start_s
    errors = [outcome.error for outcome in outcomes if outcome.error]
    return spent_s, "too long" if errors else ""


def _two_workers(library: Path) -> Row:
    ratios = []
    with LocalWorkers(1, do_batch.__module__) as one, LocalWorkers(2, do_batch.__module__) as two:
        for place in (one, two):  # the first run includes the workers' imports
            _wall_s(library, place)
        for _ in range(3):
            single_s, double_s = _wall_s(library, one), _wall_s(library, two)
            ratios.append(single_s / double_s)
    return Row("two workers", _middle(ratios), "", "ratio", TWO_WORKERS, min(ratios), max(ratios))


def _wall_s(library: Path, place: Place) -> float:
    with tempfile.TemporaryDirectory(dir=library.parent) as out:
        recipe = Recipe(out, Settings(), ExportOptions("wav", LOW_RATE_HZ))
        items = Manifest(str(library), out).items()
        start_s = time.perf_counter()
        for batch in Run(recipe, items, place, TIMING).outcomes():
            assert not any(outcome.error for outcome in batch), batch
        return time.perf_counter() - start_s


def _skipped(library: Path, root: Path) -> Row:
    out = root / "done" / "out"
    out.mkdir()
    recipe = pickle.dumps(Recipe(str(out), Settings(), ExportOptions("wav", LOW_RATE_HZ)))
    (item,) = Manifest(str(library), str(out)).items()
    do_batch(recipe, [item], TIMING)
    start_s = time.process_time()
    outcomes = do_batch(recipe, [item] * SKIPPED, TIMING)
    spent_s = time.process_time() - start_s
    assert all(outcome.state == "skipped" for outcome in outcomes)
    return Row("a done item", 1e3 * spent_s / SKIPPED, "ms", "CPU time", A_SKIP_MS)


def _middle(found: Sequence[float]) -> float:
    return sorted(found)[len(found) // 2]
