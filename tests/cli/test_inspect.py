"""`cushion inspect`: the principal frequencies as a table and as JSON."""

import functools

import numpy as np
import pytest

from tests.support.commands import RATE, call, document, noise, refused, sound, start
from tests.support.signals import five_tones, silence, tone

PRINCIPAL_KEYS = ["audio_hz", "amplitude", "bandwidth_hz", "r", "vibration_hz"]

inspected = functools.partial(document, "inspect")


def test_silence_has_units_and_nothing_principal_in_them(tmp_path):
    source = sound(tmp_path / "in.wav", silence(0.2, RATE))
    assert [unit["principal"] for unit in inspected(source)] == [[]] * 5
    table = [line.split() for line in call("inspect", source).stdout.splitlines()]
    assert table[1:3] == [["0", "0.000000", "-"], ["1", "0.046437", "-"]]


@pytest.mark.sweep
@pytest.mark.parametrize("samplerate", [8_000, 1_000, 22_050, 44_100, 48_000, 96_000])
def test_the_start_that_is_printed_for_a_unit_finds_that_unit(tmp_path, samplerate):
    source = sound(tmp_path / "in.wav", tone(440.0, 2.0, samplerate, 0.5), samplerate)
    units = inspected(source)
    rows = [line.split() for line in call("inspect", source).stdout.splitlines()[1:]]
    heads = [row for row in rows if len(row) == 7]  # the first line of each unit
    for unit, (number, start_s, *_) in zip(units, heads, strict=True):
        assert unit["unit"] == int(number)
        assert inspected(source, "--at", repr(unit["start_s"])) == [unit]
        assert inspected(source, "--at", start_s) == [unit]


def test_a_time_that_is_none_or_after_the_sound_is_refused_with_the_end_of_the_sound(tmp_path):
    source = sound(tmp_path / "in.wav", noise(RATE))
    for at_s in ("1.0", "1.0001", "86400", "1e30", "1e308"):
        assert "0 to 1.000 s" in refused(call("inspect", source, "--at", at_s))
    for at_s in ("-1", "-0.001", "nan", "inf", "soon", "", "1,5"):
        error = refused(call("inspect", source, f"--at={at_s}"))
        assert f"{at_s!r} is not a time; allowed: 0 seconds or more" in error


def test_the_table_says_what_json_says(tmp_path):
    source = sound(tmp_path / "in.wav", five_tones(0.5, RATE))
    units = inspected(source)
    assert {tuple(unit) for unit in units} == {("unit", "start_s", "principal")}
    assert {tuple(one) for unit in units for one in unit["principal"]} == {(*PRINCIPAL_KEYS,)}
    done = call("inspect", source)
    assert (done.code, done.stderr) == (0, "")
    head, *lines = done.stdout.splitlines()
    assert " ".join(head.split()) == "unit start s audio Hz amplitude width Hz r vibration Hz"
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
