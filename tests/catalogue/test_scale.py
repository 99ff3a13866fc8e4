"""Manifests of a million lines: flat memory, and little time for an item that is done."""

import json
import os
import subprocess
import sys
from itertools import islice

import pytest

from audioflinger_hook.catalogue.manifest import Manifest
from tests.support.catalogues import library, manifest
from tests.support.commands import environment

# A small process starts the command, because a child's peak memory includes that of its parent.
WATCHER = """
import json, resource, subprocess, sys, time
begin_s = time.perf_counter()
done = subprocess.run(sys.argv[1:], capture_output=True, text=True)
wall_s = time.perf_counter() - begin_s
peak_kb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
print(json.dumps([done.returncode, done.stdout, done.stderr, wall_s, peak_kb]))
"""

LEAF = 1_000
"""Results in a folder. All folders of results are links to one, so that a million take no space."""


def watched(*arguments):
    """Run `cushion catalogue`; return its summary, its wall time in s and its peak memory in MB."""
    command = [sys.executable, "-m", "audioflinger_hook", "catalogue", "--json", *arguments]
    watcher = [sys.executable, "-c", WATCHER, *map(str, command)]
    done = subprocess.run(watcher, capture_output=True, text=True, check=True, env=environment())
    code, stdout, stderr, wall_s, peak_kb = json.loads(done.stdout)
    assert (code, stderr) == (0, "")
    return json.loads(stdout), wall_s, peak_kb / 1024.0


def done_catalogue(folder, lines):
    """Write a manifest of many items that are done: each is one sound under another name."""
    out, leaf = folder / "out", folder / "out/leaf"
    sound = library(folder / "in", 1) / "s00.wav"
    watched(manifest(folder / "first.jsonl", {"audio": str(sound), "id": "leaf/0"}), "--out", out)
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
    ("few", "many"),
    [(1_000, 10_000), pytest.param(100_000, 1_000_000, marks=pytest.mark.soak)],
)
def test_memory_does_not_grow_with_the_manifest_and_a_done_item_takes_under_2_ms(
    tmp_path, few, many
):
    listed, out = done_catalogue(tmp_path, many)
    peaks = {}
    for lines in (few, many):
        part = tmp_path / f"{lines}.jsonl"
        with listed.open() as file:
            part.write_text("".join(islice(file, lines)))
        found, wall_s, peaks[lines] = watched(part, "--out", out, "--workers", 2)
        assert (found["items"], found["skipped"]) == (lines, lines)
        print(f"{lines} lines: {1e3 * wall_s / lines:.3f} ms an item, {peaks[lines]:.0f} MB")
        if lines == 1_000_000:  # of fewer items, the start of the processes is most of it
            assert wall_s / lines <= 2e-3
    # 16 bytes a line for the search of duplicates may stay in memory up to 4 MB in all.
    assert peaks[many] - peaks[few] <= 8.0


def test_every_mistake_is_found_where_ids_have_gone_to_disk(tmp_path, monkeypatch):
    monkeypatch.setattr("audioflinger_hook.catalogue.manifest.SPOOLED_BYTES", 1_024)
    count = 20_000
    names = [*range(count - 1), 5]
    listed = manifest(tmp_path / "l.jsonl", *({"audio": "a.wav", "id": f"{n}"} for n in names))
    found, mistakes = Manifest(str(listed), "/nowhere/out").check()
    assert found == count
    assert [text.partition("l.jsonl:")[2] for text in mistakes.shown] == [
        f"{count}: has the same id as line 6; give ids"
    ]
