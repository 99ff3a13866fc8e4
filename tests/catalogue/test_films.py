import json
import os
import re
import sys
from fractions import Fraction

import av
import numpy as np
import pytest
from scipy.signal import correlate, correlation_lags

from audioflinger_hook.catalogue.addresses import scrubbed
from audioflinger_hook.sources.film import FilmTap
from device.errors import UsageError
from tests.support.catalogues import expected, library, manifest, record, results
from tests.support.commands import call, cushion, refused, sound
from tests.support.taps import frames_of

RATE = 48_000
PIECE = 1_024


def film(path, tracks=(("eng", 1.0, 300.0),), *, codec="flac", start_s=0.0, hole=None):
    """Write a film with tracks (language, s, Hz of a tone) that begin at start_s with a hole, s."""
    with av.open(str(path), "w") as container:
        video = container.add_stream("mpeg4", rate=25)
        video.width, video.height, video.pix_fmt = 64, 64, "yuv420p"
        streams = []
        for language, _, _ in tracks:
            stream = container.add_stream(codec, rate=RATE, layout="stereo")
            stream.metadata["language"] = language
            streams.append(stream)
        for number in range(25):
            frame = av.VideoFrame.from_ndarray(np.zeros((64, 64, 3), np.uint8), "rgb24")
            frame.pts, frame.time_base = number, Fraction(1, 25)
            container.mux(video.encode(frame))
        container.mux(video.encode())
        for stream, (_, length_s, tone_hz) in zip(streams, tracks, strict=True):
            frames = round(length_s * RATE)
            wave = tone(frames, tone_hz)
            for first in range(0, frames, PIECE):
                if hole and hole[0] * RATE <= first < hole[1] * RATE:
                    continue
                piece = np.clip(wave[first : first + PIECE], -1.0, 1.0)
                packed = np.ascontiguousarray((piece * 32_767).astype(np.int16).reshape(1, -1))
                heard = av.AudioFrame.from_ndarray(packed, format="s16", layout="stereo")
                heard.sample_rate = RATE
                heard.time_base = Fraction(1, RATE)
                heard.pts = first + round(start_s * RATE)
                container.mux(stream.encode(heard))
            container.mux(stream.encode())
    return path


def tone(frames, tone_hz):
    time_s = np.arange(frames) / RATE
    wave = 0.4 * np.sin(2 * np.pi * tone_hz * time_s) * (0.6 + 0.4 * np.sin(20.0 * time_s))
    return np.column_stack([wave, 0.5 * wave])


@pytest.mark.parametrize("ending", ["mkv", "mp4"])
def test_a_lossless_track_is_read_to_the_last_sample(tmp_path, ending):
    got = frames_of(FilmTap(film(tmp_path / f"a.{ending}")))
    expected = (tone(RATE, 300.0) * 32_767).astype(np.int16) / 32_768
    assert np.array_equal(got, expected.astype(np.float32))


def test_a_film_gives_the_bytes_of_its_sound_as_a_file(tmp_path):
    film(tmp_path / "a.mkv")
    sound(tmp_path / "a.wav", frames_of(FilmTap(tmp_path / "a.mkv")), RATE)
    assert call("render", tmp_path / "a.wav", tmp_path / "alone.wav").code == 0
    listed = manifest(tmp_path / "l.jsonl", {"audio": "a.mkv"})
    assert call("catalogue", listed, "--out", tmp_path / "out").code == 0
    assert (tmp_path / "out/a.wav").read_bytes() == (tmp_path / "alone.wav").read_bytes()


def test_track_and_language_can_be_chosen(tmp_path):
    tracks = (("eng", 0.5, 200.0), ("fra", 0.5, 400.0), ("eng", 0.5, 800.0))
    path = film(tmp_path / "a.mkv", tracks)
    for tone_hz, chosen in (
        *((200.0, {"track": 1}), (800.0, {"track": 3}), (400.0, {"language": "fra"})),
        *((200.0, {"language": "eng"}), (800.0, {"track": 3, "language": "eng"})),
    ):
        frames = frames_of(FilmTap(path, **chosen))[:, 0]
        found = np.abs(np.fft.rfft(frames * np.hanning(len(frames)))).argmax()
        assert found * RATE / len(frames) == pytest.approx(tone_hz, abs=5.0), chosen
    lines = [{"audio": "a.mkv", "id": "one"}, {"audio": "a.mkv", "id": "two", "track": 3}]
    run = ("catalogue", manifest(tmp_path / "l.jsonl", *lines), "--out", tmp_path / "out")
    assert call(*run, "--language", "fra").code == 2
    assert record(tmp_path / "out", "one.wav")["frames"] == RATE // 2
    assert call(*run, "--language", "eng").code == 0


def test_a_track_that_is_not_there_is_refused_with_those_that_are(tmp_path):
    path = film(tmp_path / "a.mkv")
    for track, language, words in (
        (2, None, r"has no sound track 2; there are 1 \(eng\)"),
        (None, "deu", r"has no sound track in 'deu'; there are 1 \(eng\)"),
        (1, "deu", "is not deu"),
    ):
        with pytest.raises(UsageError, match=words):
            FilmTap(path, track=track, language=language)


def test_sound_that_begins_late_or_pauses_keeps_its_place(tmp_path):
    late = frames_of(FilmTap(film(tmp_path / "late.mkv", start_s=0.5)))
    first = int(np.flatnonzero(np.abs(late[:, 0]) > 1e-3)[0])
    assert first == pytest.approx(0.5 * RATE, abs=0.002 * RATE)  # Matroska counts milliseconds
    paused = frames_of(FilmTap(film(tmp_path / "hole.mkv", codec="pcm_s16le", hole=(0.3, 0.6))))
    assert len(paused) == pytest.approx(RATE, abs=0.002 * RATE)
    assert not paused[round(0.34 * RATE) : round(0.58 * RATE)].any()
    assert paused[round(0.7 * RATE) :].any()


def test_aac_is_aligned_within_a_packet(tmp_path):
    got = frames_of(FilmTap(film(tmp_path / "a.mp4", codec="aac")))
    expected = tone(RATE, 300.0)
    # correlation tells the delay: the tone's swell makes it unique
    lags = correlation_lags(len(got), len(expected))
    assert abs(lags[correlate(got[:, 0], expected[:, 0]).argmax()]) <= PIECE


def test_a_film_without_sound_and_a_broken_film_fail_alone(tmp_path):
    film(tmp_path / "good.mkv")
    film(tmp_path / "mute.mkv", ())
    whole = film(tmp_path / "torn.mp4").read_bytes()
    (tmp_path / "torn.mp4").write_bytes(whole[: len(whole) // 3])
    (tmp_path / "text.mkv").write_text("no film")
    (tmp_path / "empty.mkv").touch()
    done = call("catalogue", tmp_path, "--out", tmp_path / "out", "--workers", 1)
    assert done.code == 2
    told = sorted(line for line in done.stderr.splitlines() if "error" in line)
    failed = [path.split(".")[0].rpartition("/")[2] for path in told]
    assert failed == ["empty", "mute", "text", "torn"]
    assert "has no sound track" in told[1]
    assert "fault of cushion" not in done.stderr
    assert (tmp_path / "out/good.wav").exists()


@pytest.mark.parametrize("seed", range(6))
def test_damaged_films_never_raise_anything_else(tmp_path, seed):
    content = bytearray(film(tmp_path / "a.mkv").read_bytes())
    random = np.random.default_rng(seed)
    for place in random.integers(200, len(content), 60):
        content[place] = random.integers(256)
    (tmp_path / "a.mkv").write_bytes(content)
    done = call("catalogue", tmp_path / "a.mkv", "--out", tmp_path / "out", "--workers", 1)
    assert done.code in (0, 2)
    assert "fault of cushion" not in done.stderr


def test_without_pyav_the_error_names_the_extra(tmp_path, monkeypatch):
    path = film(tmp_path / "a.mkv")
    monkeypatch.setitem(sys.modules, "av", None)
    done = call("catalogue", path, "--out", tmp_path / "out", "--workers", 1)
    assert done.code == 2
    assert "pip install 'haptic-cushion[films]'" in done.stderr


SIGNED = "https://user:hidden1@host/a.wav?X-Amz-Credential=hidden2&X-Amz-Signature=hidden3#hidden4"


@pytest.mark.parametrize(
    "arguments",
    [
        *((SIGNED, "--out", "o"), ("list.jsonl", "--out", "o"), ("list.csv", "--out", "o")),
        *(("in", "--out", SIGNED), ("in", "--out", "s3://hidden5:hidden6@bucket/x")),
        ("in", "--out", "o", "--dask", "tls://me:hidden7@127.0.0.1:1"),
    ],
)
def test_credentials_in_addresses_are_refused_and_never_shown(tmp_path, arguments, monkeypatch):
    monkeypatch.chdir(tmp_path)
    library(tmp_path / "in", 1)
    manifest(tmp_path / "list.jsonl", {"audio": SIGNED}, {"audio": "s3://a:hidden8@b/c.wav"})
    (tmp_path / "list.csv").write_text(f"audio\n{SIGNED}\n")
    done = call("catalogue", *arguments, "--debug")
    assert done.code in (2, 4)
    written = [path.read_text() for path in tmp_path.rglob("*.json*") if path.name != "list.jsonl"]
    for text in (done.stdout, done.stderr, *written):
        assert not re.search(r"hidden\d", text)


@pytest.mark.parametrize(
    "text",
    [
        "sent Authorization: Bearer hidden1",
        "headers {'Authorization': 'Bearer hidden1', 'Cookie': 'a=hidden2; b=hidden3'}",
        '{"password": "hidden1 hidden2"}',
        'told "{\\"access_token\\": \\"hidden1 hidden2\\"}"',
        "GET /a/blob.wav?sv=2020&sig=hidden1%3D",
        "signed with aB1/hidden1/+xyz",
    ],
)
def test_what_storages_say_of_credentials_is_left_out(text, monkeypatch):
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "aB1/hidden1/+xyz")
    monkeypatch.setenv("SOME_KEY_FILE", "/etc/hosts")
    found = scrubbed(f"/etc/hosts: {text}")
    assert "hidden" not in found
    assert found.startswith("/etc/hosts: ")


def test_without_fsspec_local_paths_work_and_urls_name_the_extra(tmp_path, monkeypatch):
    folder = library(tmp_path / "in", 2)
    lacking = dict.fromkeys(("fsspec", "s3fs", "dask", "distributed", "av"))
    without = f"import sys\nsys.modules |= {lacking}\n"
    done = cushion("catalogue", folder, "--out", tmp_path / "o", "--workers", 1, prelude=without)
    assert (done.code, done.stderr) == (0, "")
    for name in lacking:
        monkeypatch.setitem(sys.modules, name, None)
    for arguments, extra in (
        ((folder, "--out", "s3://bucket/x"), "remote"),
        (("s3://bucket/x", "--out", tmp_path / "o"), "remote"),
        ((folder, "--out", tmp_path / "o", "--dask", "local"), "cluster"),
    ):
        assert f"haptic-cushion[{extra}]" in refused(call("catalogue", *arguments))


def test_a_storage_without_whole_uploads_gets_a_new_name_last(tmp_path, monkeypatch):
    from fsspec.implementations.local import LocalFileSystem

    seen, put_file = [], LocalFileSystem.put_file

    def watched(self, source, target, *arguments, **options):
        seen.append(os.path.basename(target))  # noqa: PTH119
        return put_file(self, source, target, *arguments, **options)

    monkeypatch.setattr(LocalFileSystem, "put_file", watched)
    folder, out = library(tmp_path / "in", 2), f"local://{tmp_path}/out"
    for state in ("rendered", "skipped"):
        done = call("catalogue", folder, "--out", out, "--workers", 1, "--json")
        assert json.loads(done.stdout)[state] == 2
    assert results(tmp_path / "out") == expected(folder, tmp_path)
    assert all(name.startswith(".") and name.endswith(".part") for name in seen)
    assert not [name for name in os.listdir(tmp_path / "out") if name.startswith(".")]  # noqa: PTH208
