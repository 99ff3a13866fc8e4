import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from device import blocks, errors
from device.clock.delay_line import CubicReader
from device.errors import NotFoundError
from device.rig import PAPER
from device.rig.actuator import LinearActuator
from device.units import amplitude_to_db, db_to_amplitude, finite_or_zero


@pytest.mark.sweep
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@given(data=st.data())
def test_the_peak_is_the_largest_magnitude_whatever_the_samples(dtype, data):
    shape = data.draw(arrays.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=40))
    samples = data.draw(arrays.arrays(dtype, shape))
    expected = float(np.max(np.abs(samples), initial=0.0))
    np.testing.assert_equal(blocks.peak(samples), expected)


@pytest.mark.parametrize("spoiled", [math.nan, -math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", [0, 7, 511])
def test_one_sample_that_is_not_finite_makes_the_peak_so(spoiled, place):
    samples = np.random.default_rng(1).uniform(-1, 1, 512).astype(np.float32)
    samples[place] = spoiled
    assert not math.isfinite(blocks.peak(samples))
    assert math.isnan(blocks.peak(samples)) == math.isnan(spoiled)


def test_the_peak_of_any_layout_and_type_is_found():
    samples: Any = np.arange(-12.0, 12.0).reshape(4, 6)
    for layout in (samples.T, samples[:, ::2], samples.astype(np.int16)):
        assert blocks.peak(layout) == 12.0
    assert (blocks.peak(samples[:0]), blocks.peak(np.float32(3.0) * np.ones(()))) == (0.0, 3.0)


COUNTS = st.tuples(st.integers(1, 3), st.integers(0, 1_300), st.integers(0, 2**45))
STEPS = st.floats(0.1, 3.0) | st.floats(0.999, 1.001)


@given(COUNTS, STEPS, st.floats(0.0, 1.0, exclude_max=True), st.booleans())
def test_frames_between_frames_are_on_the_cubic_through_four(counts, step, fraction, strided):
    channels, count, start = counts
    ring = np.random.default_rng(1).uniform(-1, 1, (4_096, channels)).astype(np.float32)
    reader = CubicReader(ring)
    reader.position, reader.fraction = start, fraction
    out = np.empty((count, channels * (1 + strided)), np.float32)[:, :: 1 + strided]
    reader.read(out, step)
    place = np.arange(count) * step + fraction
    whole = np.floor(place)
    s = (place - whole)[:, np.newaxis]
    frames = ring[(start + whole.astype(int) + np.arange(-1, 3)[:, np.newaxis]) % len(ring)]
    expected = (
        frames[0] * -s * (s - 1) * (s - 2) / 6
        + frames[1] * (s + 1) * (s - 1) * (s - 2) / 2
        - frames[2] * (s + 1) * s * (s - 2) / 2
        + frames[3] * (s + 1) * s * (s - 1) / 6
    )
    # Sums up to 1.6 are rounded to float32, each to 6e-8 of 1; all before that is float64.
    np.testing.assert_allclose(out, expected, rtol=0, atol=3e-7)


def test_without_the_compiled_library_a_reader_says_how_to_get_it(monkeypatch):
    monkeypatch.setattr(blocks, "compiled", None)
    with pytest.raises(NotFoundError, match="make run"):
        CubicReader(np.zeros((8, 1), np.float32))
    assert blocks.peak(np.array([[-2.0, 1.0]])) == 2.0


def each(**wrongs: Any) -> list[tuple[str, Any]]:
    return [(name, wrong) for name in wrongs for wrong in wrongs[name]]


NO_PLACE = each(
    row=(8, -1, 1.0),
    fraction=(1.0, -0.1, math.nan),
    step=(0.0, math.nan, math.inf, 1e300),
    ring=(None, *(np.zeros(shape, np.float32) for shape in (8, (8, 2), (0, 1))), np.zeros((8, 1))),
    out=(np.zeros((4, 1)), np.zeros((4, 2), np.float32)[:, :1], b"1234"),
)


@pytest.mark.parametrize(("name", "wrong"), NO_PLACE)
def test_what_does_not_fit_is_refused_and_nothing_is_read(name, wrong):
    ring, out = (np.zeros((rows, 1), np.float32) for rows in (8, 4))
    fitting: Any = {"ring": ring, "out": out, "row": 0, "fraction": 0.0, "step": 1.0}
    cubic: Callable[..., None] = blocks.require_compiled().cubic
    cubic(**fitting)
    with pytest.raises((TypeError, ValueError, BufferError, OverflowError)):
        cubic(**(fitting | {name: wrong}))


@given(arrays.arrays(np.float32, st.tuples(st.integers(0, 300), st.integers(1, 3))))
def test_an_emptied_block_gives_its_bytes_and_is_all_zero_unless_it_is_not_finite(frames):
    before, stored = frames.copy(), blocks.emptied(frames)
    if np.isfinite(before).all():
        assert (stored, frames.any()) == (before.tobytes(), False)
    else:
        assert stored is None
        np.testing.assert_array_equal(frames, before)


@pytest.mark.parametrize("array", [np.zeros((4, 2), "f")[:, :1], b"1234", None, np.zeros(4, "h")])
def test_what_cannot_be_taken_is_refused(array):
    with pytest.raises((TypeError, BufferError)):
        blocks.require_compiled().peak(array)


VOLTS = st.floats(-30.0, 30.0) | st.sampled_from([0.0, -0.0, 5e-324, 1e101, math.nan, -math.inf])


@pytest.mark.exhaustive
@given(arrays.arrays(np.float64, st.integers(0, 1_300), elements=VOLTS), st.integers(1, 1_300))
def test_the_linear_model_moves_the_same_compiled_and_in_numpy(volts, blocksize):
    moved, twin = (LinearActuator(PAPER.actuator, 48_000) for _ in range(2))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(blocks, "compiled", None)
        expected = twin.move(volts)
    for first in range(0, max(1, volts.size), blocksize):
        part = slice(first, first + blocksize)
        motion = moved.move(volts[part])
        for name in ("displacement_m", "velocity_m_s", "current_a", "acceleration_m_s2"):
            # The same sums in the same order; a compiler may round a product once less often.
            np.testing.assert_allclose(
                getattr(motion, name), getattr(expected, name)[part], rtol=1e-12, atol=1e-18
            )
    assert moved.replaced_samples == twin.replaced_samples
    after, expected_after = (each.move(np.zeros(1)).displacement_m[0] for each in (moved, twin))
    assert after == pytest.approx(expected_after, rel=1e-12, abs=1e-18)


NO_MOTION = each(volts=(np.zeros(8, np.float32), np.zeros((8, 1)), np.zeros(16)[::2]))
NO_MOTION += each(poles=(np.zeros((2, 5)), np.zeros((3, 6))), start=(9, -1), stop=(9, -1))
NO_MOTION += each(taps=(np.zeros((1, 3)), np.zeros((2, 4))), moved=(np.zeros((1, 7)), np.zeros(8)))
NO_MOTION += each(state=(np.zeros(7), np.frombuffer(bytes(64))), limit=("high",))


@pytest.mark.parametrize(("name", "wrong"), NO_MOTION)
def test_what_is_no_motion_is_refused_and_nothing_is_moved(name, wrong):
    state, moved = np.zeros(8), np.zeros((1, 8))
    fitting: dict[str, Any] = {"volts": np.ones(8), "poles": np.ones((2, 6)), "state": state}
    fitting |= {"taps": np.ones((1, 4)), "moved": moved, "start": 0, "stop": 8, "limit": 1e100}
    move: Callable[..., int] = blocks.require_compiled().linear_motion
    with pytest.raises((TypeError, ValueError, BufferError, OverflowError)):
        move(**(fitting | {name: wrong}))
    assert not np.any([state, moved[0]])
    assert (move(**fitting), bool(moved.any())) == (0, True)


@given(st.floats(-600, 600))
def test_db_and_back_is_the_same_level(level_db):
    # 1e-12 dB: the logarithm of a double near 1 has an error of about 2e-15, times 20.
    assert amplitude_to_db(db_to_amplitude(level_db)) == pytest.approx(level_db, abs=1e-12)


def test_known_levels():
    assert amplitude_to_db(10.0) == 20.0
    assert amplitude_to_db(-0.5) == pytest.approx(-6.0206, abs=1e-4)
    assert (amplitude_to_db(0.0), db_to_amplitude(-math.inf)) == (-math.inf, 0.0)


def test_only_what_is_not_finite_becomes_zero_and_the_rest_is_not_copied():
    sound = np.array([1.0, -1e308, 5e-324])
    assert finite_or_zero(sound)[0] is sound
    broken = np.array([1.0, np.nan, np.inf, -np.inf, 2.0])
    samples, replaced = finite_or_zero(broken)
    assert (samples.tolist(), replaced) == ([1.0, 0.0, 0.0, 0.0, 2.0], 3)
    assert np.isnan(broken[1])


EXIT_CODES = {errors.UsageError: 2, errors.NotFoundError: 3, errors.LostError: 4}
EXIT_CODES |= {errors.InternalError: 5, errors.WriteError: 5}


@pytest.mark.parametrize(("kind", "exit_code"), EXIT_CODES.items())
def test_an_error_knows_its_exit_code_and_is_one_line(kind, exit_code):
    error = kind("cannot write 'a\nb': no\r\n  room")
    assert isinstance(error, errors.CushionError)
    assert (error.exit_code, str(error)) == (exit_code, "cannot write 'a b': no room")
