"""`cushion render`: what stands in the files, what is said, and what it costs."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
import soundfile

from tests.support.commands import (
    RATE,
    call,
    cushion,
    environment,
    listing,
    noise,
    on_a_terminal,
    refused,
    sound,
    vibration,
)
from tests.support.recordings import require_recordings
from tests.support.signals import FORMS, burst, columns, envelope, one_sample, tone

KEYS = {"frames", "samplerate", "latency_s", "peak", "limited_samples", "replaced_samples"}


@pytest.fixture
def out(tmp_path):
    """Where the vibration goes: a path in a folder of its own."""
    folder = tmp_path / "out"
    folder.mkdir()
    return folder / "vibration.wav"


def rendered(source, out, *options):
    """The report of a rendering that works and has nothing to warn of."""
    done = call("render", source, out, "--json", *options)
    assert (done.code, done.stderr) == (0, "")
    return json.loads(done.stdout)


# --- what stands in OUT


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("mode", ["mono", "each"])
@pytest.mark.parametrize(
    ("samplerate", "channels", "frames"),
    [
        (48_000, 2, 20_000),
        (44_100, 1, 12_345),
        (8_000, 1, 4_000),
        (1_000, 3, 500),
        (192_000, 6, 9_999),
        (48_000, 64, 3_000),
        (48_000, 2, 1),  # shorter than a window, and than the latency
    ],
)
def test_out_is_float32_wav_of_the_inputs_rate_and_length(
    tmp_path, out, form, mode, samplerate, channels, frames
):
    source = sound(tmp_path / "in.wav", noise(frames, channels), samplerate)
    report = rendered(source, out, "--transform", form, "--channels", mode)
    info = soundfile.info(out)
    assert (info.format, info.subtype) == ("WAV", "FLOAT")
    assert (info.samplerate, info.frames) == (samplerate, frames)
    assert info.channels == (1 if mode == "mono" else channels)
    assert (report["samplerate"], report["frames"]) == (samplerate, frames)


def test_each_channel_of_each_is_what_a_file_of_that_channel_gives(tmp_path, out):
    channels = noise(20_000, 3)
    rendered(sound(tmp_path / "in.wav", channels), out, "--channels", "each")
    together = vibration(out)
    for number in range(3):
        rendered(sound(tmp_path / "one.wav", channels[:, number]), out)
        assert np.array_equal(vibration(out)[:, 0], together[:, number])


@pytest.mark.parametrize(
    ("container", "subtype"),
    [
        ("WAV", "PCM_24"),
        ("WAV", "PCM_32"),
        ("WAV", "FLOAT"),
        ("WAV", "DOUBLE"),
        ("WAVEX", "PCM_16"),
        ("RF64", "PCM_16"),
        ("FLAC", "PCM_16"),
        ("AIFF", "PCM_16"),
        ("AIFF", "FLOAT"),
        ("CAF", "PCM_16"),
        ("AU", "PCM_16"),
        ("W64", "PCM_24"),
    ],
)
def test_the_same_samples_in_another_lossless_format_give_the_same_bytes(
    tmp_path, out, container, subtype
):
    sixteen_bits = np.round(noise(20_000, 2) * 2**15).clip(-(2**15), 2**15 - 1) / 2**15
    reference = sound(tmp_path / "in.wav", sixteen_bits, subtype="PCM_16")
    other = sound(tmp_path / "other", sixteen_bits, format=container, subtype=subtype)
    rendered(reference, out)
    expected = out.read_bytes()
    rendered(other, out)
    assert np.abs(vibration(out)).max() > 0.01
    assert out.read_bytes() == expected


@pytest.mark.parametrize("subtype", ["VORBIS", "OPUS"])
def test_ogg_gives_the_length_and_nearly_the_vibration_of_what_was_encoded(tmp_path, out, subtype):
    samples = tone(440.0, 1.0, RATE, 0.5)
    rendered(sound(tmp_path / "in.wav", samples), out)
    expected = vibration(out)
    rendered(sound(tmp_path / "in.ogg", samples, format="OGG", subtype=subtype), out)
    assert len(vibration(out)) == RATE
    # A lossy coder keeps a steady tone's level within a dB or so.
    assert np.abs(vibration(out)).max() == pytest.approx(np.abs(expected).max(), rel=0.12)


def test_the_recordings_render_to_their_own_length(out):
    for recording in require_recordings()[::8]:
        report = rendered(recording, out)
        info = soundfile.info(recording)
        assert soundfile.info(out).frames == report["frames"] == info.frames
        assert soundfile.info(out).samplerate == info.samplerate


def test_the_same_command_gives_the_same_bytes_in_any_process_and_folder(tmp_path, out):
    source = sound(tmp_path / "in.wav", noise(30_000, 2))
    rendered(source, out)
    here = out.read_bytes()
    env = {"PYTHONHASHSEED": "7", "TZ": "Asia/Tokyo", "OMP_NUM_THREADS": "1"}
    done = cushion("render", "in.wav", "out/vibration.wav", cwd=tmp_path, env=env)
    assert (done.code, done.stderr) == (0, "")
    assert done.stdout.startswith("out/vibration.wav: 0.62 s of vibration, 1 channel at 48000 Hz")
    assert done.stdout.count("\n") == 1
    assert out.read_bytes() == here


def test_options_override_the_config_and_the_config_the_defaults(tmp_path, out):
    source = sound(tmp_path / "in.wav", noise(9_000, 2))
    config = tmp_path / "config.toml"
    config.write_text('[transform]\ntransform = "reference"\nchannels = "each"\n')
    assert rendered(source, out)["transform"] == "live"
    report = rendered(source, out, "--config", config)
    assert (report["transform"], report["channels"]) == ("reference", 2)
    report = rendered(source, out, "--config", config, "--transform", "live")
    assert (report["transform"], report["channels"]) == ("live", 2)


def test_the_users_own_config_does_not_change_what_render_publishes(tmp_path, out, monkeypatch):
    (tmp_path / "cushion").mkdir()
    (tmp_path / "cushion/config.toml").write_text('[transform]\ntransform = "reference"\n')
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    source = sound(tmp_path / "in.wav", noise(9_000))
    assert rendered(source, out)["transform"] == "live"


# --- the latency is taken out


def strength(path, low_pass_hz=60.0):
    """The envelope of a file's first channel."""
    return envelope(vibration(path)[:, 0].astype(float), RATE, low_pass_hz)


def test_a_burst_is_felt_where_it_is_heard(tmp_path, out):
    # The latency that is taken out is that of onsets: they stand where they are heard. An end is
    # known by the window alone, whose middle comes 35 ms later.
    onset_s = 0.5
    for hz in (80.0, 250.0, 1_000.0, 5_000.0):
        rendered(sound(tmp_path / "in.wav", burst(hz, onset_s, 1.5, RATE, 0.5)), out)
        level = strength(out)
        half = 0.5 * np.median(level[round(0.6 * RATE) : round(0.7 * RATE)])
        above = np.flatnonzero(level > half) / RATE
        assert above[0] == pytest.approx(onset_s, abs=0.005)
        assert above[-1] == pytest.approx(onset_s + 0.25 + 0.035, abs=0.015)


@pytest.mark.parametrize("samplerate", [44_100, 48_000])
def test_a_click_is_felt_from_the_moment_on_at_which_it_is_heard(tmp_path, out, samplerate):
    source = sound(tmp_path / "in.wav", one_sample(1.0, samplerate, 0.5), samplerate)
    rendered(source, out)
    power = vibration(out)[:, 0].astype(float) ** 2
    centre_s = (power * np.arange(power.size)).sum() / power.sum() / samplerate
    assert 0.5 < centre_s < 0.545
    window_s, hop_s = 0.04643, 0.018
    ringing_s = 3 * hop_s  # a fade of a hop, then the low-pass
    felt_s = np.flatnonzero(power > 1e-3 * power.max()) / samplerate
    assert felt_s[0] > 0.5 - 0.005
    assert felt_s[-1] < 0.5 + window_s + ringing_s


def test_the_envelopes_of_the_two_forms_line_up(tmp_path, out):
    # Bursts of random lengths, so that no burst keeps its place in the reference's units.
    generator = np.random.default_rng(5)
    switches = np.cumsum(generator.uniform(0.08, 0.4, 60))
    seconds = 8.0
    sounding = np.searchsorted(switches, np.arange(round(seconds * RATE)) / RATE) % 2
    source = sound(tmp_path / "in.wav", sounding * tone(700.0, seconds, RATE, 0.5))
    levels = []
    for form in FORMS:
        rendered(source, out, "--transform", form)
        level = strength(out, 20.0)
        levels.append(level - level.mean())
    spectra = [np.fft.rfft(level, 2 * level.size) for level in levels]
    agreement = np.fft.irfft(spectra[0] * spectra[1].conj())
    lag = np.fft.fftfreq(agreement.size, 1 / agreement.size)[agreement.argmax()]
    # The reference stands on units of 46 ms; over 40 edges their mean is a third of that and less.
    # Onsets line up, ends come 35 ms later.
    assert -0.015 < lag / RATE < 0.035


# --- what is said


@pytest.mark.parametrize("form", FORMS)
def test_json_is_one_document_that_tells_what_is_in_the_file(tmp_path, out, form):
    samples = noise(24_000, 2)
    samples[100, 0], samples[200, 1], samples[201, 1] = np.nan, np.inf, -1e30
    source = sound(tmp_path / "in.wav", samples)
    report = rendered(source, out, "--transform", form)
    assert report.keys() >= KEYS
    assert report["replaced_samples"] == 3
    assert report["peak"] == pytest.approx(float(np.abs(vibration(out)).max()), rel=1e-6)
    assert 0.0 < report["latency_s"] < 0.1
    latency_frames = report["latency_s"] * RATE
    assert latency_frames == pytest.approx(round(latency_frames), abs=1e-6)


def test_peak_is_that_of_out_and_not_of_what_the_latency_took_away(tmp_path, out):
    # 2 ms of sound: the live form's vibration is strongest just before it, where OUT is not yet.
    report = rendered(sound(tmp_path / "in.wav", tone(300.0, 100 / RATE, RATE, 0.9, 0.0)), out)
    assert report["peak"] == pytest.approx(float(np.abs(vibration(out)).max()), rel=1e-6)


def test_the_limiter_keeps_out_below_full_scale_and_is_counted(tmp_path, out):
    # Two tones far apart share the strength of one: over full scale, as one stays just below it.
    samples = tone(300.0, 1.0, RATE, 1.2) + tone(3_000.0, 1.0, RATE, 1.2)
    report = rendered(sound(tmp_path / "in.wav", samples), out)
    assert report["limited_samples"] > 0
    assert 0.9 < report["peak"] < 1.0
    assert np.abs(vibration(out)).max() < 1.0


def test_a_name_of_another_format_is_refused(tmp_path):
    source = sound(tmp_path / "in.wav", noise(5_000))
    done = call("render", source, tmp_path / "out.mp3")
    assert done.code == 2
    assert "allowed: a name that ends in .wav, .wave, .rf64" in done.stderr
    assert not (tmp_path / "out.mp3").exists()


@pytest.mark.exhaustive
def test_progress_is_drawn_on_a_terminal_and_json_stays_json(tmp_path, out):
    source = sound(tmp_path / "[bold]in.wav", noise(50_000))
    options = ["render", source, out, "--json"]
    done, drawn = on_a_terminal(*options, streams=("stderr",))
    assert json.loads(done.stdout)["frames"] == 50_000
    assert "100 %" in drawn
    assert "[bold]in.wav" in drawn  # a name is a name, not markup


def test_progress_stays_away_from_a_pipe_even_where_colours_are_forced(tmp_path, out, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    rendered(sound(tmp_path / "in.wav", noise(50_000)), out)  # which says nothing on stderr


# --- where OUT may be


def test_an_existing_file_is_replaced_in_one_step(tmp_path, out):
    out.write_bytes(b"old")
    source = sound(tmp_path / "in.wav", noise(5_000))
    with out.open("rb") as reader:
        rendered(source, out)
        assert reader.read() == b"old"
    assert listing(out.parent).keys() == {out.name}
    assert soundfile.info(out).frames == 5_000


def test_a_link_is_followed_and_a_hard_link_of_the_input_leaves_the_input_alone(tmp_path, out):
    source = sound(tmp_path / "in.wav", noise(5_000))
    before = source.read_bytes()
    (tmp_path / "link.wav").symlink_to(out)
    rendered(source, tmp_path / "link.wav")
    assert (tmp_path / "link.wav").is_symlink()
    expected = out.read_bytes()
    out.unlink()
    os.link(source, out)
    rendered(source, out)
    assert out.read_bytes() == expected
    assert source.read_bytes() == before


def test_the_longest_names_and_paths_work(tmp_path):
    source = sound(tmp_path / "in.wav", noise(3_000))
    folder = tmp_path
    while len(str(folder)) < 3_500:
        folder /= "d" * 200
        folder.mkdir()
    path = folder / ("ü" * 125 + ".wav")  # 254 bytes
    rendered(source, path)
    assert rendered(path, folder / "again.wav")["frames"] == 3_000
    assert (folder / "again.wav").exists()


@pytest.mark.exhaustive
def test_names_that_are_not_text_work_even_where_they_cannot_be_printed(tmp_path, out):
    name = os.fsdecode(b"caf\xe9")  # Latin-1; no UTF-8
    source = sound(tmp_path / "in.wav", noise(3_000)).rename(tmp_path / f"{name}.wav")
    target = out.with_name(f"{name} für dich.wav")
    done = cushion("render", source, target, env={"PYTHONIOENCODING": "ascii:strict"})
    assert (done.code, done.stderr) == (0, "")
    assert ": 0.06 s of vibration, " in done.stdout
    assert soundfile.info(os.fsencode(target)).frames == 3_000


# --- the acceleration


def test_the_acceleration_stands_beside_a_vibration_that_it_does_not_change(tmp_path, out):
    source = sound(tmp_path / "in.wav", columns(tone(300.0, 1.0, RATE), tone(900.0, 1.0, RATE)))
    rendered(source, out, "--channels", "each")
    alone = out.read_bytes()
    felt = tmp_path / "felt.wav"
    report = rendered(source, out, "--channels", "each", "--acceleration", felt)
    assert out.read_bytes() == alone
    with soundfile.SoundFile(felt) as file:
        assert (file.samplerate, file.channels, file.frames) == (RATE, 2, RATE)
        assert "full scale = 100 m/s^2" in file.comment
    peak = float(np.abs(vibration(felt)).max()) * 100.0
    assert report["peak_acceleration_m_s2"] == pytest.approx(peak, rel=1e-6)
    assert 1.0 < peak < 100.0


def test_the_acceleration_has_its_place_under_the_sound_too(tmp_path, out):
    felt = tmp_path / "felt.wav"
    source = sound(tmp_path / "in.wav", burst(1_000.0, 0.5, 1.5, RATE, 0.5))
    rendered(source, out, "--acceleration", felt)
    levels = [strength(path) for path in (out, felt)]
    onsets = [np.flatnonzero(level > 0.5 * level.max())[0] / RATE for level in levels]
    assert onsets[1] == pytest.approx(onsets[0], abs=0.015)  # a few cycles of the actuator


# --- rigs


def test_protection_of_a_rig_that_nothing_can_harm_changes_no_byte(tmp_path, out):
    source = sound(tmp_path / "in.wav", noise(RATE))
    rendered(source, out)
    usual = out.read_bytes()
    rendered(source, out, "--protection", "on")
    assert out.read_bytes() == usual


def test_damping_is_heard_by_the_rig_in_file_and_acceleration_alike(tmp_path, out):
    felt = tmp_path / "felt.wav"
    source = sound(tmp_path / "in.wav", burst(1_000.0, 0.5, 1.5, RATE, 0.5))
    rendered(source, out, "--acceleration", felt)
    usual = [soundfile.read(path)[0] for path in (out, felt)]
    rendered(source, out, "--acceleration", felt, "--rig", "consumer", "--damping", "auto")
    damped = [soundfile.read(path)[0] for path in (out, felt)]
    for before, after in zip(usual, damped, strict=True):
        assert len(before) == len(after)
        assert not np.array_equal(before, after)
    assert np.abs(damped[0]).max() <= 1.0


# --- names


@pytest.mark.parametrize(
    ("option", "allowed"),
    [
        ("--transform", "live, reference"),
        ("--channels", "mono, each"),
        ("--profile", "paper, cinema, game, music"),
        ("--damping", "off, auto"),
        ("--protection", "off, on"),
        ("--rig", "paper, consumer, or a file, NAME.toml"),
    ],
)
def test_a_name_that_does_not_exist_is_answered_with_those_that_do(tmp_path, out, option, allowed):
    source = sound(tmp_path / "in.wav", noise(3_000))
    error = refused(call("render", source, out, option, "Loud"))
    assert option.removeprefix("--") in error  # the word that was typed
    assert "'Loud'" in error
    assert f"allowed: {allowed}" in error
    assert listing(out.parent) == {}


def test_two_wrong_names_are_reported_together(tmp_path, out):
    source = sound(tmp_path / "in.wav", noise(3_000))
    error = refused(call("render", source, out, "--profile", "Loud", "--damping", "Strong"))
    assert "'Loud'" in error
    assert "'Strong'" in error


# --- what it costs

PEAK_RSS = """
import sys
from audioflinger_hook.cli import main
for form in ("live", "reference"):
    assert main(["render", *sys.argv[1:], "--transform", form]) == 0
status = open("/proc/self/status").read()
print(status.partition("VmHWM:")[2].split()[0], file=sys.stderr)
"""


def peak_rss_mb(source, out):
    """The most memory that rendering in both forms has held, as the kernel counts it.

    Asked of the process itself: what a parent learns of its child includes the copy of the parent
    that the child was before it became another program.
    """
    command = [sys.executable, "-c", PEAK_RSS, str(source), str(out)]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, check=True)
    return int(done.stderr) / 1024


@pytest.mark.exhaustive
@pytest.mark.skipif(sys.platform != "linux", reason="asks /proc for the peak memory")
def test_a_long_sound_takes_no_more_memory_than_a_short_one(tmp_path, out):
    second = noise(RATE, 2)
    peaks = []
    for seconds in (130, 730):
        source = tmp_path / f"{seconds}.wav"
        with soundfile.SoundFile(source, "w", RATE, 2, "FLOAT") as file:
            for _ in range(seconds):
                file.write(second)
        peaks.append(peak_rss_mb(source, out))
    # 600 s more are 230 MB of sound and 115 MB of vibration.
    assert peaks[1] - peaks[0] < 30.0
    assert peaks[1] < 400.0


def test_behind_two_dashes_everything_is_a_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sound(tmp_path / "-a.wav", noise(500))
    assert call("render", "--json", "--", "-a.wav", "--json").code == 0
    assert (tmp_path / "--json").is_file()
