"""Vibration as float32 WAV files: what readers find in them, and what a failing disk does."""

import os
import resource
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import soundfile
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import wavfile

from device.errors import InternalError, WriteError
from device.wav_output import WavOutput, wav_header
from tests.support.commands import listing
from tests.support.taps import noise


def written(path, blocks, samplerate=48_000, channels=2, **options):
    output = WavOutput(path, samplerate, channels, **options)
    for block in blocks:
        output.write(block)
    output.close()
    return Path(path)


@pytest.mark.parametrize("channels", [1, 2, 5, 64])
@pytest.mark.parametrize("samplerate", [1_000, 44_100, 192_000])
def test_libsndfile_and_scipy_read_back_what_was_written(tmp_path, samplerate, channels):
    vibration = noise(1_000, channels)
    path = written(tmp_path / "a.wav", [vibration], samplerate, channels)
    info = soundfile.info(path)
    assert (info.format, info.subtype) == ("WAV", "FLOAT")
    for samples, rate in (soundfile.read(path, dtype="float32"), wavfile.read(path)[::-1]):
        assert rate == samplerate
        assert np.array_equal(samples.reshape(-1, channels), vibration.astype(np.float32))


@given(st.lists(st.integers(0, 50)), st.sampled_from([np.float32, np.float64]))
def test_equal_vibration_gives_equal_bytes_however_it_is_split(tmp_path_factory, sizes, dtype):
    folder = tmp_path_factory.mktemp("split")
    vibration = noise(sum(sizes)).astype(dtype)
    blocks = np.split(vibration, np.cumsum(sizes)[:-1]) if sizes else []
    split = written(folder / "split.wav", blocks)
    whole = written(folder / "whole.wav", [np.asfortranarray(vibration)])
    assert split.read_bytes() == whole.read_bytes()


@pytest.mark.parametrize("frames", [0, 3])
@pytest.mark.parametrize("comment", ["profile paper", "odd", "Grüße", ""])
def test_the_comment_is_the_files_comment(tmp_path, comment, frames):
    path = written(tmp_path / "a.wav", [noise(frames)], comment=comment)
    with soundfile.SoundFile(path) as file:
        assert (file.comment, file.frames) == (comment, frames)


@pytest.mark.parametrize("comment", [None, "long recording"])
def test_a_file_over_4_gb_is_rf64(tmp_path, comment):
    path = tmp_path / "long.wav"
    small, frames = 2**20, 2**30 + 5
    header = wav_header(48_000, 1, frames, comment)
    assert len(header) == len(wav_header(48_000, 1, small, comment))
    with path.open("wb") as file:
        file.write(header)
        file.truncate(len(header) + 4 * frames)  # a hole: takes no room on the disk
    info = soundfile.info(path)
    assert (info.format, info.subtype, info.frames) == ("RF64", "FLOAT", frames)


def test_the_last_frame_that_fits_a_wav_file_is_still_in_one(tmp_path):
    frames = (2**32 - 2 - (len(wav_header(48_000, 1, 0)) - 8)) // 4
    assert wav_header(48_000, 1, frames).startswith(b"RIFF")
    assert wav_header(48_000, 1, frames + 1).startswith(b"RF64")


@pytest.mark.parametrize(("samplerate", "channels"), [(0, 1), (48_000, 0), (48_000, 16_384)])
def test_what_a_header_cannot_say_is_refused_and_leaves_no_file(tmp_path, samplerate, channels):
    with pytest.raises(InternalError, match="samplerate="):
        WavOutput(tmp_path / "a.wav", samplerate, channels)
    assert list(tmp_path.iterdir()) == []


def test_a_block_of_another_shape_is_refused(tmp_path):
    output = WavOutput(tmp_path / "a.wav", 48_000, 2)
    for shape in [(10,), (10, 3), (10, 2, 1)]:
        with pytest.raises(InternalError, match="shape"):
            output.write(np.zeros(shape))
    output.abort()


def test_the_first_of_close_and_abort_counts(tmp_path):
    for name in ("close", "abort"):
        output = WavOutput(tmp_path / name, 48_000, 2)
        for ending in (getattr(output, name), output.abort, output.close):
            ending()
        with pytest.raises(InternalError, match="closed"):
            output.write(noise(1))
    assert [path.name for path in tmp_path.iterdir()] == ["close"]


def test_memory_stays_flat(tmp_path):
    block = noise(10_000).astype(np.float32)
    output = WavOutput(tmp_path / "a.wav", 48_000, 2)
    output.write(block)
    tracemalloc.start()
    for _ in range(100):
        output.write(block)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    output.close()
    assert peak < block.nbytes  # of 100 times that


# Reached within the header, between two blocks, within a block.
@pytest.mark.sweep
@pytest.mark.parametrize("limit", [50, len(wav_header(48_000, 2, 0)) + 26 * 3_840, 1_000_001])
def test_a_file_size_limit_is_a_write_error_and_leaves_no_file(tmp_path, limit):
    (tmp_path / "a.wav").write_bytes(b"old")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        with pytest.raises(WriteError, match=r"than allowed; raise the limit \(ulimit -f\)"):
            written(tmp_path / "a.wav", [np.zeros((480, 2))] * 2_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert listing(tmp_path) == {"a.wav": b"old"}


def test_a_disk_that_fills_up_is_a_write_error_and_keeps_the_old_file(small_disk):
    (small_disk / "a.wav").write_bytes(b"old")
    output = WavOutput(small_disk / "a.wav", 48_000, 2)

    def fill():
        for _ in range(1_000):
            output.write(noise(480))

    with pytest.raises(WriteError, match="disk is full"):
        fill()
    output.close()  # has nothing left to finish
    assert listing(small_disk) == {"a.wav": b"old"}
    assert os.statvfs(small_disk).f_bavail >= 6  # of 8 blocks: the room is free again


def test_a_file_that_is_not_as_long_as_it_must_be_is_discarded(tmp_path, monkeypatch):
    output = WavOutput(tmp_path / "a.wav", 48_000, 2)
    output.write(noise(480))
    monkeypatch.setattr("device.atomic_file.AtomicFile.size", lambda file: 1_000)
    with pytest.raises(WriteError, match="1000 of 39"):
        output.close()
    assert list(tmp_path.iterdir()) == []
