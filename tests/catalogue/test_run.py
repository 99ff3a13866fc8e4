import errno
import json
import os
import shutil
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from audioflinger_hook.catalogue import recipe as recipes
from audioflinger_hook.catalogue import storage, work
from audioflinger_hook.catalogue.timing import StorageError
from audioflinger_hook.exports.options import FORMATS
from tests.support.catalogues import LOW_RATE, library, manifest, record, results, rows
from tests.support.commands import call, noise, refused, sound, start, vibration
from tests.support.data import table
from tests.support.programs import printed


@pytest.fixture(scope="module")
def sounds(tmp_path_factory):
    return library(tmp_path_factory.mktemp("library") / "in", 6)


@pytest.fixture(scope="module")
def expected(sounds, tmp_path_factory):
    folder = tmp_path_factory.mktemp("alone")
    return {source.name: rendered_alone(folder, source) for source in sorted(sounds.iterdir())}


def rendered_alone(folder, source, *options):
    assert call("render", source, folder / "alone.wav", *options).code == 0
    return (folder / "alone.wav").read_bytes()


def told(sounds, out, *options):
    return call("catalogue", sounds, "--out", out, "--workers", 1, *options)


def run(sounds, out, *options):
    done = told(sounds, out, "--json", *options)
    return json.loads(done.stdout), done.code


def test_every_sound_of_a_folder_becomes_what_render_makes_of_it(sounds, expected, tmp_path):
    out = tmp_path / "out"
    done = told(sounds, out)
    assert (done.code, done.stderr, results(out)) == (0, "", expected)
    found = record(out, "s00.wav")
    assert (found["frames"], found["bytes"]) == (2_000, len(expected["s00.wav"]))
    assert found["seconds"] > 0.0
    assert found["host"]
    assert {"peak", "leak_above_250_hz_db", "exposure_a8_m_s2", "key"} <= found.keys()


def test_a_run_does_without_scipy_whose_import_takes_a_second(sounds, tmp_path):
    ran = f"main(['catalogue', '{sounds}', '--out', '{tmp_path}/out', '--workers', '1'])"
    said, _ = printed(
        "from audioflinger_hook.cli import catalogue, main, sys\n"
        "from audioflinger_hook.offline.batch import Place\n"
        "catalogue.LocalWorkers = lambda *_: Place()\n"
        f"{ran}\nprint('scipy.signal' in sys.modules)"
    )
    assert "6 rendered" in said
    assert said.endswith("False")


@settings(max_examples=6, suppress_health_check=list(HealthCheck))
@given(
    order=st.permutations(range(6)),
    shards=st.integers(1, 3),
    workers=st.sampled_from((1, 1, 2)),
    stops=st.lists(st.integers(0, 5), max_size=2),
)
def test_bytes_do_not_depend_on_order_shards_workers_or_interruptions(
    sounds, expected, tmp_path_factory, order, shards, workers, stops
):
    folder = tmp_path_factory.mktemp("run")
    out = folder / "out"
    lines = [{"audio": str(sounds / f"s{index:02d}.wav"), "id": f"s{index:02d}"} for index in order]
    listed = manifest(folder / "list.jsonl", *lines)
    for stop in stops:  # a run that ends at a missing file, as an interruption would end it
        broken = [*lines[:stop], {"audio": "gone.wav"}, *lines[stop:]]
        _, code = run(manifest(folder / "part.jsonl", *broken), out, "--max-failures", 0)
        assert code == 2
    for shard in range(shards, 0, -1):
        share = f"{shard}/{shards}"
        _, code = run(listed, out, "--shard", share, "--workers", workers)
        assert code == 0
    assert results(out) == expected


def test_only_what_has_changed_is_rendered_again(sounds, tmp_path):
    folder, out = tmp_path / "in", tmp_path / "out"
    shutil.copytree(sounds, folder)

    def rendered(*options):
        return run(folder, out, *options)[0]["rendered"]

    assert rendered() == 6
    sound(folder / "s00.wav", noise(2_000), LOW_RATE)
    assert rendered() == 1
    before = {path: path.stat().st_mtime_ns for path in out.glob("s*")}
    assert rendered() == 0
    assert {path: path.stat().st_mtime_ns for path in before} == before
    for options in ("--profile cinema", "", "--transform reference", "--output-rate 1000"):
        assert rendered(*options.split()) == 6
    assert rendered("--output-rate", 1_000) == 0


DAMAGES = {
    "shorter": lambda result, note: result.write_bytes(result.read_bytes()[:-4]),
    "longer": lambda result, note: result.write_bytes(result.read_bytes() + b"...."),
    "other bytes": lambda result, note: result.write_bytes(result.read_bytes()[::-1]),
    "gone": lambda result, note: result.unlink(),
    "torn record": lambda result, note: note.write_text(note.read_text()[:60]),
    "no record": lambda result, note: note.unlink(),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_result_not_whole_or_without_record_is_rendered_again(sounds, expected, tmp_path, damage):
    out = tmp_path / "out"
    run(sounds, out)
    DAMAGES[damage](out / "s01.wav", out / "s01.wav.json")
    assert (run(sounds, out)[0]["rendered"], results(out)) == (1, expected)


def test_copies_are_known_by_their_bytes(sounds, tmp_path):
    folder, moved = tmp_path / "in", tmp_path / "moved"
    out, copied = tmp_path / "out", tmp_path / "copied"
    shutil.copytree(sounds, folder)
    run(folder, out)
    shutil.copytree(out, copied, copy_function=shutil.copyfile)
    for _ in range(2):
        assert run(folder, copied)[0]["skipped"] == 6
    # The sounds themselves are on request.
    assert run(folder, out, "--verify")[0]["rendered"] == 6
    for path in folder.iterdir():
        os.utime(path, ns=(1, 1))
    folder.rename(moved)
    assert run(moved, out, "--verify")[0]["skipped"] == 6


def test_a_result_without_its_own_record_is_not_taken(sounds, expected, tmp_path, monkeypatch):
    out = tmp_path / "out"
    run(sounds, out)
    # Another profile's result has the same size. Its run ends before it writes the record.
    with monkeypatch.context() as patch:
        patch.setattr(work, "_write_record", Mock(side_effect=KeyboardInterrupt))
        assert told(sounds, out, "--profile", "cinema").code == 130
    assert results(out) != expected
    assert (run(sounds, out)[0]["rendered"], results(out)) == (1, expected)


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_has_the_bytes_of_an_export(tmp_path, name):
    folder, out = library(tmp_path / "in", 2, 4_000), tmp_path / "out"
    for state in ("rendered", "skipped"):
        found, code = run(folder, out, "--format", name)
        assert (found[state], code) == (2, 0)
    suffix = FORMATS[name].suffixes[0]
    alone = tmp_path / f"alone{suffix}"
    assert call("export", folder / "s00.wav", alone, "--format", name).code == 0
    assert (out / f"s00{suffix}").read_bytes() == alone.read_bytes()
    found = record(out, f"s00{suffix}")
    assert found["bytes"] == alone.stat().st_size
    assert found["exposure_a8_m_s2"] > 0.0
    assert max(found["course"]) > 0


def test_results_of_another_version_are_made_anew(sounds, expected, tmp_path, monkeypatch):
    out = tmp_path / "out"
    monkeypatch.setattr(recipes.Recipe, "version", "0.0", raising=False)
    monkeypatch.setattr(recipes.Recipe.__init__, "__defaults__", (None, None, False, False, "0.0"))
    monkeypatch.setattr(work, "VERSION", "0.0")
    assert run(sounds, out)[0]["rendered"] == 6
    monkeypatch.undo()
    assert (run(sounds, out)[0]["rendered"], results(out)) == (6, expected)


def test_a_worker_of_another_version_stops_the_run(sounds, tmp_path, monkeypatch):
    monkeypatch.setattr(work, "VERSION", "another")
    done = told(sounds, tmp_path / "out")
    assert done.code == 2
    assert "install the same version" in done.stderr
    assert done.stderr.count("\n") == 2


def test_bad_files_end_nothing_and_the_list_of_failures_is_a_manifest(tmp_path):
    folder, out = library(tmp_path / "in"), tmp_path / "out"
    good = (folder / "s03.wav").read_bytes()
    for name, content in (("s00", b"no sound"), ("s01", b""), ("s02", b"no sound")):
        (folder / f"{name}.wav").write_bytes(content)

    def failed(*arguments):
        found, code = run(*arguments)
        assert code == 2
        return found["failed"], [row["id"] for row in rows(out / "failed.jsonl")]

    everything = ["s00", "s01", "s02"]
    assert failed(folder, out) == (3, everything)
    assert "not a sound file" in rows(out / "failed.jsonl")[0]["error"]
    # A run on the list that ends early keeps the list.
    assert failed(out / "failed.jsonl", out, "--max-failures", 0) == (1, everything)
    (folder / "s01.wav").write_bytes(good)
    assert failed(out / "failed.jsonl", out) == (2, ["s00", "s02"])
    for name in ("s00", "s02"):
        (folder / f"{name}.wav").write_bytes(good)
    assert run(out / "failed.jsonl", out)[1] == 0
    assert not (out / "failed.jsonl").exists()
    assert run(folder, out)[0]["skipped"] == 4


def test_a_result_never_replaces_the_sound_that_it_is_made_of(tmp_path):
    out = library(tmp_path / "music", 1)
    before = (out / "s00.wav").read_bytes()
    (tmp_path / "links").mkdir()
    (tmp_path / "links/s00.wav").symlink_to(out / "s00.wav")
    assert run(tmp_path / "links", out)[0]["failed"] == 1
    assert (out / "s00.wav").read_bytes() == before
    assert "is the file that its result would replace" in rows(out / "failed.jsonl")[0]["error"]


def test_a_failed_item_keeps_everything_that_its_line_said(tmp_path):
    line = {"audio": "gone.mkv", "id": "x/y", "start_s": 1.5, "duration_s": 2.0}
    line |= {"channels": [0, 1], "profile": "cinema", "track": 2, "language": "fra"}
    assert run(manifest(tmp_path / "list.jsonl", line), tmp_path / "out")[1] == 2
    (row,) = rows(tmp_path / "out/failed.jsonl")
    assert {name: row[name] for name in line} == line | {"audio": str(tmp_path / "gone.mkv")}


@pytest.mark.parametrize("kind", ["WAV/FLOAT", "FLAC/PCM_16", "OGG/VORBIS"])
def test_a_part_of_a_sound_becomes_what_render_makes_of_that_part(tmp_path, kind):
    container, subtype = kind.split("/")
    options = {"format": container, "subtype": subtype}
    samples = vibration(sound(tmp_path / "whole", 0.3 * noise(20_000, 2), LOW_RATE, **options))
    parts = (
        ({"start_s": 2.4}, slice(19_200, None)),
        ({"duration_s": 0.1}, slice(800)),
        ({"start_s": 1.0, "duration_s": 0.5}, slice(8_000, 12_000)),
        ({"start_s": 2.4, "duration_s": 9.0}, slice(19_200, None)),
        ({"offset": 0.05, "duration": 0.1}, slice(400, 1_200)),
    )
    lines = [{"audio": "whole", "id": f"{n}", **line} for n, (line, _) in enumerate(parts)]
    assert run(manifest(tmp_path / "list.jsonl", *lines), tmp_path / "out")[1] == 0
    for number, (_, frames) in enumerate(parts):
        part = sound(tmp_path / "part.wav", samples[frames], LOW_RATE)
        assert (tmp_path / f"out/{number}.wav").read_bytes() == rendered_alone(tmp_path, part)


def test_channels_and_profile_are_chosen_for_each_item(tmp_path):
    samples = noise(2_000, 3).astype(np.float32)
    sound(tmp_path / "three.wav", samples, LOW_RATE)
    sound(tmp_path / "last.wav", samples[:, 2], LOW_RATE)
    out = tmp_path / "out"
    chosen: dict[str, Any] = {
        "each": ({"channels": "each"}, ("three.wav", "--channels", "each")),
        "last": ({"channels": 2}, ("last.wav",)),
        "game": ({"profile": "game"}, ("three.wav", "--profile", "game")),
    }
    lines = [{"audio": "three.wav", "id": name} | line for name, (line, _) in chosen.items()]
    assert run(manifest(tmp_path / "l.jsonl", *lines), out)[1] == 0
    for name, (_, (source, *options)) in chosen.items():
        alone = rendered_alone(tmp_path, tmp_path / source, *options)
        assert (out / f"{name}.wav").read_bytes() == alone
    assert record(out, "game.wav")["profile"] == "game"


def test_a_part_that_is_not_there_fails(tmp_path):
    sound(tmp_path / "a.wav", noise(2_000), LOW_RATE)
    lines = ({"audio": "a.wav", "id": "late", "start_s": 60.0}, {"audio": "a.wav", "channels": 7})
    done = told(manifest(tmp_path / "list.jsonl", *lines), tmp_path / "out")
    assert (done.code, done.stderr.count("is not in the sound")) == (2, 2)
    assert results(tmp_path / "out") == {}


def test_the_end_of_a_sound_of_thirty_hours_is_reached_at_once(tmp_path):
    frames = 30 * 3600 * 1_000
    path = sound(tmp_path / "long.wav", np.zeros(2_000, np.float32), 1_000, subtype="PCM_U8")
    content = bytearray(path.read_bytes())
    at = content.index(b"data") + 4
    content[at : at + 4] = frames.to_bytes(4, "little")
    content[4:8] = (at + frames - 4).to_bytes(4, "little")
    path.write_bytes(content)
    os.truncate(path, at + 4 + frames)  # a hole that takes no space
    line = {"audio": str(path), "id": "end", "start_s": 30 * 3600.0 - 2.0}
    assert run(manifest(tmp_path / "list.jsonl", line), tmp_path / "out")[1] == 0
    assert record(tmp_path / "out", "end.wav")["frames"] == 2_000


def test_a_full_disk_ends_the_run_and_the_next_one_goes_on(sounds, expected, tmp_path, monkeypatch):
    out, put = tmp_path / "out", storage.LocalStorage.put
    full = Mock(side_effect=OSError(errno.ENOSPC, "No space left on device"))

    def limited(self, name, make):
        return put(self, name, full if name.endswith(".wav") and len(results(out)) == 2 else make)

    with monkeypatch.context() as patch:
        patch.setattr(storage.LocalStorage, "put", limited)
        done = told(sounds, out)
    assert done.code == 5
    assert "No space left" in done.stderr
    assert "run the same command again" in done.stderr
    assert (len(results(out)), run(sounds, out)[1], results(out)) == (2, 0, expected)


def test_i_o_is_repeated_and_nothing_else(sounds, tmp_path, monkeypatch):
    waits: list[float] = []
    fails = [errno.EIO, errno.EIO]
    monkeypatch.setattr("time.sleep", waits.append)
    identity = storage.identity_of

    def failing(audio):
        if audio.endswith("s00.wav") and fails:
            raise OSError(fails.pop(), "broken wire")
        return identity(audio)

    monkeypatch.setattr(work, "identity_of", failing)
    folder = shutil.copytree(sounds, tmp_path / "in")
    (folder / "x.flac").write_text("no sound")
    found, code = run(folder, tmp_path / "out")
    assert (found["rendered"], found["failed"], code, waits) == (6, 1, 2, [0.5, 1.5])


def test_two_runs_into_one_folder_work_together(sounds, expected, tmp_path):
    out = tmp_path / "out"
    runs = [start("catalogue", sounds, "--out", out, "--workers", 1) for _ in range(2)]
    for process in runs:
        with process:
            assert process.communicate(timeout=60)[1] == ""
            assert process.returncode == 0
    assert (results(out), run(sounds, out)[0]["skipped"]) == (expected, 6)


def test_status_counts_what_is_done_outdated_missing_and_unreadable(sounds, tmp_path):
    folder, out = shutil.copytree(sounds, tmp_path / "in"), tmp_path / "out"
    run(folder, out)
    for name in ("s00.wav", "t.wav"):
        sound(folder / name, noise(500), LOW_RATE)
    lines = [{"audio": str(path), "id": path.stem} for path in folder.iterdir()]
    listed = manifest(tmp_path / "list.jsonl", *lines, {"audio": "gone.wav"})
    before, done = results(out), call("catalogue", "status", listed, "--out", out, "--json")
    assert done.code == 0
    found = json.loads(done.stdout)
    assert found == {"items": 8, "done": 5, "outdated": 1, "missing": 1, "unreadable": 1}
    assert results(out) == before


def test_status_says_that_results_cannot_be_read(sounds, tmp_path, monkeypatch):
    monkeypatch.setattr(storage.LocalStorage, "read", Mock(side_effect=StorageError("it is down")))
    monkeypatch.setattr("time.sleep", lambda _: None)
    said = refused(call("catalogue", "status", sounds, "--out", tmp_path / "out"), 5)
    assert "it is down" in said


def test_a_record_that_is_no_file_harms_only_its_own_item(sounds, tmp_path):
    out = tmp_path / "out"
    (out / "s00.wav.json").mkdir(parents=True)
    (out / "s01.wav.json").symlink_to("s01.wav.json")
    os.mkfifo(out / "s02.wav.json")
    for _ in range(2):
        done = told(sounds, out)
        assert done.stderr.count("cannot be read (") == 2
        assert "fault of cushion" not in done.stderr
    status = call("catalogue", "status", sounds, "--out", out)
    assert "4 done, 0 outdated, 0 missing, 2 unreadable" in status.stdout


def test_the_report_is_one_page_with_a_picture_of_each_item(tmp_path):
    folder, page = library(tmp_path / "in"), tmp_path / "report"
    sound(folder / "quiet.wav", np.zeros((2_000, 1)), LOW_RATE)
    (folder / "<bad>.wav").write_text("no sound")
    for _ in range(2):  # skipped items have their pictures, too
        done = told(folder, tmp_path / "out", "--report", page)
        assert done.code == 2
        text = (page / "index.html").read_text()
        assert (text.count("<figure"), text.count("<svg")) == (6, 5)
        assert "silence" in text
        assert "&lt;bad&gt;" in text
        assert "<bad>" not in text
        assert "http" not in text  # it loads nothing
    assert "silence" in done.stdout


@pytest.mark.parametrize(("options", "words"), table("wrong-usage.toml")["catalogue"])
def test_wrong_usage_is_one_line(sounds, tmp_path, monkeypatch, options, words):
    monkeypatch.chdir(tmp_path)
    given = [sounds if option == "IN" else option for option in options.split()]
    line = refused(call("catalogue", sounds, *given))
    assert words in line
    assert "password" not in line.replace("without password", "")
