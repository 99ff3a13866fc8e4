"""Manifests: what is understood, and every mistake at once."""

import contextlib
import gzip
import json
import random

import pytest

from audioflinger_hook.catalogue.manifest import Manifest
from device.errors import UsageError
from tests.support.catalogues import library, manifest
from tests.support.commands import call

OUT = "/nowhere/out"


def items(path, out=OUT):
    """Return the items of a manifest without mistakes."""
    read = Manifest(str(path), out)
    count, mistakes = read.check()
    assert mistakes.shown == []
    found = list(read.items())
    assert len(found) == count
    return found


def mistakes(path):
    """Return the mistakes of a manifest, without the name of the file."""
    _, found = Manifest(str(path), OUT).check()
    return [text.removeprefix(f"{path.parent}/") for text in found.shown]


def test_lines_csv_and_compressed_lines_give_the_same_items(tmp_path):
    lines = [
        {"audio": "a b.wav", "id": "one", "start_s": 1.5, "track": 2},
        {"audio": "/x/c.flac", "duration_s": 2.0, "channels": "each", "profile": "game"},
        {"audio": "s3://bucket/d.ogg", "channels": [0, 3], "language": "eng"},
    ]
    listed = manifest(tmp_path / "l.jsonl", *lines, "")
    with gzip.open(tmp_path / "l.jsonl.gz", "wt") as file:
        file.writelines(f"{json.dumps(line)}\n" for line in lines)
    table = tmp_path / "l.csv"
    table.write_text(
        "audio,id,start_s,duration_s,channels,profile,track,language,comment\n"
        'a b.wav,one,1.5,,,,2,,"with, comma"\n'
        "/x/c.flac,,,2,each,game,,,\n"
        "s3://bucket/d.ogg,,,,0 3,,,eng,\n"
    )
    rows = [item.row() for item in items(listed)]
    assert rows == [item.row() for item in items(tmp_path / "l.jsonl.gz")]
    assert rows == [item.row() for item in items(table)]
    assert rows[0]["audio"] == str(tmp_path / "a b.wav")
    assert [row["id"] for row in rows] == ["one", "x/c", "d"]
    assert rows[2]["channels"] == (0, 3)


def test_a_row_is_a_line_that_gives_the_same_item(tmp_path):
    line = {"audio": "a.wav", "id": "b", "start_s": 1.0, "channels": [1], "track": 3}
    (first,) = items(manifest(tmp_path / "1.jsonl", line))
    (second,) = items(manifest(tmp_path / "2.jsonl", first.row()))
    assert second == first


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
    (folder / "deep").mkdir()
    (folder / "deep/film.MKV").touch()
    (folder / "notes.txt").touch()
    (folder / ".hidden.wav").touch()
    out = folder / "out"
    out.mkdir()
    (out / "s00.wav").touch()
    names = ["deep/film", "s00", "s01", "s02"]
    assert [item.id for item in items(folder, str(out))] == names
    assert [item.id for item in items(folder / "**", str(out)) if "notes" not in item.id] == names
    assert [item.id for item in items(folder / "s0[12].wav")] == ["s01", "s02"]
    assert [item.id for item in items(folder / "*/*.MKV")] == ["deep/film"]
    assert [item.id for item in items(folder / "s01.wav")] == ["s01"]


MISTAKES = {
    "{": "is not JSON",
    '["a.wav"]': "is not an object",
    '{"id": "x"}': "audio is missing",
    '{"audio": 5}': "audio='5' is not a text",
    '{"audio": ""}': "audio='' is not a text",
    '{"audio": "a.wav", "start_s": -1}': "start_s='-1.0' is out of range; allowed: 0 to",
    '{"audio": "a.wav", "start_s": "soon"}': "start_s='soon' is not a number",
    '{"audio": "a.wav", "duration_s": 0}': "duration_s='0.0' is out of range",
    '{"audio": "a.wav", "start_s": NaN}': "start_s='nan' is out of range",
    '{"audio": "a.wav", "channels": "both"}': "allowed: mono, each, or channel numbers",
    '{"audio": "a.wav", "channels": [-1]}': "is not a choice of channels",
    '{"audio": "a.wav", "profile": "musik"}': "did you mean music?",
    '{"audio": "a.wav", "id": "../x"}': "is not a name of a result",
    '{"audio": "a.wav", "id": "/x"}': "is not a name of a result",
    '{"audio": "a.wav", "id": "failed"}': "is the name of a file of the run",
    '{"audio": "a.wav", "id": 3}': "id='3' is not a name",
    '{"audio": "a.wav", "track": 0}': "track='0' is out of range",
    '{"audio": "a.wav", "durations_s": 3}': "did you mean duration_s?",
    '{"audio": "a.wav", "start_s": 1, "offset": 2}': "start_s is given twice, as '1' and '2'",
    '{"audio": "nowhere://b/c.wav"}': "has an unknown scheme",
    '{"audio": "s3://me:hidden@b/c.wav"}': "holds credentials",
    '{"audio": "https://h/c.wav?X-Amz-Signature=hidden"}': "holds credentials",
    '{"audio": "https://h/c.wav#token=hidden"}': "holds credentials",
    '{"audio": "a\\u0000b.wav"}': "holds a null byte",
}


def test_all_mistakes_are_told_at_once_with_their_lines_and_nothing_is_rendered(tmp_path):
    random.seed(1)
    listed, expected = [], []
    inside = json.dumps({"audio": str(tmp_path / "out/c.wav")})
    for number, (line, told) in enumerate([*MISTAKES.items(), (inside, "is in the output folder")]):
        listed += ["", json.dumps({"audio": f"good{number}.wav"}), line]
        expected.append((len(listed), told))
    path = manifest(tmp_path / "l.jsonl", *listed)
    path.write_bytes(path.read_bytes() + b'{"audio": "\xff.wav"}\n')
    expected.append((len(listed) + 1, "is not UTF-8"))
    done = call("catalogue", path, "--out", tmp_path / "out")
    assert done.code == 2
    assert done.stdout == ""
    said = done.stderr.splitlines()
    assert len(said) == len(expected)
    for text, (number, words) in zip(said, expected, strict=True):
        assert text.startswith(f"cushion: error: {path}:{number}: ")
        assert words in text
    assert "hidden" not in done.stderr
    assert not (tmp_path / "out").exists()


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
    assert mistakes(path) == [
        "l.csv:1: the header has no column audio; it is \"['file', 'start_s']\""
    ]


def test_two_items_with_one_name_are_a_mistake(tmp_path):
    lines = ({"audio": "a.wav"}, {"audio": "b.wav", "id": "a"}, {"audio": "c"}, {"audio": "a.flac"})
    assert mistakes(manifest(tmp_path / "l.jsonl", *lines)) == [
        "l.jsonl:2: has the same id as line 1; give ids",
        "l.jsonl:4: has the same id as line 2; give ids",
    ]


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
    found = items(tmp_path / "music", str(tmp_path / "link/new"))
    assert [item.id for item in found] == ["s00"]
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
