import json
import tracemalloc
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import soundfile

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.exports.export import ExportOptions, export
from audioflinger_hook.exports.options import FORMATS, LONG
from audioflinger_hook.sources import TapClient
from device.errors import UsageError
from tests.support.commands import RATE, call, document, listing, noise, refused, sound
from tests.support.signals import tone
from tests.support.taps import BufferTap


@pytest.fixture
def source(tmp_path: Path) -> Path:
    return sound(tmp_path / "in.wav", noise(RATE // 2))


@pytest.mark.parametrize("name", FORMATS)
def test_a_name_s_ending_or_an_option_is_the_format(name: str, source: Path, folder: Path) -> None:
    before = source.read_bytes()
    assert "name two files" in refused(call("export", source, source, "--format", name))
    assert source.read_bytes() == before
    for suffix in FORMATS[name].suffixes:
        report = json.loads(call("export", source, folder / f"out{suffix}", "--json").stdout)
        assert (report["format"], report["frames"]) == (name, RATE // 2)
        assert report["bytes"] == (folder / f"out{suffix}").stat().st_size
    done = call("export", source, folder / "out", "--format", name, "--json")
    assert json.loads(done.stdout)["format"] == name


def test_protection_reports_the_exposure(source: Path, folder: Path) -> None:
    report = document("export", source, folder / "out.wav", "--protection", "on")
    assert report["exposure"]["a8_m_s2"] > 0.0


REFUSED = {
    "out.ahpa": "has no ending of a known format; did you mean .ahap?",
    "out": "has no ending of a known format",
    "out.wav --format hapic": "format 'hapic' is not known; did you mean 'haptic'?",
    "out.wav --output-rate 999": "output_rate_hz=999 is out of range; allowed: 1000",
    "out.ahap --output-rate 1000": "holds no waveform; leave it out",
    "out.flac --output-rate 65537": "allowed: 1000 to 655350 Hz, above 65535 Hz in steps of 10 Hz",
    "out.flac --output-rate 655360": "is out of range; allowed: 1000 to 655350",
    "out.ogg --output-rate 8000": "holds the sound at its own rate; leave it out",
    "out.wav --device-band 55:200": "does not fit the format wav",
    "out.ahap --device-band 19:200": "is out of range; allowed: LOW:HIGH from 20",
    "out.ahap --device-band 200:55": "is out of range",
    "out.ahap --device-band nan:200": "is out of range",
    "out.ahap --device-band 200": "'200' is not a band; allowed: LOW:HIGH in Hz",
    "out.ahap --transform reference": "use --transform live",
    "out.ahap --damping auto": "cannot hold damping",
    "-": "name a file",
    "missing/out.ahap": "does not exist; create it or name another",
}


@pytest.mark.parametrize(("line", "said"), REFUSED.items())
def test_what_cannot_be_exported_is_refused_in_one_line(line, said, source, folder, monkeypatch):
    monkeypatch.chdir(folder)
    assert said in refused(call("export", source, *line.split()))
    assert listing(folder) == {}


@pytest.mark.parametrize("name", FORMATS)
def test_unusable_samples_are_0_no_frames_refused(name: str, tmp_path: Path, folder: Path) -> None:
    empty = sound(tmp_path / "empty.wav", np.zeros((0, 1)))
    assert "0 frames" in refused(call("export", empty, folder / "out", "--format", name))
    assert listing(folder) == {}
    bad = sound(tmp_path / "in.wav", np.full((5_000, 1), np.nan))
    report = document("export", bad, folder / "out", "--format", name)
    assert (report["replaced_samples"], report["peak"]) == (5_000, 0.0)


@pytest.mark.parametrize("name", FORMATS)
def test_64_channels_are_mixed_or_refused(name: str, tmp_path: Path, folder: Path) -> None:
    many = sound(tmp_path / "in.wav", noise(4_800, 64))
    done = call("export", many, folder / "out", "--format", name)
    if name == "ogg-haptic":
        assert "cannot hold 64 channels of sound; allowed: 1 to 8" in refused(done)
    assert (done.code == 0) == (name != "ogg-haptic") == bool(listing(folder))


HELD = [  # format, rate of the sound, rate of the file
    ("flac", 65_535, 65_535), ("flac", 65_537, 192_000), ("flac", 65_540, 65_540),
    ("flac", 655_350, 655_350), ("flac", 655_360, 192_000), ("flac", 768_000, 192_000),
    ("ogg-haptic", 1_000, 1_000), ("ogg-haptic", 200_000, 200_000),
    ("ogg-haptic", 200_001, 192_000), ("ogg-haptic", 768_000, 192_000), ("wav", 768_000, 768_000),
]  # fmt: skip


@pytest.mark.parametrize(("name", "rate_hz", "file_hz"), HELD)
def test_a_rate_that_a_format_cannot_have_is_resampled(name, rate_hz, file_hz, tmp_path, folder):
    wave = 0.3 * tone(90.0, 0.5, rate_hz)[:, None]
    source = sound(tmp_path / "in.wav", wave, rate_hz)
    done = call("export", source, folder / "out", "--format", name, "--json")
    report = json.loads(done.stdout)
    assert ("cannot have" in done.stderr) == (rate_hz != file_hz)
    frames, found_hz = soundfile.read(folder / "out", always_2d=True)
    assert (found_hz, len(frames)) == (file_hz, report["frames"])
    assert len(frames) == -(-len(wave) * file_hz // rate_hz)
    if name == "ogg-haptic":
        error = frames[:, 0] - 0.3 * tone(90.0, len(frames) / file_hz, file_hz)
        assert np.std(error) < 0.02  # Vorbis is lossy


@pytest.mark.parametrize("name", FORMATS)
def test_a_full_disk_is_a_write_error_and_leaves_everything_as_it_was(name, tmp_path, small_disk):
    rng = np.random.default_rng(5)
    # Struck every 0.1 s, so that every format has much to write; text takes more than samples do.
    strokes = 6 if name == "hjif" else 300
    struck = np.tile(np.exp(-np.arange(4_800) / 600.0), strokes)
    struck *= rng.standard_normal(strokes * 4_800)
    source, path = sound(tmp_path / "in.wav", 0.3 * struck), small_disk / "out"
    path.write_bytes(b"old")
    error = refused(call("export", source, path, "--format", name, "--profile", "paper"), 5)
    assert f"cannot write {path}: the disk is full" in error
    assert listing(small_disk) == {"out": b"old"}


def again(second: Any, seconds: int) -> BufferTap:
    """One second of sound for as long as wanted."""
    return BufferTap(*[(second, len(second), False)] * seconds)


@pytest.mark.parametrize("name", [name for name, one in FORMATS.items() if one.whole])
@pytest.mark.parametrize("length_known", [True, False])
def test_two_hours_are_refused_at_the_start(name, length_known, folder, monkeypatch):
    tap = again(np.zeros((1_000, 1), np.float32), 7_200)
    if not length_known:
        monkeypatch.setattr(BufferTap, "frames_expected", None)
    read = Mock(wraps=tap.read)
    monkeypatch.setattr(tap, "read", read)
    with pytest.raises(UsageError, match=r"too long for the format .* allowed: 3600 s; .* ogg"):
        export(TapClient(tap), folder / "out", Settings(), ExportOptions(name))
    assert listing(folder) == {}
    assert not read.called if length_known else 3_600 < read.call_count < 3_700


@pytest.mark.parametrize("name", LONG)
def test_a_long_sound_is_told_at_the_start(name: str, tmp_path: Path, folder: Path) -> None:
    for more_s in (0, 1):
        silence = np.zeros(1_000 * (LONG[name][0] + more_s))
        done = call(
            "export", sound(tmp_path / "in", silence, 1_000), folder / "o", "--format", name
        )
        assert (done.code, LONG[name][1] in done.stderr) == (0, more_s > 0)


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", [name for name, one in FORMATS.items() if not one.whole])
def test_memory_does_not_grow_with_the_length(name: str, folder: Path) -> None:
    second, out = noise(8_000).astype(np.float32), folder / "out"
    options, peaks = ExportOptions(name, 1_000 if name in ("wav", "flac") else None), []
    for seconds in (20, 20, 200):  # the first run loads what is loaded once
        tracemalloc.start()
        export(TapClient(again(second, seconds)), out, Settings(), options)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # The sound alone takes 5.8 MB more. Up to 16 blocks of glides, 95 kB each, wait for a thread.
    assert peaks[2] < peaks[1] + 1_600_000
    if name != "partials":
        assert soundfile.info(out).duration == 200.0
