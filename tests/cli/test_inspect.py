"""`cushion inspect`: the principal frequencies as a table and as JSON."""

import json
import math

import numpy as np
import pytest
import soundfile

from tests.support.commands import RATE, call, cushion, noise, refused, sound, start
from tests.support.recordings import require_recordings
from tests.support.signals import FIVE_TONES_HZ, columns, five_tones, silence, tone

UNIT_KEYS = ["unit", "start_s", "principal"]
PRINCIPAL_KEYS = ["audio_hz", "amplitude", "bandwidth_hz", "r", "vibration_hz"]


def inspected(source, *options):
    """The units that `inspect --json` finds, having said nothing else."""
    done = call("inspect", source, "--json", *options)
    assert (done.code, done.stderr) == (0, "")
    return json.loads(done.stdout)


# --- what is found


@pytest.mark.parametrize("channels", [1, 2])
@pytest.mark.parametrize("samplerate", [44_100, 48_000])
def test_five_tones_are_found_within_half_a_hertz_and_nothing_else(tmp_path, samplerate, channels):
    tones = five_tones(3.0, samplerate)
    source = sound(tmp_path / "in.wav", columns(*[tones] * channels), samplerate)
    (unit,) = inspected(source, "--at", "1.83")
    window_s = round(0.04643 * samplerate) / samplerate
    assert unit["unit"] == 39  # the paper's unit of 1.811 to 1.857 s
    assert unit["start_s"] == pytest.approx(39 * window_s, abs=1e-9)
    found = [principal["audio_hz"] for principal in unit["principal"]]
    assert found == pytest.approx(FIVE_TONES_HZ, abs=0.5)
    felt = [principal["vibration_hz"] for principal in unit["principal"]]
    assert felt == pytest.approx([46.6, 92.0, 128.2, 140.9, 182.0], abs=0.15)


def test_every_unit_is_listed_once_in_order_with_its_start(tmp_path):
    frames = 5 * 2_229 + 7  # the last unit holds 7 frames
    units = inspected(sound(tmp_path / "in.wav", noise(frames, 2)))
    assert [list(unit) for unit in units] == [UNIT_KEYS] * 6
    assert [unit["unit"] for unit in units] == list(range(6))
    starts = [unit["start_s"] for unit in units]
    assert starts == pytest.approx([number * 2_229 / RATE for number in range(6)], abs=1e-9)


def test_a_units_principal_frequencies_ascend_and_their_numbers_agree(tmp_path):
    units = inspected(sound(tmp_path / "in.wav", noise(RATE)))
    assert any(len(unit["principal"]) > 5 for unit in units)
    for unit in units:
        principal = unit["principal"]
        assert len(principal) <= 16
        assert [list(one) for one in principal] == [PRINCIPAL_KEYS] * len(principal)
        heard = [one["audio_hz"] for one in principal]
        assert heard == sorted(heard)
        for one in principal:
            assert all(math.isfinite(value) for value in one.values())
            assert one["r"] == pytest.approx(one["amplitude"] * one["bandwidth_hz"], rel=1e-9)
            assert one["r"] > 0.3
            assert 20.0 < one["vibration_hz"] < 221.0


def test_silence_has_units_and_nothing_principal_in_them(tmp_path):
    source = sound(tmp_path / "in.wav", silence(0.2, RATE))
    units = inspected(source)
    assert len(units) == 5
    assert all(unit["principal"] == [] for unit in units)
    table = call("inspect", source)
    assert [line.split() for line in table.stdout.splitlines()[1:3]] == [
        ["0", "0.000000", "-"],
        ["1", "0.046437", "-"],
    ]


def test_opposite_channels_hold_what_equal_ones_hold(tmp_path):
    left = tone(440.0, 0.2, RATE)
    opposite = inspected(sound(tmp_path / "in.wav", columns(left, -left)))
    equal = inspected(sound(tmp_path / "in.wav", columns(left, left)))
    assert [unit["principal"] for unit in opposite[1:]] == [
        [pytest.approx(one, rel=1e-6) for one in unit["principal"]] for unit in equal[1:]
    ]
    assert len(opposite[1]["principal"]) == 1


def test_unusable_samples_do_not_spoil_their_unit(tmp_path):
    samples = five_tones(1.0, RATE)
    clean = inspected(sound(tmp_path / "in.wav", samples), "--at", "0.8")
    samples[5_000:5_003] = np.nan, np.inf, 1e30
    spoilt = inspected(sound(tmp_path / "in.wav", samples), "--at", "0.8")
    found = [[one["audio_hz"] for one in units[0]["principal"]] for units in (clean, spoilt)]
    assert found[0] == pytest.approx(found[1], abs=0.01)


def test_a_recording_is_inspected_to_its_end():
    recording = require_recordings()[0]
    info = soundfile.info(recording)
    units = inspected(recording)
    assert len(units) == math.ceil(info.frames / round(0.04643 * info.samplerate))


# --- one moment


@pytest.mark.sweep
@pytest.mark.parametrize("samplerate", [8_000, 44_100, 48_000])
def test_the_start_that_is_printed_for_a_unit_finds_that_unit(tmp_path, samplerate):
    source = sound(tmp_path / "in.wav", tone(440.0, 2.0, samplerate, 0.5), samplerate)
    units = inspected(source)
    rows = [line.split() for line in call("inspect", source).stdout.splitlines()[1:]]
    heads = [row for row in rows if len(row) == 7]  # the first line of each unit
    for unit, (number, start_s, *_) in zip(units, heads, strict=True):
        assert unit["unit"] == int(number)
        assert inspected(source, "--at", repr(unit["start_s"])) == [unit]
        assert inspected(source, "--at", start_s) == [unit]


def test_the_first_and_the_last_frame_have_their_units(tmp_path):
    frames = 3 * 2_229 + 100
    source = sound(tmp_path / "in.wav", noise(frames))
    units = inspected(source)
    assert inspected(source, "--at", "0") == [units[0]]
    assert inspected(source, "--at", (frames - 0.5) / RATE) == [units[3]]


@pytest.mark.parametrize("at_s", ["1.0", "1.0001", "86400", "1e30", "1e308"])
def test_a_time_after_the_sound_is_refused_with_the_end_of_the_sound(tmp_path, at_s):
    source = sound(tmp_path / "in.wav", noise(RATE))
    error = refused(call("inspect", source, "--at", at_s))
    assert "0 to 1.000 s" in error


@pytest.mark.parametrize("at_s", ["-1", "-0.001", "nan", "inf", "soon", "", "1,5"])
def test_what_is_no_time_is_refused_with_what_is_one(tmp_path, at_s):
    source = sound(tmp_path / "in.wav", noise(RATE))
    error = refused(call("inspect", source, f"--at={at_s}"))
    assert f"{at_s!r} is not a time; allowed: 0 seconds or more" in error


# --- what is printed


def test_the_table_says_what_json_says(tmp_path):
    source = sound(tmp_path / "in.wav", five_tones(0.5, RATE))
    units = inspected(source)
    done = call("inspect", source)
    assert (done.code, done.stderr) == (0, "")
    head, *lines = done.stdout.splitlines()
    names = ["unit", "start s", "audio Hz", "amplitude", "width Hz", "r", "vibration Hz"]
    assert head.split() == " ".join(names).split()
    rows = [line.split() for line in lines]
    assert len(rows) == sum(max(1, len(unit["principal"])) for unit in units)
    printed = [[float(cell) for cell in row[-5:]] for row in rows]
    expected = [[one[key] for key in PRINCIPAL_KEYS] for unit in units for one in unit["principal"]]
    assert np.allclose(printed, expected, rtol=0.0, atol=0.0051)


@pytest.mark.exhaustive
def test_a_reader_that_has_seen_enough_is_no_error(tmp_path):
    source = sound(tmp_path / "in.wav", noise(20 * RATE))  # far more lines than a pipe holds
    with start("inspect", source) as process:
        assert process.stdout
        assert process.stderr
        assert process.stdout.readline().split()[:2] == ["unit", "start"]
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == 0


@pytest.mark.exhaustive
def test_inspect_runs_as_a_command(tmp_path):
    source = sound(tmp_path / "in.wav", five_tones(0.5, RATE))
    done = cushion("inspect", "in.wav", "--json", cwd=tmp_path)
    assert (done.code, done.stderr) == (0, "")
    assert json.loads(done.stdout) == inspected(source)


def test_a_body_that_is_short_is_inspected_as_far_as_it_goes_with_a_warning(tmp_path):
    source = sound(tmp_path / "in.wav", noise(RATE))
    source.write_bytes(source.read_bytes()[: 2 * RATE])
    done = call("inspect", source, "--json")
    assert done.code == 0
    assert len(json.loads(done.stdout)) == 11
    assert done.stderr.startswith(f"cushion: warning: {source} is shorter than its header says")
