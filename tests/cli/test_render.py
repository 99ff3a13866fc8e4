import functools
import json
import os

import numpy as np
import pytest
import soundfile

from tests.support import commands
from tests.support.commands import RATE, call, cushion, document, listing, noise, sound, vibration
from tests.support.signals import FORMS, burst, columns, envelope, tone


@pytest.fixture
def out(folder):
    return folder / "vibration.wav"


rendered = functools.partial(document, "render")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("mode", ["mono", "each"])
def test_out_is_float32_wav_of_the_inputs_rate_and_length(tmp_path, out, form, mode):
    for samplerate, channels, frames in (
        (48_000, 2, 20_000),
        (44_100, 1, 12_345),
        (8_000, 1, 4_000),
        (1_000, 3, 500),
        (192_000, 6, 9_999),
        (768_000, 1, 190_000),
        (48_000, 64, 3_000),
        (48_000, 2, 1),  # shorter than a window, and than the latency
    ):
        source = sound(tmp_path / "in.wav", noise(frames, channels), samplerate)
        report = rendered(source, out, "--transform", form, "--channels", mode)
        info = soundfile.info(out)
        assert (info.format, info.subtype) == ("WAV", "FLOAT")
        assert (info.samplerate, info.frames) == (samplerate, frames)
        assert info.channels == (1 if mode == "mono" else channels)
        assert (report["samplerate"], report["frames"]) == (samplerate, frames)


@pytest.mark.parametrize(
    "kind",
    [
        *("WAV/PCM_24", "WAV/PCM_32", "WAV/FLOAT", "WAV/DOUBLE", "WAVEX/PCM_16", "RF64/PCM_16"),
        *("FLAC/PCM_16", "AIFF/PCM_16", "AIFF/FLOAT", "CAF/PCM_16", "AU/PCM_16", "W64/PCM_24"),
    ],
)
def test_the_same_samples_in_another_lossless_format_give_the_same_bytes(tmp_path, out, kind):
    container, subtype = kind.split("/")
    sixteen_bits = np.round(noise(20_000, 2) * 2**15).clip(-(2**15), 2**15 - 1) / 2**15
    rendered(sound(tmp_path / "in.wav", sixteen_bits, subtype="PCM_16"), out)
    expected = out.read_bytes()
    rendered(sound(tmp_path / "other", sixteen_bits, format=container, subtype=subtype), out)
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


def test_the_same_command_gives_the_same_bytes_in_any_process_and_folder(tmp_path, out):
    rendered(sound(tmp_path / "in.wav", noise(30_000, 2)), out)
    here = out.read_bytes()
    env = {"PYTHONHASHSEED": "7", "TZ": "Asia/Tokyo", "OMP_NUM_THREADS": "1"}
    done = cushion("render", "in.wav", "out/vibration.wav", cwd=tmp_path, env=env)
    assert (done.code, done.stderr) == (0, "")
    assert done.stdout.startswith("out/vibration.wav: 0.62 s of vibration, 1 channel at 48000 Hz")
    assert (done.stdout.count("\n"), out.read_bytes()) == (1, here)


def test_options_override_the_config_and_the_config_the_defaults(tmp_path, out):
    source, config = sound(tmp_path / "in.wav", noise(9_000, 2)), tmp_path / "config.toml"
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
    assert rendered(sound(tmp_path / "in.wav", noise(9_000)), out)["transform"] == "live"


def strength(path, low_pass_hz=60.0):
    return envelope(vibration(path)[:, 0].astype(float), RATE, low_pass_hz)


def test_a_burst_is_felt_where_it_is_heard(tmp_path, out):
    # Latency is taken out for onsets; an end is known by the window, its middle comes 35 ms later.
    onset_s = 0.5
    for hz in (80.0, 250.0, 1_000.0, 5_000.0):
        rendered(sound(tmp_path / "in.wav", burst(hz, onset_s, 1.5, RATE, 0.5)), out)
        level = strength(out)
        half = 0.5 * np.median(level[round(0.6 * RATE) : round(0.7 * RATE)])
        above = np.flatnonzero(level > half) / RATE
        assert above[0] == pytest.approx(onset_s, abs=0.005)
        assert above[-1] == pytest.approx(onset_s + 0.25 + 0.035, abs=0.015)


def test_the_envelopes_of_the_two_forms_line_up(tmp_path, out):
    # Bursts of random lengths, so that no burst keeps its place in the reference's units.
    switches, seconds = np.cumsum(np.random.default_rng(5).uniform(0.08, 0.4, 60)), 8.0
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


@pytest.mark.parametrize("form", FORMS)
def test_json_is_one_document_that_tells_what_is_in_the_file(tmp_path, out, form):
    samples = noise(24_000, 2)
    samples[100, 0], samples[200, 1], samples[201, 1] = np.nan, np.inf, -1e30
    source = sound(tmp_path / "in.wav", samples)
    assert "3 unusable samples set to 0" in call("render", source, out, "--transform", form).stdout
    report = rendered(source, out, "--transform", form)
    assert report.keys() >= {"frames", "samplerate", "limited_samples"}
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


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", ["", "ogg-haptic", "partials"])
def test_progress_is_drawn_on_a_terminal_and_json_stays_json(name, tmp_path, out):
    source = sound(tmp_path / "[bold]in.wav", noise(50_000))
    command = ("export", "--format", name) if name else ("render",)
    done, drawn = commands.on_a_terminal(*command, source, out, "--json", streams=("stderr",))
    assert json.loads(done.stdout)["frames"] == 50_000
    assert "100 %" in drawn
    assert "[bold]in.wav" in drawn  # a name is a name, not markup


def test_progress_stays_away_from_a_pipe_even_where_colours_are_forced(tmp_path, out, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    rendered(sound(tmp_path / "in.wav", noise(50_000)), out)  # which says nothing on stderr


def test_a_hard_link_of_the_input_is_replaced_and_the_input_left_alone(tmp_path, out):
    source = sound(tmp_path / "in.wav", noise(5_000))
    before = source.read_bytes()
    rendered(source, out)
    expected = out.read_bytes()
    out.unlink()
    os.link(source, out)
    rendered(source, out)
    assert (out.read_bytes(), source.read_bytes()) == (expected, before)


@pytest.mark.exhaustive
def test_names_that_are_not_text_work_even_where_they_cannot_be_printed(tmp_path, out):
    name = os.fsdecode(b"caf\xe9")  # Latin-1; no UTF-8
    source = sound(tmp_path / "in.wav", noise(3_000)).rename(tmp_path / f"{name}.wav")
    target = out.with_name(f"{name} für dich.wav")
    done = cushion("render", source, target, env={"PYTHONIOENCODING": "ascii:strict"})
    assert (done.code, done.stderr) == (0, "")
    assert ": 0.06 s of vibration, " in done.stdout
    assert soundfile.info(os.fsencode(target)).frames == 3_000


def test_the_acceleration_stands_beside_a_vibration_that_it_does_not_change(tmp_path, out):
    source = sound(tmp_path / "in.wav", columns(tone(300.0, 1.0, RATE), tone(900.0, 1.0, RATE)))
    rendered(source, out, "--channels", "each")
    alone, felt = out.read_bytes(), tmp_path / "felt.wav"
    report = rendered(source, out, "--channels", "each", "--acceleration", felt)
    assert out.read_bytes() == alone
    with soundfile.SoundFile(felt) as file:
        assert (file.samplerate, file.channels, file.frames) == (RATE, 2, RATE)
        assert "full scale = 100 m/s^2" in file.comment
    peak = float(np.abs(vibration(felt)).max()) * 100.0
    assert report["peak_acceleration_m_s2"] == pytest.approx(peak, rel=1e-6)
    assert 1.0 < peak < 100.0


def test_damping_is_heard_by_the_rig_in_file_and_acceleration_alike(tmp_path, out):
    felt = tmp_path / "felt.wav"
    source = sound(tmp_path / "in.wav", burst(1_000.0, 0.5, 1.5, RATE, 0.5))
    rendered(source, out, "--acceleration", felt)
    onsets = [np.argmax(level > 0.5 * level.max()) / RATE for level in map(strength, (out, felt))]
    assert onsets[1] == pytest.approx(onsets[0], abs=0.015)  # a few cycles of the actuator
    usual = [vibration(path) for path in (out, felt)]
    rendered(source, out, "--acceleration", felt, "--rig", "consumer", "--damping", "auto")
    damped = [vibration(path) for path in (out, felt)]
    for before, after in zip(usual, damped, strict=True):
        assert len(before) == len(after)
        assert not np.array_equal(before, after)
    assert np.abs(damped[0]).max() <= 1.0


def test_names_that_do_not_exist_are_answered_together_with_those_that_do(tmp_path, out):
    source = sound(tmp_path / "in.wav", noise(3_000))
    known = {"transform": "live, reference", "channels": "mono, each", "damping": "off, auto"}
    known |= {"profile": "paper, cinema, game, music", "protection": "off, on"}
    known["rig"] = "paper, consumer, or a file, NAME.toml"
    for names in (*([name] for name in known), ["profile", "damping"]):
        wrong = [word for name in names for word in (f"--{name}", f"Loud {name}")]
        error = commands.refused(call("render", source, out, *wrong))
        for name in names:
            assert name in error  # the word that was typed
            assert f"'Loud {name}'" in error
            assert f"allowed: {known[name]}" in error
    assert listing(out.parent) == {}


TELLS_ITS_PEAK = """
import atexit, pathlib, sys
status = pathlib.Path("/proc/self/status").read_text
atexit.register(lambda: print(status().partition("VmHWM:")[2].split()[0], file=sys.stderr))
"""


@pytest.mark.exhaustive
@pytest.mark.parametrize("form", FORMS)
def test_a_long_sound_takes_no_more_memory_than_a_short_one(tmp_path, out, form):
    second, peaks_mb = noise(RATE, 2), []
    for seconds in (130, 330):
        source = tmp_path / f"{seconds}.wav"
        with soundfile.SoundFile(source, "w", RATE, 2, "FLOAT") as file:
            for _ in range(seconds):
                file.write(second)
        done = cushion("render", source, out, "--transform", form, prelude=TELLS_ITS_PEAK)
        assert done.code == 0
        peaks_mb.append(int(done.stderr) / 1024)
    # 200 s more are 77 MB of sound and 38 MB of vibration.
    assert peaks_mb[1] - peaks_mb[0] < 30.0
    assert peaks_mb[1] < 400.0


def test_behind_two_dashes_everything_is_a_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sound(tmp_path / "-a.wav", noise(500))
    assert call("render", "--json", "--", "-a.wav", "--json").code == 0
    assert (tmp_path / "--json").is_file()
