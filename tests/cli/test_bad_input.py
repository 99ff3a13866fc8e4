"""What users get wrong and what goes wrong around them: one line, a code, nothing broken."""

import contextlib
import importlib
import io
import os
import resource
import signal
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
import soundfile

from audioflinger_hook.offline.render import render_file
from device.errors import WriteError
from tests.support.commands import (
    RATE,
    call,
    cushion,
    held_back,
    listing,
    noise,
    open_files,
    refused,
    sound,
    start,
    until,
    vibration,
)

HEADER_BYTES = 44  # of a PCM_16 WAV file as libsndfile writes it

# Both commands that read a sound; the first one also writes.
READERS = ["render", "inspect"]


@pytest.fixture
def source(tmp_path):
    """A fifth of a second of sound that nothing is wrong with."""
    return sound(tmp_path / "in.wav", noise(9_600, 2))


@pytest.fixture
def out(tmp_path):
    """Where the vibration would go: a path in a folder that holds an older file of that name."""
    folder = tmp_path / "out"
    folder.mkdir()
    path = folder / "vibration.wav"
    path.write_bytes(b"old")
    return path


def read_by(command, path, out):
    """Run one of READERS on a file."""
    return call(command, path, out) if command == "render" else call(command, path)


def refusal(command, path, out):
    """The error of a reader that refuses a file and leaves the older output alone."""
    error = refused(read_by(command, path, out))
    assert str(path) in error
    assert listing(out.parent) == {out.name: b"old"}
    return error


# --- files that are not sound


@pytest.mark.parametrize("command", READERS)
def test_a_missing_file_is_refused(tmp_path, out, command):
    assert "does not exist" in refusal(command, tmp_path / "none.wav", out)
    (tmp_path / "dangling.wav").symlink_to("none.wav")
    assert "does not exist" in refusal(command, tmp_path / "dangling.wav", out)
    (tmp_path / "file").touch()
    assert "does not exist" in refusal(command, tmp_path / "file" / "in.wav", out)


@pytest.mark.parametrize("command", READERS)
def test_an_empty_file_is_refused(tmp_path, out, command):
    (tmp_path / "empty.wav").touch()
    assert "is empty (0 bytes)" in refusal(command, tmp_path / "empty.wav", out)


@pytest.mark.parametrize("command", READERS)
def test_a_folder_is_refused(tmp_path, out, command):
    assert "is a folder" in refusal(command, tmp_path, out)


@pytest.mark.parametrize("command", READERS)
@pytest.mark.parametrize(
    "name", ["a.wav", "a.txt", "a", "a.flac", "a.ogg", "a.mp3", "a.aiff", "a.au", "a.gsm", "a.vox"]
)
def test_text_is_refused_whatever_its_name_promises(tmp_path, out, capfd, command, name):
    path = tmp_path / name
    path.write_text("This is not a sound, and no name makes it one.\n" * 400)
    assert "is not a sound file that can be read" in refusal(command, path, out)
    assert capfd.readouterr() == ("", "")  # nor do libraries say anything past the command


@pytest.mark.parametrize("command", READERS)
def test_noise_that_only_its_name_calls_sound_is_refused(tmp_path, out, capfd, command):
    path = tmp_path / "random.mp3"
    path.write_bytes(np.random.default_rng(1).bytes(50_000))
    assert "is not a sound file" in refusal(command, path, out)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("command", READERS)
def test_a_header_without_a_body_is_refused(tmp_path, out, command):
    path = sound(tmp_path / "head.wav", noise(5_000), subtype="PCM_16")
    path.write_bytes(path.read_bytes()[:HEADER_BYTES])
    assert "has no sound (0 frames)" in refusal(command, path, out)


@pytest.mark.parametrize("command", READERS)
@pytest.mark.parametrize(
    ("container", "subtype"), [("WAV", "PCM_16"), ("AIFF", "PCM_24"), ("OGG", "VORBIS")]
)
def test_a_file_of_0_frames_is_refused(tmp_path, out, command, container, subtype):
    path = tmp_path / "none.wav"
    sound(path, np.zeros((0, 1)), format=container, subtype=subtype)
    assert "0 frames" in refusal(command, path, out)


@pytest.mark.parametrize("command", READERS)
@pytest.mark.parametrize("name", ["x" * 256 + ".wav", "d/" * 2_100 + "in.wav"])
def test_a_name_that_is_too_long_for_a_file_is_refused(tmp_path, out, command, name):
    refusal(command, tmp_path / name, out)


@pytest.mark.parametrize("command", READERS)
def test_links_in_a_circle_are_refused(tmp_path, out, command):
    (tmp_path / "circle.wav").symlink_to("circle.wav")
    refusal(command, tmp_path / "circle.wav", out)


# --- sound that cannot be used, or only in part


def test_nan_infinity_and_absurd_samples_count_as_0_one_by_one(tmp_path, out):
    samples = noise(9_600, 2)
    places = [(10, 0), (10, 1), (500, 0), (501, 1), (2_000, 0), (9_599, 1)]
    absurd = [np.nan, np.inf, -np.inf, 1e30, -1e30, 1_000.1]
    for place in places:
        samples[place] = 0.0
    assert call("render", sound(tmp_path / "zeros.wav", samples), out).code == 0
    expected = out.read_bytes()
    for place, value in zip(places, absurd, strict=True):
        samples[place] = value
    done = call("render", sound(tmp_path / "in.wav", samples), out)
    assert (done.code, done.stderr) == (0, "")
    assert f"{len(places)} unusable samples set to 0" in done.stdout
    assert out.read_bytes() == expected


def test_nothing_but_unusable_samples_is_silence(tmp_path, out):
    done = call("render", sound(tmp_path / "in.wav", np.full((5_000, 2), np.nan)), out)
    assert done.code == 0
    assert "10000 unusable samples set to 0" in done.stdout
    assert not vibration(out).any()


def test_samples_up_to_1000_times_full_scale_are_used(tmp_path, out):
    samples = noise(9_600)
    samples[5_000] = 1_000.0
    done = call("render", sound(tmp_path / "in.wav", samples), out)
    assert done.code == 0
    assert "unusable" not in done.stdout
    assert np.abs(vibration(out)).max() < 1.0


@pytest.mark.parametrize("command", READERS)
def test_65_channels_are_refused(tmp_path, out, command):
    path = sound(tmp_path / "in.wav", noise(1_000, 65))
    error = refusal(command, path, out)
    assert "channels=65 is out of range; allowed: 1 to 64" in error


@pytest.mark.parametrize("command", READERS)
@pytest.mark.parametrize("samplerate", [1_000, 8_000, 768_000])
def test_low_and_high_rates_work(tmp_path, out, command, samplerate):
    path = sound(tmp_path / "in.wav", noise(samplerate // 4), samplerate)
    done = read_by(command, path, out)
    assert (done.code, done.stderr) == (0, "")


@pytest.mark.parametrize("command", READERS)
@pytest.mark.parametrize("samplerate", [1, 100, 999, 768_001])
def test_rates_beyond_are_refused(tmp_path, out, command, samplerate):
    path = sound(tmp_path / "in.wav", noise(1_000), samplerate)
    error = refusal(command, path, out)
    assert f"samplerate={samplerate} Hz is out of range; allowed: 1000 to 768000 Hz" in error


def frames_in(path):
    """How many frames libsndfile can decode before it reaches the end or stumbles."""
    with soundfile.SoundFile(path) as file:
        with contextlib.suppress(soundfile.LibsndfileError):
            while len(file.read(10_000)):
                pass
        return file.tell()


@pytest.mark.parametrize(
    ("container", "subtype", "seconds"),
    [
        ("WAV", "PCM_16", 1),
        ("WAV", "FLOAT", 3),
        ("WAVEX", "PCM_24", 1),
        ("RF64", "PCM_16", 1),
        ("W64", "PCM_16", 1),
        ("AIFF", "PCM_16", 1),
        ("AU", "PCM_16", 1),
        ("FLAC", "PCM_16", 1),  # less than one buffer
        ("FLAC", "PCM_16", 3),
        ("OGG", "VORBIS", 3),
        ("OGG", "OPUS", 1),
        ("MP3", "MPEG_LAYER_III", 1),
    ],
)
def test_a_body_that_is_short_is_rendered_as_far_as_it_goes_with_a_warning(
    tmp_path, out, container, subtype, seconds
):
    whole = io.BytesIO()
    soundfile.write(whole, noise(seconds * RATE), RATE, format=container, subtype=subtype)
    path = tmp_path / "short"
    path.write_bytes(whole.getvalue()[: len(whole.getvalue()) * 3 // 5 + 1])
    expected = frames_in(path)
    assert 0.3 * seconds * RATE < expected < 0.8 * seconds * RATE
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
    assert (done.code, done.stderr) == (0, "")
    assert len(vibration(out)) == 5_000


# --- places where nothing can be written


def test_a_missing_output_folder_is_refused_and_not_made(source, tmp_path):
    path = tmp_path / "none" / "out.wav"
    for options in ([path], [tmp_path / "out.wav", "--acceleration", path]):
        error = refused(call("render", source, *options))
        assert f"folder {tmp_path}/none does not exist" in error
        assert listing(tmp_path).keys() == {"in.wav"}
        assert not path.parent.exists()


def test_an_output_folder_that_is_a_file_is_refused(source, out):
    error = refused(call("render", source, out / "again.wav"))
    assert f"{out} is not a folder" in error
    assert listing(out.parent) == {out.name: b"old"}


def test_an_output_that_is_a_folder_is_refused(source, tmp_path):
    (tmp_path / "folder").mkdir()
    error = refused(call("render", source, tmp_path / "folder"))
    assert "it is a folder; name a file in it" in error
    assert listing(tmp_path).keys() == {"in.wav"}


def test_an_output_that_is_a_device_is_refused(source):
    for device in ("/dev/full", "/dev/null"):
        assert "it is not a regular file" in refused(call("render", source, device))


def test_an_output_that_is_a_circle_of_links_is_refused(source, tmp_path):
    (tmp_path / "circle.wav").symlink_to("circle.wav")
    assert "circle.wav" in refused(call("render", source, tmp_path / "circle.wav"))


@pytest.mark.parametrize("name", ["", "x" * 256 + ".wav"])
def test_an_output_with_a_name_that_no_file_has_is_refused(source, tmp_path, name, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused(call("render", source, name))
    assert listing(tmp_path).keys() == {"in.wav"}


@pytest.fixture
def nobodys(source):
    """A folder that anyone may enter, with a sound in it; root becomes nobody for the test."""
    as_root = os.geteuid() == 0
    # all that is needed later, while the program's own files may be read
    assert call("render", source, source.with_name("first.wav")).code == 0
    for module in ("check", "demo"):
        importlib.import_module(f"audioflinger_hook.cli.{module}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        (folder / "in.wav").write_bytes(source.read_bytes())
        for inside, mode in [("free", 0o777), ("closed", 0), ("read_only", 0o555)]:
            (folder / inside).mkdir()
            (folder / inside).chmod(mode)
        (folder / "free" / "protected.wav").write_bytes(b"old")
        (folder / "free" / "protected.wav").chmod(0o444)
        (folder / "free" / "secret.wav").write_bytes(source.read_bytes())
        (folder / "free" / "secret.wav").chmod(0)
        if as_root:
            os.seteuid(65_534)
        try:
            yield folder
        finally:
            if as_root:
                os.seteuid(0)
            (folder / "closed").chmod(0o755)


@pytest.mark.parametrize("name", ["read_only/out.wav", "closed/out.wav"])
def test_an_output_folder_that_may_not_be_written_is_refused(nobodys, name):
    error = refused(call("render", nobodys / "in.wav", nobodys / name))
    assert f"no permission to write in folder {(nobodys / name).parent}" in error
    assert listing(nobodys / "read_only") == {}


def test_a_write_protected_output_is_refused_and_kept(nobodys):
    protected = nobodys / "free" / "protected.wav"
    assert "write-protected" in refused(call("render", nobodys / "in.wav", protected))
    assert protected.read_bytes() == b"old"


@pytest.mark.parametrize("command", READERS)
@pytest.mark.parametrize("name", ["free/secret.wav", "closed/in.wav"])
def test_a_sound_that_may_not_be_read_is_refused(nobodys, command, name):
    done = read_by(command, nobodys / name, nobodys / "free" / "out.wav")
    assert "may not be read" in refused(done)
    assert not (nobodys / "free" / "out.wav").exists()


@pytest.mark.exhaustive
def test_a_demo_folder_that_may_not_be_made_or_written_is_refused(nobodys):
    for name in ("read_only/out", "read_only"):
        error = refused(call("demo", "--fast", "--out", nobodys / name))
        assert str(nobodys / name) in error


def test_a_config_that_may_not_be_read_is_refused(nobodys):
    secret = nobodys / "free" / "secret.wav"
    assert "Permission denied" in refused(call("check", "--config", secret))
    assert str(nobodys) in refused(call("check", "--config", nobodys / "closed" / "c.toml"))


# --- one file named twice


def test_an_output_that_is_the_input_is_refused_however_it_is_named(source, tmp_path, monkeypatch):
    before = listing(tmp_path)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    Path("link.wav").symlink_to(source)
    for name in (source, "in.wav", "folder/../in.wav", "link.wav"):
        error = refused(call("render", source, name))
        assert "name two files" in error
        refused(call("render", source, "out.wav", "--acceleration", name))
        refused(call("render", name, source))
        assert listing(tmp_path) == before | {"link.wav": before["in.wav"]}


def test_an_acceleration_that_is_the_output_is_refused(source, out):
    for name in (out, out.parent / ".." / out.parent.name / out.name):
        error = refused(call("render", source, out, "--acceleration", name))
        assert "the vibration" in error
        assert "the acceleration" in error
    assert listing(out.parent) == {out.name: b"old"}


# --- disks that fill up


@pytest.mark.exhaustive
def test_a_limit_on_file_sizes_is_a_write_error_and_leaves_everything_as_it_was(tmp_path, out):
    source = sound(tmp_path / "in.wav", noise(RATE, 2))

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))

    felt = out.with_name("felt.wav")
    done = cushion("render", source, out, "--acceleration", felt, preexec_fn=limit)
    assert "the file would be larger than allowed; raise the limit" in refused(done, 5)
    assert listing(out.parent) == {out.name: b"old"}


@pytest.fixture
def small_disk(tmp_path):
    """A filesystem of 1 MB; only root may mount one."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("a small disk can be mounted by root only: sudo make test")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_a_full_disk_is_a_write_error_and_leaves_everything_as_it_was(tmp_path, small_disk, out):
    source = sound(tmp_path / "in.wav", noise(10 * RATE))  # 1.9 MB of vibration
    path = small_disk / "vibration.wav"
    path.write_bytes(b"old")
    for options in ([path], [out, "--acceleration", path], [path, "--acceleration", out]):
        error = refused(call("render", source, *options), 5)
        assert f"cannot write {path}: the disk is full" in error
        assert listing(small_disk) == {path.name: b"old"}
        assert listing(out.parent) == {out.name: b"old"}
    assert os.statvfs(small_disk).f_bavail > 200  # the room is free again


@pytest.mark.exhaustive
def test_a_full_disk_stops_the_demo(small_disk):
    error = refused(call("demo", "--fast", "--out", small_disk), 5)
    assert "the disk is full" in error
    assert listing(small_disk) == {}


def test_an_acceleration_that_cannot_be_finished_leaves_the_older_vibration(tmp_path, source, out):
    folder = tmp_path / "vanishing"
    folder.mkdir()

    def vanish(_done, _all):
        if folder.exists():
            folder.rmdir()  # nothing in it has a name yet

    with pytest.raises(WriteError, match=r"felt\.wav"):
        render_file(source, out, acceleration=folder / "felt.wav", progress=vanish)
    assert listing(out.parent) == {out.name: b"old"}


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
    assert (done.code, done.stderr) == (0, "")
    assert len(vibration(out)) == 9_600


@pytest.mark.sweep
@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["render", "--help"]])
def test_a_reader_that_has_gone_is_no_error(arguments):
    ours, theirs = os.pipe()
    os.close(ours)
    try:
        done = cushion(*arguments, stdout=theirs)
    finally:
        os.close(theirs)
    assert (done.code, done.stderr) == (0, "")


# --- the end in the middle


def has_nameless_files(folder):
    """Whether a file can be written here before it has a name."""
    try:
        os.close(os.open(folder, os.O_TMPFILE | os.O_WRONLY))
    except (OSError, AttributeError):
        return False
    return True


@pytest.fixture(scope="module")
def long_source(tmp_path_factory):
    """A minute of stereo noise, the costliest sound: seconds of work for both channels."""
    path = tmp_path_factory.mktemp("long") / "in.wav"
    second = noise(RATE, 2)
    with soundfile.SoundFile(path, "w", RATE, 2, "PCM_16") as file:
        for _ in range(60):
            file.write(second)
    return path


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", ["SIGKILL", "SIGTERM", "SIGINT"])
def test_a_signal_in_the_middle_leaves_the_folder_as_it_was(long_source, out, name):
    if name == "SIGKILL" and not has_nameless_files(out.parent):
        pytest.skip("on this filesystem kill -9 leaves a hidden .part file")
    options = ["--channels", "each", "--acceleration", out.parent / "felt.wav"]
    number = signal.Signals[name]
    with start("render", long_source, out, *options) as process:
        until(lambda: sum(held_back(process, out.parent)) > 400_000, process)
        process.send_signal(number)
        stdout, stderr = process.communicate(timeout=10)
    assert listing(out.parent) == {out.name: b"old"}
    assert stdout == ""
    if number == signal.SIGKILL:
        assert (process.returncode, stderr) == (-signal.SIGKILL, "")
    else:
        assert (process.returncode, stderr) == (130, "cushion: interrupted\n")


@pytest.mark.exhaustive
def test_an_interrupted_demo_leaves_nothing(tmp_path):
    out = tmp_path / "out"
    with start("demo", "--out", out) as process:
        # The whole sound and half a second of vibration: in the middle of what lasts 15 s.
        half_a_second = 4 * RATE // 2
        until(lambda: sum(n > half_a_second for n in held_back(process, out)) > 1, process)
        process.send_signal(signal.SIGINT)
        stdout, stderr = process.communicate(timeout=10)
    assert (process.returncode, stdout, stderr) == (130, "", "cushion: interrupted\n")
    assert not listing(out)


# --- wrong usage


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["play"], "'play'"),
        (["rendr", "a", "b"], "did you mean render?"),
        (["--loud"], "--loud"),
        (["render"], "IN, OUT"),
        (["render", "a.wav"], "OUT"),
        (["render", "a.wav", "b.wav", "c.wav"], "c.wav"),
        (["render", "a.wav", "b.wav", "--loud"], "--loud"),
        (["render", "a.wav", "b.wav", "--transform"], "--transform"),
        (["render", "a.wav", "b.wav", "--json=yes"], "--json"),
        (["inspect"], "IN"),
        (["inspect", "a.wav", "--at"], "--at"),
        (["inspect", "a.wav", "--unit", "3"], "--unit"),
        (["check", "config.toml"], "config.toml"),
        (["demo", "--slow"], "--slow"),
    ],
)
def test_wrong_usage_is_answered_with_what_is_wrong_and_where_to_look(arguments, words):
    error = refused(call(*arguments))
    assert words in error
    assert "--help" in error


@pytest.mark.parametrize("command", ["demo", "render", "inspect", "check"])
def test_every_command_has_its_help_with_an_example(command):
    done = call(command, "--help")
    assert (done.code, done.stderr) == (0, "")
    assert f"cushion {command}" in done.stdout
    assert f"example: cushion {command}" in done.stdout
    whole = call("--help").stdout
    assert command in whole
    assert "130 interrupted" in " ".join(whole.split())


def test_without_a_command_the_help_ends_with_the_next_step():
    done = call()
    assert (done.code, done.stderr) == (0, "")
    assert "usage: cushion" in done.stdout
    assert "next: `cushion setup`" in done.stdout


def test_the_rule_for_usb_devices_needs_no_device(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    done = call("install-service", "--udev")
    assert (done.code, done.stderr) == (0, "")
    assert "70-cushion.rules" in done.stdout
    assert listing(tmp_path) == {}


def test_standard_output_takes_no_wav(source, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "name a file" in refused(call("render", source, "-"))
    assert not (tmp_path / "-").exists()


def test_an_error_is_one_line_whatever_its_words_hold(tmp_path, out):
    error = refused(call("render", tmp_path / "two\nlines\r.wav", out))
    assert "does not exist" in error
    refused(call("render", "a", "b", "--lo\nud"))
    refused(call("in\nspect"))


@pytest.mark.exhaustive
def test_errors_of_a_process_are_those_of_a_call(tmp_path, out):
    for arguments in (["render", tmp_path / "none.wav", out], ["check", "--config", "none"]):
        assert cushion(*arguments) == call(*arguments)


# --- faults of our own


def test_a_fault_of_the_program_is_one_line_and_code_5(source, out, monkeypatch):
    def divide(*_arguments, **_options):
        raise ZeroDivisionError("in two\nlines")

    monkeypatch.setattr("audioflinger_hook.cli.render.render_file", divide)
    done = call("render", source, out)
    assert (done.code, done.stdout) == (5, "")
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("cushion: error: ZeroDivisionError: in two lines; ")
    assert "fault of cushion" in done.stderr


@pytest.mark.parametrize("place", ["before the command", "after it"])
def test_debug_shows_where_an_error_came_from(tmp_path, out, place):
    arguments = ["render", tmp_path / "none.wav", out]
    done = (
        call("--debug", *arguments) if place.startswith("before") else call(*arguments, "--debug")
    )
    assert done.code == 2
    assert done.stderr.startswith("Traceback")
    *_, last = done.stderr.splitlines()
    assert last == refused(call(*arguments))


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
