import contextlib
import gzip
import json
import os
import random
import re
import time
from itertools import islice

import pytest

from audioflinger_hook.catalogue.manifest import Manifest
from device.errors import UsageError
from tests.support.catalogues import library, manifest
from tests.support.commands import call, noise, sound, start
from tests.support.costs import cost_ffts
from tests.support.data import table
from tools.bench.cost import in_ffts

OUT = "/nowhere/out"


def items(path, out=OUT):
    read = Manifest(str(path), out)
    count, mistakes = read.check()
    assert mistakes.shown == []
    found = list(read.items())
    assert len(found) == count
    return found


def mistakes(path):
    _, found = Manifest(str(path), OUT).check()
    return [text.removeprefix(f"{path.parent}/") for text in found.shown]


def test_lines_csv_and_compressed_lines_give_the_same_items(tmp_path):
    lines = [
        {"audio": "a b.wav", "id": "one", "start_s": 1.5, "track": 2},
        {"audio": "/x/c.flac", "duration_s": 2.0, "channels": "each", "profile": "game"},
        {"audio": "s3://bucket/d.ogg", "channels": [0, 3], "language": "eng"},
    ]
    listed = manifest(tmp_path / "l.jsonl", *lines, "")
    with gzip.open(tmp_path / "l.jsonl.gz", "wb") as file:
        file.write(listed.read_bytes())
    table = tmp_path / "l.csv"
    table.write_text(
        "audio,id,start_s,duration_s,channels,profile,track,language,comment\n"
        'a b.wav,one,1.5,,,,2,,"with, comma"\n'
        "/x/c.flac,,,2,each,game,,,\n"
        "s3://bucket/d.ogg,,,,0 3,,,eng,\n"
    )
    rows = [item.row() for item in items(listed)]
    # A row is a line that gives the same item.
    for other in (tmp_path / "l.jsonl.gz", table, manifest(tmp_path / "again.jsonl", *rows)):
        assert rows == [item.row() for item in items(other)]
    assert rows[0]["audio"] == str(tmp_path / "a b.wav")
    assert ([row["id"] for row in rows], rows[2]["channels"]) == (["one", "x/c", "d"], (0, 3))


SOURCES = '"sources": [{"type": "file", "channels": [0], "source": "a/b.wav"}]'
FOREIGN = {
    "NeMo": (
        '{"audio_filepath": "a/b.wav", "offset": 2, "duration": 3.5, "text": "hi", "lang": "en"}',
        {"id": "a/b-2s", "start_s": 2.0, "duration_s": 3.5},
    ),
    "a recording of lhotse": (
        f'{{"id": "r1", {SOURCES}, "sampling_rate": 16000, "num_samples": 32000, "duration": 2.0,'
        ' "channel_ids": [0]}',
        {"id": "r1", "duration_s": 2.0},
    ),
    "a cut of lhotse": (
        '{"id": "cut-1", "start": 0.5, "duration": 1.0, "channel": 0, "supervisions": [],'
        f' "recording": {{"id": "r1", {SOURCES}}}, "type": "MonoCut"}}',
        {"id": "cut-1", "start_s": 0.5, "duration_s": 1.0, "channels": (0,)},
    ),
}


@pytest.mark.parametrize(("line", "expected"), FOREIGN.values(), ids=FOREIGN)
def test_names_of_nemo_and_lhotse_are_understood(tmp_path, line, expected):
    (item,) = items(manifest(tmp_path / "l.jsonl", line))
    assert item.row() == {"audio": str(tmp_path / "a/b.wav")} | expected


def test_a_folder_or_a_glob_gives_sounds_in_order_without_the_results(tmp_path):
    folder = library(tmp_path / "in", 3)
    out = folder / "out"
    for name in ("deep/film.MKV", "notes.txt", ".hidden.wav", "out/s00.wav"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).touch()

    def ids(pattern):
        return [item.id for item in items(folder / pattern, str(out)) if "notes" not in item.id]

    assert ids("") == ids("**") == ["deep/film", "s00", "s01", "s02"]
    assert (ids("s0[12].wav"), ids("*/*.MKV")) == (["s01", "s02"], ["deep/film"])
    assert ids("s01.wav") == ["s01"]


MISTAKES = dict(table("manifest-mistakes.toml")["mistakes"])


def test_all_mistakes_are_told_at_once_with_their_lines_and_nothing_is_rendered(tmp_path):
    inside = json.dumps({"audio": str(tmp_path / "out/c.wav")})
    wrong = {**MISTAKES, inside: "is in the output folder"}
    listed = [
        text
        for number, line in enumerate(wrong)
        for text in ("", json.dumps({"audio": f"good{number}.wav"}), line)
    ]
    path = manifest(tmp_path / "l.jsonl", *listed)
    path.write_bytes(path.read_bytes() + b'\n\n{"audio": "\xff.wav"}\n')
    done = call("catalogue", path, "--out", tmp_path / "out")
    assert (done.code, done.stdout) == (2, "")
    both = zip(done.stderr.splitlines(), (*wrong.values(), "is not UTF-8"), strict=True)
    for number, (text, words) in enumerate(both, 1):
        assert text.startswith(f"cushion: error: {path}:{3 * number}: ")
        assert words in text
    assert "hidden" not in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_name_that_no_file_can_have_fails_alone(tmp_path):
    sound(tmp_path / "a.wav", noise(800))
    path = manifest(tmp_path / "l.jsonl", '{"audio": "a\\ud800.wav"}', '{"audio": "a.wav"}')
    done = call("catalogue", path, "--out", tmp_path / "out", "--workers", 1)
    assert (done.code, done.stderr.count("\n")) == (2, 1)
    assert "fault of cushion" not in done.stderr
    assert (tmp_path / "out/a.wav").is_file()


def test_mistakes_of_csv_are_told_with_their_lines(tmp_path):
    path = tmp_path / "l.csv"
    path.write_text('audio,start_s\na.wav,1\nb.wav\nc.wav,"so\non"\n,\ne.wav,2,3\n')
    assert mistakes(path) == [
        "l.csv:3: has 1 column; the header has 2 columns",
        "l.csv:5: start_s='so on' is not a number; allowed: 0 to 1e+07 s",
        "l.csv:6: audio is missing; allowed: a path, or a URL of a storage that fsspec knows",
        "l.csv:7: has 3 columns; the header has 2 columns",
    ]
    path.write_text("file,start_s\na.wav,1\n")
    assert mistakes(path) == ["l.csv:1: the header has no column audio: \"['file', 'start_s']\""]


@pytest.mark.parametrize("in_memory_bytes", [1 << 16, 16])
def test_two_items_of_one_name_are_a_mistake_even_on_disk(tmp_path, monkeypatch, in_memory_bytes):
    monkeypatch.setattr("audioflinger_hook.catalogue.manifest.SPOOLED_BYTES", in_memory_bytes)
    lines = [{"audio": f"{name}.wav", "id": name} for name in "aaca"]
    assert mistakes(manifest(tmp_path / "l.jsonl", *lines)) == [
        "l.jsonl:2: has the same id as line 1; give ids",
        "l.jsonl:4: has the same id as line 2; give ids",
    ]


HARD_NAMES = [
    *(b"caf\xe9.wav", b"two\nlines.wav", b"esc\x1b[2J.wav", b"l" * 250 + b".wav", b"sub\xff/z.wav"),
    *(b"a.wav", b"a.flac", b"a.flac.wav", b"b.wav", b"b.WAV", b"catalogue.wav", b"failed.wav"),
    # folders that would be in the place of a result, a record or a list of failures
    *(b"a.wav.json/c.wav", b"b.wav.wav/c.wav", b"failed.jsonl/c.wav", b"a.hjif/c.wav"),
]


def test_every_name_of_a_file_becomes_an_id_of_its_own(tmp_path, monkeypatch):
    (tmp_path / "in").mkdir()
    for name in HARD_NAMES:
        path = os.path.join(os.fsencode(tmp_path), b"in", name)  # noqa: PTH118
        os.makedirs(os.path.dirname(path), exist_ok=True)  # noqa: PTH103, PTH120
        with open(path, "wb"):  # noqa: PTH123
            pass
    (tmp_path / "in/link.wav").symlink_to("link.wav")
    found = {item.id for item in items(tmp_path / "in")}
    assert len(found) == len(HARD_NAMES) + 1
    kept = "a.wav a.flac a.flac.wav b.wav b.WAV catalogue.wav failed.wav"
    assert set(kept.split()) < found
    assert not re.search(r"\.(wav|json|jsonl|hjif)/", " ".join(found))
    assert all(name.isprintable() and len(name.encode()) < 200 for name in found)
    lines = [{"audio": "a.wav"}, {"audio": "a.flac"}, {"audio": "b.wav", "id": "a"}]
    listed = manifest(tmp_path / "l.jsonl", *lines)
    assert [item.id for item in items(listed)] == ["a.wav", "a.flac", "a"]


def test_a_folder_that_cannot_be_listed_fails_and_costs_no_other(tmp_path, monkeypatch):
    folder, scandir = library(tmp_path / "in", 2), os.scandir
    library(folder / "locked", 1)

    def scanned(path):
        if str(path).endswith("locked"):
            raise PermissionError(13, "Permission denied")
        return scandir(path)

    monkeypatch.setattr("os.scandir", scanned)
    for pattern in ("", "**/*.wav"):
        found = [item.id for item in items(folder / pattern)]
        assert found == ["locked", "s00", "s01"]
    assert [item.id for item in items(folder / "s*.wav")] == ["s00", "s01"]
    done = call("catalogue", folder, "--out", tmp_path / "out", "--workers", 1)
    assert (done.code, done.stderr.count("\n")) == (2, 1)
    assert "locked is a folder" in done.stderr
    assert "2 rendered" in done.stdout


def test_a_hundred_mistakes_are_listed_and_all_are_counted(tmp_path):
    path = manifest(tmp_path / "l.jsonl", *["{"] * 1_234)
    done = call("catalogue", path, "--out", tmp_path / "out")
    assert done.stderr.count("\n") == 101
    assert done.stderr.endswith("1134 more mistakes in the manifest\n")


def test_an_output_folder_that_a_link_names_is_known(tmp_path):
    library(library(tmp_path / "music", 1) / "new", 1)
    (tmp_path / "link").symlink_to("music")
    with pytest.raises(UsageError, match="is the folder of the sounds"):
        Manifest(str(tmp_path / "music"), str(tmp_path / "link"))
    assert [item.id for item in items(tmp_path / "music", str(tmp_path / "link/new"))] == ["s00"]
    audio = ("music/s00.wav", "link/new/s00.wav")
    listed = manifest(tmp_path / "l.jsonl", *({"audio": one} for one in audio))
    for out in ("link", "music"):
        _, wrong = Manifest(str(listed), str(tmp_path / out)).check()
        assert wrong.count == 2
        assert all("is in the output folder" in text for text in wrong.shown)


def test_a_manifest_that_is_not_there_or_has_no_items_is_refused(tmp_path):
    for name, content in (("a.jsonl", ""), ("b.jsonl", "\n\n"), ("c.csv", "audio,id\n")):
        (tmp_path / name).write_text(content)
        with pytest.raises(UsageError, match="has no items"):
            Manifest(str(tmp_path / name), OUT).check()
    for name in ("gone.jsonl", "gone/*.wav", "gone/"):
        with pytest.raises(UsageError, match=r"does not exist|cannot be listed"):
            Manifest(f"{tmp_path}/{name}", OUT).check()


def test_broken_manifests_never_raise_anything_else(tmp_path):
    good = json.dumps({"audio": "a.wav", "id": "x", "start_s": 1.0, "channels": [0]})
    draw = random.Random(3)
    for suffix in ("jsonl", "csv", "jsonl.gz"):
        path = tmp_path / f"l.{suffix}"
        for _ in range(300):
            content = bytearray(f"{good}\n{good}\n".encode())
            for _ in range(draw.randint(1, 8)):
                content[draw.randrange(len(content))] = draw.randrange(256)
            path.write_bytes(content)
            with contextlib.suppress(UsageError):
                Manifest(str(path), OUT).check()


PEAK_KB = """
import atexit, contextlib, io, resource, sys
from pathlib import Path
from audioflinger_hook.cli import main
def peak_kb():
    own = Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0]
    return max(int(own), resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
atexit.register(lambda: print(peak_kb(), file=sys.stderr))
with contextlib.redirect_stdout(io.StringIO()):
    assert main([*sys.argv[1:-1], FIRST]) == 0
print(peak_kb(), file=sys.stderr)
"""

LEAF = 1_000
"""Results in a folder. All folders of results are links to one, so that a million take no space."""


def watched(*arguments, first):
    """Run a catalogue of `first` and then, in the same process, of the last argument. Return the
    summary of the latter, the wall time in s and the peak memory in MB after each."""
    begin_s, prelude = time.perf_counter(), f"FIRST = {str(first)!r}{PEAK_KB}"
    with start("catalogue", "--json", *arguments, prelude=prelude) as process:
        stdout, stderr = process.communicate()
    assert process.returncode == 0, stderr
    peaks = [int(line) / 1024.0 for line in stderr.splitlines()]
    return json.loads(stdout), time.perf_counter() - begin_s, peaks


def done_catalogue(folder, lines):
    """Write a manifest of many items that are done: each is one sound under another name."""
    out, leaf = folder / "out", folder / "out/leaf"
    sound = library(folder / "in", 1) / "s00.wav"
    first = manifest(folder / "first.jsonl", {"audio": str(sound), "id": "leaf/0"})
    assert call("catalogue", first, "--out", out, "--workers", 1).code == 0
    for index in range(1, LEAF):
        for ending in (".wav", ".wav.json"):
            os.link(leaf / f"0{ending}", leaf / f"{index}{ending}")
    for index in range(-(-lines // LEAF)):
        (out / str(index)).symlink_to(leaf)
    with (folder / "all.jsonl").open("w") as file:
        for index in range(lines):
            name = f"{index // LEAF}/{index % LEAF}"
            file.write(json.dumps({"audio": str(sound), "id": name}) + "\n")
    return folder / "all.jsonl", out


@pytest.mark.parametrize(
    ("few", "many"), [(500, 5_000), pytest.param(100_000, 1_000_000, marks=pytest.mark.soak)]
)
def test_memory_does_not_grow_with_a_manifest_and_a_done_item_takes_under_2_ms(tmp_path, few, many):
    listed, out = done_catalogue(tmp_path, many)
    part = tmp_path / "few.jsonl"
    with listed.open() as file:
        part.write_text("".join(islice(file, few)))
    found, wall_s, peaks = watched("--out", out, "--workers", 2, listed, first=part)
    assert (found["items"], found["skipped"]) == (many, many)
    print(f"{1e3 * wall_s / (few + many):.3f} ms an item, {peaks} MB")
    if many == 1_000_000:  # of fewer items, the start of the processes is most of it
        assert wall_s / (few + many) <= 2e-3
    run = ("catalogue", listed, "--out", out, "--workers", 1)
    costs = (cost_ffts(lambda: call(*run)) for _ in range(3))  # other programs only add to it
    assert many > 5_000 or min(costs) <= in_ffts(1e-4 * many)
    # 17 bytes a line for the search of duplicates may stay in memory up to 4 MB in all.
    assert peaks[1] - peaks[0] <= 8.0
