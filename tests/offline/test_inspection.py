import itertools
from contextlib import closing
from typing import Any

import numpy as np
import pytest
import soundfile

from audioflinger_hook.offline.inspection import inspect_file, inspect_tap
from audioflinger_hook.sources import FileTap
from audioflinger_hook.transform import TransformParameters
from device.errors import UsageError
from tests.support.commands import RATE, noise, open_files, sound
from tests.support.reference_oracle import oracle_units
from tests.support.signals import columns, five_tones, joined, silence
from tests.support.taps import frames_of

WINDOW = 2_229  # frames of a unit at 48 kHz
FRAMES = RATE // 2  # of the sound that most tests look at


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """Half a second of stereo: tones, noise, silence; its last unit is not whole."""
    mono = joined(five_tones(0.2, RATE), noise(RATE // 10)[:, 0], silence(0.2, RATE))
    return sound(tmp_path_factory.mktemp("sound") / "in.wav", columns(mono, 0.3 * mono))


def assert_same(units, oracle):
    """What was found is what the independent implementation finds, to rounding."""
    assert [unit.unit for unit in units] == list(range(len(oracle)))
    for unit, expected in zip(units, oracle, strict=True):
        found, wanted = (
            [(p.audio_hz, p.amplitude, p.bandwidth_hz, p.r, p.vibration_hz) for p in principal]
            for principal in (unit.principal, expected)
        )
        assert np.shape(found) == np.shape(wanted)
        # Both work in float64; 1e-6 is far above its rounding and far below what is printed.
        assert np.allclose(found, wanted, rtol=1e-6, atol=1e-9)


def test_units_are_what_an_independent_implementation_finds_of_any_parameters(source):
    samples, samplerate = soundfile.read(source)
    assert_same(list(inspect_file(source)), oracle_units(samples, samplerate))
    samples, samplerate = soundfile.read(source)
    changed: dict[str, Any] = {"window_s": 0.03, "band_low_hz": 80.0, "vibration_top_hz": 180.0}
    parameters = TransformParameters(**changed, partials_max=5, threshold_hz=0.1)
    found = list(inspect_file(source, parameters))
    assert_same(found, oracle_units(samples, samplerate, **changed, partials_max=5, threshold=0.1))
    assert max(len(unit.principal) for unit in found) == 5


@pytest.mark.exhaustive
@pytest.mark.parametrize("blocksize", [1, 7, 1_000, WINDOW, 2 * WINDOW + 1, 10**6])
def test_the_blocksize_changes_nothing(source, blocksize):
    expected = list(inspect_file(source))
    with closing(FileTap(source, blocksize)) as tap:
        assert list(inspect_tap(tap, TransformParameters())) == expected
    with closing(FileTap(source, blocksize)) as tap:
        assert list(inspect_tap(tap, TransformParameters(), at_s=0.25)) == [expected[5]]


def test_no_more_is_read_than_a_unit_needs(source):
    with closing(FileTap(source, blocksize=100)) as tap:
        (unit,) = inspect_tap(tap, TransformParameters(), at_s=0.1)
        assert unit.unit == 2
        assert len(frames_of(tap)) == pytest.approx(FRAMES - 3 * WINDOW, abs=100)
    with closing(FileTap(source, blocksize=WINDOW)) as tap:
        assert next(inspect_tap(tap, TransformParameters())).unit == 0
        assert len(frames_of(tap)) == FRAMES - WINDOW


def test_every_moment_belongs_to_the_unit_that_holds_it(source):
    expected = list(inspect_file(source))
    assert len(expected) == -(-FRAMES // WINDOW)
    for frame in (0, 1, WINDOW - 1, WINDOW, 5 * WINDOW + 3, FRAMES - 1):
        for share in (0.1, 0.5, 0.75):  # of the time until the next frame
            (unit,) = inspect_file(source, at_s=(frame + share) / RATE)
            assert unit == expected[frame // WINDOW]
            assert unit.start_s == pytest.approx(unit.unit * WINDOW / RATE)


@pytest.mark.parametrize("at_s", [0.5, 1.5, 1e9, 1e308, np.inf, -np.inf, np.nan, -1e-9])
def test_a_moment_outside_the_sound_is_the_users_mistake(source, at_s):
    with pytest.raises(UsageError, match=r"time \S+ s is .*; allowed: 0"):
        list(inspect_file(source, at_s=at_s))


def test_whoever_stops_early_leaves_no_file_open(source):
    before = open_files()
    for _ in range(3):
        assert len(list(itertools.islice(inspect_file(source), 2))) == 2
    assert open_files() == before
