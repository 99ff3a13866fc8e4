"""What users get wrong and what goes wrong around them: one line, a code, nothing broken."""

import contextlib
import importlib
import os
import re
import struct
import subprocess
import sys
import tempfile
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import soundfile

from audioflinger_hook.offline.render import render_file
from device.errors import WriteError
from tests.support import commands
from tests.support.commands import RATE, call, cushion, noise, open_files, refused, sound, vibration
from tests.support.data import table

HEADER_BYTES = 44  # of a PCM_16 WAV file as libsndfile writes it

# Both commands that read a sound; the first one also writes.
READERS = ["render", "inspect"]


@pytest.fixture
def source(tmp_path):
    return sound(tmp_path / "in.wav", noise(9_600, 2))


@pytest.fixture
def out(folder):
    """Where the vibration would go: a path in a folder that holds an older file of that name."""
    path = folder / "vibration.wav"
    path.write_bytes(b"old")
    return path


def read_by(command, path, out):
    return call(command, path, out) if command == "render" else call(command, path)


def refusal(command, path, out):
    error = refused(read_by(command, path, out))
    assert str(path) in error
    assert commands.listing(out.parent) == {out.name: b"old"}
    return error


@pytest.mark.parametrize("command", READERS)
def test_what_is_no_sound_is_refused_with_the_reason(tmp_path, out, capfd, command):
    (tmp_path / "dangling.wav").symlink_to("none.wav")
    (tmp_path / "circle.wav").symlink_to("circle.wav")
    (tmp_path / "empty.wav").touch()
    (tmp_path / "random.mp3").write_bytes(np.random.default_rng(1).bytes(50_000))
    head = sound(tmp_path / "head.wav", noise(5_000), subtype="PCM_16")
    head.write_bytes(head.read_bytes()[:HEADER_BYTES])
    for name, words in {
        **dict.fromkeys(("none.wav", "dangling.wav", "empty.wav/in.wav"), "does not exist"),
        "empty.wav": "is empty (0 bytes)",
        "": "is a folder",
        "random.mp3": "is not a sound file",
        "head.wav": "has no sound (0 frames)",
        **dict.fromkeys(("circle.wav", "x" * 256 + ".wav", "d/" * 2_100 + "in.wav"), ""),
    }.items():
        assert words in refusal(command, tmp_path / name, out)
    for container, subtype in (("WAV", "PCM_16"), ("AIFF", "PCM_24"), ("OGG", "VORBIS")):
        none = sound(tmp_path / "0", np.zeros((0, 1)), format=container, subtype=subtype)
        assert "0 frames" in refusal(command, none, out)
    for ending in ("", ".wav", ".txt", ".flac", ".ogg", ".mp3", ".aiff", ".au", ".gsm", ".vox"):
        text = tmp_path / f"text{ending}"
        text.write_text("This is not a sound, and no name makes it one.\n" * 400)
        assert "is not a sound file that can be read" in refusal(command, text, out)
    assert capfd.readouterr() == ("", "")  # nor do libraries say anything past the command


@pytest.mark.parametrize("command", READERS)
@pytest.mark.parametrize(
    ("samplerate", "channels"), [(RATE, 65), (1, 1), (100, 1), (999, 1), (768_001, 1)]
)
def test_other_rates_and_channel_counts_are_refused(tmp_path, out, command, samplerate, channels):
    path = sound(tmp_path / "in.wav", noise(1_000, channels), samplerate)
    wrong, allowed = f"samplerate={samplerate} Hz", "1000 to 768000 Hz"
    if channels == 65:
        wrong, allowed = "channels=65", "1 to 64"
    assert f"{wrong} is out of range; allowed: {allowed}" in refusal(command, path, out)


@pytest.mark.parametrize(
    "kind",
    [
        *("WAV/PCM_16/1", "WAV/FLOAT/3", "WAVEX/PCM_24/1", "RF64/PCM_16/1", "W64/PCM_16/1"),
        *("AIFF/PCM_16/1", "AU/PCM_16/1", "OGG/VORBIS/3", "OGG/OPUS/1", "MP3/MPEG_LAYER_III/1"),
        *("FLAC/PCM_16/1", "FLAC/PCM_16/3"),  # less than one buffer, and more
    ],
)
def test_a_body_that_is_short_is_rendered_as_far_as_it_goes_with_a_warning(tmp_path, out, kind):
    container, subtype, seconds = kind.split("/")
    frames = int(seconds) * RATE
    path = sound(tmp_path / "short", noise(frames), format=container, subtype=subtype)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 3 // 5 + 1])
    with soundfile.SoundFile(path) as file:
        with contextlib.suppress(soundfile.LibsndfileError):
            while len(file.read(10_000)):  # to the end, or until it stumbles
                pass
        expected = file.tell()
    assert 0.3 * frames < expected < 0.8 * frames
    done = call("render", path, out)
    assert done.code == 0, done
    assert len(vibration(out)) == expected
    assert done.stderr.startswith(f"cushion: warning: {path} ")
    assert done.stderr.count("\n") == 1


def test_a_stream_whose_header_does_not_know_its_length_is_taken_without_a_warning(tmp_path, out):
    path = sound(tmp_path / "in.wav", noise(5_000), subtype="PCM_16")
    content = bytearray(path.read_bytes())
    content[4:8] = content[HEADER_BYTES - 4 : HEADER_BYTES] = struct.pack("<I", 0xFFFF_FFFF)
    path.write_bytes(content)
    done = call("render", path, out)
    assert (done.code, done.stderr, len(vibration(out))) == (0, "", 5_000)


def test_a_place_where_no_file_can_be_is_refused_with_the_reason(source, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("file").write_bytes(b"old")
    Path("folder").mkdir()
    Path("circle.wav").symlink_to("circle.wav")
    before = sorted(path.name for path in tmp_path.iterdir())
    for name, words in {
        f"{tmp_path}/none/out.wav": f"folder {tmp_path}/none does not exist",
        f"{tmp_path}/file/out.wav": f"{tmp_path}/file is not a folder",
        "folder": "it is a folder; name a file in it",
        **dict.fromkeys(("/dev/full", "/dev/null"), "it is not a regular file"),
        "circle.wav": "circle.wav",
        "-": "name a file",
        "": "",
        "x" * 256 + ".wav": "",
    }.items():
        assert words in refused(call("render", source, name))
        if name != "-":
            assert words in refused(call("render", source, "out.wav", "--acceleration", name))
    assert sorted(path.name for path in tmp_path.iterdir()) == before
    assert Path("file").read_bytes() == b"old"


@pytest.fixture
def nobodys(source):
    """A folder that anyone may enter, with sounds that nobody may read; root becomes nobody."""
    as_root = os.geteuid() == 0
    # All that is needed later is loaded while the program's own files may be read.
    assert call("render", source, source.with_name("first.wav")).code == 0
    importlib.import_module("audioflinger_hook.cli.check")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        (folder / "closed").mkdir()
        for path in (folder / "secret.wav", folder / "closed/in.wav"):
            path.write_bytes(source.read_bytes())
            path.chmod(0)
        (folder / "closed").chmod(0)
        if as_root:
            os.seteuid(65_534)
        try:
            yield folder
        finally:
            if as_root:
                os.seteuid(0)
            (folder / "closed").chmod(0o755)


@pytest.mark.parametrize("command", READERS)
@pytest.mark.parametrize("name", ["secret.wav", "closed/in.wav"])
def test_a_sound_that_may_not_be_read_is_refused(nobodys, command, name):
    assert "may not be read" in refused(read_by(command, nobodys / name, nobodys / "out.wav"))
    assert not (nobodys / "out.wav").exists()


def test_a_config_that_may_not_be_read_is_refused(nobodys):
    for name, words in (("secret.wav", "Permission denied"), ("closed/c.toml", str(nobodys))):
        assert words in refused(call("check", "--config", nobodys / name))


def test_an_output_that_is_the_input_is_refused_however_it_is_named(source, tmp_path, monkeypatch):
    before = commands.listing(tmp_path)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    Path("link.wav").symlink_to(source)
    for name in (source, "in.wav", "folder/../in.wav", "link.wav"):
        error = refused(call("render", source, name))
        assert "name two files" in error
        refused(call("render", source, "out.wav", "--acceleration", name))
        refused(call("render", name, source))
        assert commands.listing(tmp_path) == before | {"link.wav": before["in.wav"]}
    for name in ("out.wav", "folder/../out.wav"):
        error = refused(call("render", source, "out.wav", "--acceleration", name))
        assert re.search("the vibration.*the acceleration|the acceleration.*the vibration", error)
    assert commands.listing(tmp_path) == before | {"link.wav": before["in.wav"]}


def test_a_full_disk_is_a_write_error_and_leaves_everything_as_it_was(tmp_path, small_disk, out):
    source = sound(tmp_path / "in.wav", noise(10 * RATE))  # 1.9 MB of vibration
    path = small_disk / "vibration.wav"
    path.write_bytes(b"old")
    for options in ([path], [out, "--acceleration", path], [path, "--acceleration", out]):
        error = refused(call("render", source, *options), 5)
        assert f"cannot write {path}: the disk is full" in error
        assert commands.listing(small_disk) == {path.name: b"old"}
        assert commands.listing(out.parent) == {out.name: b"old"}


def test_an_acceleration_that_cannot_be_finished_leaves_the_older_vibration(tmp_path, source, out):
    folder = tmp_path / "vanishing"
    folder.mkdir()

    def vanish(_done, _all):
        if folder.exists():
            folder.rmdir()  # nothing in it has a name yet

    with pytest.raises(WriteError, match=r"felt\.wav"):
        render_file(source, out, acceleration=folder / "felt.wav", progress=vanish)
    assert commands.listing(out.parent) == {out.name: b"old"}


@pytest.mark.exhaustive
@pytest.mark.parametrize("command", ["inspect", "--help"])
def test_a_stdout_that_cannot_be_written_is_an_error_of_one_line(source, command):
    arguments = [source] if command == "inspect" else []
    with Path("/dev/full").open("w") as full:
        done = cushion(command, *arguments, stdout=full)
    assert "No space left on device" in refused(done, 5)


@pytest.mark.exhaustive
@pytest.mark.parametrize(("number", "stream"), [(1, "stdout"), (2, "stderr")])
def test_a_stream_that_is_closed_keeps_nobody_from_rendering(source, out, number, stream):
    closed = {stream: None, "preexec_fn": lambda: os.close(number)}
    done = cushion("render", source, out, **closed)
    assert (done.code, done.stderr, len(vibration(out))) == (0, "", 9_600)


@pytest.mark.sweep
@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["render", "--help"]])
def test_a_reader_that_has_gone_is_no_error(arguments):
    done = commands.without_a_reader(*arguments)
    assert (done.code, done.stderr) == (0, "")


@pytest.mark.parametrize(("line", "words"), table("wrong-usage.toml")["cushion"])
def test_wrong_usage_is_answered_with_what_is_wrong_and_where_to_look(line, words):
    error = refused(call(*line.split()))
    assert words in error
    assert "--help" in error


def test_without_a_command_the_help_ends_with_the_next_step():
    done = call()
    assert (done.code, done.stderr) == (0, "")
    assert "usage: cushion" in done.stdout
    assert "next: `cushion setup`" in done.stdout


def test_an_error_is_one_line_whatever_its_words_hold(tmp_path, out):
    assert "does not exist" in refused(call("render", tmp_path / "two\nlines\r.wav", out))
    refused(call("render", "a", "b", "--lo\nud"))
    refused(call("in\nspect"))


def test_a_fault_of_the_program_is_one_line_and_code_5(source, out, monkeypatch):
    fault = Mock(side_effect=ZeroDivisionError("in two\nlines"))
    monkeypatch.setattr("audioflinger_hook.cli.render.render_file", fault)
    done = call("render", source, out)
    assert (done.code, done.stdout, done.stderr.count("\n")) == (5, "", 1)
    assert done.stderr.startswith("cushion: error: ZeroDivisionError: in two lines; ")
    assert "fault of cushion" in done.stderr


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (MemoryError("193 KiB"), 5, "no memory is left (MemoryError)"),
        (ImportError("x.so: failed to map segment from shared object"), 5, "no memory is left"),
        (RuntimeError("can't start new thread"), 5, "no more threads can start"),
        (FileNotFoundError(2, "No usable temporary directory found in"), 2, "TMPDIR is"),
    ],
)
def test_lack_of_memory_or_of_a_folder_is_named(source, out, monkeypatch, error, code, words):
    monkeypatch.setattr("audioflinger_hook.cli.render.render_file", Mock(side_effect=error))
    assert words in refused(call("render", source, out), code)


@pytest.mark.parametrize(
    ("limit_mb", "command", "needed_mb"),
    [
        (100, "check", 120),
        (130, "check", 0),
        (130, "render IN OUT", 165),
        (168, "render IN OUT", 0),
        (168, "render IN OUT --damping auto", 310),  # SciPy would hang
    ],
)
def test_of_a_memory_limit_only_what_would_not_work_is_refused(
    source, out, limit_mb, command, needed_mb
):
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({limit_mb} << 20,) * 2)\n"
    words = [{"IN": source, "OUT": out}.get(word, word) for word in command.split()]
    done = cushion(*words, prelude=limit)
    if needed_mb:
        few = f"this process may use {limit_mb} MB of memory (ulimit -v); allowed: at least"
        assert f"{few} {needed_mb} MB" in refused(done)
    else:
        assert (done.code, done.stderr) == (0, "")


def test_debug_shows_where_an_error_came_from(tmp_path, out):
    arguments = ["render", tmp_path / "none.wav", out]
    for done in (call("--debug", *arguments), cushion(*arguments, "--debug")):
        assert done.code == 2
        assert done.stderr.startswith("Traceback")
        assert done.stderr.splitlines()[-1] == refused(call(*arguments))


def test_a_refused_command_leaves_no_file_open(source, tmp_path, out):
    text = tmp_path / "text.wav"
    text.write_text("not a sound")

    def fail():
        refused(call("inspect", text))
        refused(call("render", source, tmp_path))
        refused(call("render", source, out, "--acceleration", tmp_path / "none" / "felt.wav"))
        refused(call("render", source, out, "--acceleration", out))
        refused(call("inspect", source, "--at", "99"))

    fail()  # what is loaded at the first time may stay open
    before = open_files()
    fail()
    assert open_files() == before


def test_an_interrupt_of_code_that_an_import_makes_is_exit_code_130(tmp_path):
    (tmp_path / "interrupted.py").write_text(
        "import sys\n"
        "from audioflinger_hook import cli\n"
        "cli._run = lambda _: exec('raise KeyboardInterrupt')\n"
        "sys.exit(cli.main([]))\n"
    )
    command = [sys.executable, "-m", "interrupted"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "cushion: interrupted\n")
