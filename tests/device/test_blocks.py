"""What is asked of every block, compiled and in NumPy: the same answers."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from device import blocks
from device.clock.ring import CubicReader
from device.rig import PAPER
from device.rig.actuator import LinearActuator
from device.units import Float32Array, FloatArray

needs_compiled = pytest.mark.skipif(
    blocks.compiled is None, reason="device/blocks_library.so is not built here: see tools/setup.sh"
)


def in_numpy(samples: Float32Array | FloatArray) -> float:
    return float(np.max(np.abs(samples), initial=0.0))


@pytest.mark.sweep
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@given(data=st.data())
def test_the_peak_is_the_largest_magnitude_whatever_the_samples(
    dtype: type, data: st.DataObject
) -> None:
    shape = data.draw(arrays.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=40))
    samples = data.draw(arrays.arrays(dtype, shape))
    np.testing.assert_equal(blocks.peak(samples), in_numpy(samples))


@pytest.mark.parametrize("spoiled", [math.nan, -math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", [0, 7, 511])
def test_one_sample_that_is_not_finite_makes_the_peak_so(spoiled: float, place: int) -> None:
    samples = np.random.default_rng(1).uniform(-1, 1, 512).astype(np.float32)
    samples[place] = spoiled
    assert not math.isfinite(blocks.peak(samples))
    assert math.isnan(blocks.peak(samples)) == math.isnan(spoiled)


def test_the_peak_of_any_layout_and_type_is_found() -> None:
    samples = np.arange(-12.0, 12.0).reshape(4, 6)
    assert blocks.peak(samples.T) == 12.0
    assert blocks.peak(samples[:, ::2]) == 12.0
    assert blocks.peak(samples[:0]) == 0.0
    assert blocks.peak(samples.astype(np.int16)) == 12.0  # type: ignore[arg-type]
    assert blocks.peak(np.float32(3.0) * np.ones(())) == 3.0


@needs_compiled
@given(
    st.integers(1, 3),
    st.integers(0, 1_300),
    st.floats(0.1, 3.0) | st.floats(0.999, 1.001),
    st.floats(0.0, 1.0, exclude_max=True),
    st.integers(0, 2**45),
)
def test_frames_between_frames_are_the_same_compiled_and_in_numpy(
    channels: int, count: int, step: float, fraction: float, start: int
) -> None:
    ring = np.random.default_rng(1).uniform(-1, 1, (4_096, channels)).astype(np.float32)
    compiled, twin = (CubicReader(ring) for _ in range(2))
    for reader in (compiled, twin):
        reader.jump_to(start)
        reader.fraction = fraction
    made = np.empty((count, channels), np.float32)
    # Of an array that is not contiguous nothing compiled can be made.
    apart = np.empty((count, 2 * channels), np.float32)[:, ::2]
    compiled.read(made, step)
    twin.read(apart, step)
    # Sums up to 1.6 are rounded to float32, each to 6e-8 of 1; all before that is float64.
    np.testing.assert_allclose(made, apart, rtol=0, atol=3e-7)
    assert compiled.position + compiled.fraction == pytest.approx(twin.position + twin.fraction)


@needs_compiled
@pytest.mark.parametrize(
    "change",
    [
        {"row": 8},
        {"row": -1},
        {"row": 1.0},
        {"fraction": 1.0},
        {"fraction": -0.1},
        {"fraction": math.nan},
        {"step": 0.0},
        {"step": math.nan},
        {"step": math.inf},
        {"step": 1e300},
        {"ring": np.zeros((8, 1))},
        {"ring": np.zeros((8, 2), np.float32)},
        {"ring": np.zeros((0, 1), np.float32)},
        {"ring": np.zeros(8, np.float32)},
        {"ring": None},
        {"out": np.zeros((4, 1))},
        {"out": np.zeros((4, 2), np.float32)[:, :1]},
        {"out": b"1234"},
    ],
)
def test_what_does_not_fit_is_refused_and_nothing_is_read(change: dict[str, object]) -> None:
    assert blocks.compiled is not None
    fitting = {
        "ring": np.zeros((8, 1), np.float32),
        "out": np.zeros((4, 1), np.float32),
        "row": 0,
        "fraction": 0.0,
        "step": 1.0,
    }
    cubic: Callable[..., None] = blocks.compiled.cubic
    cubic(**fitting)
    with pytest.raises((TypeError, ValueError, BufferError, OverflowError)):
        cubic(**(fitting | change))


def test_without_what_is_compiled_the_same_is_done_in_numpy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ring = np.random.default_rng(2).uniform(-1, 1, (512, 1)).astype(np.float32)
    with_it, without = (CubicReader(ring) for _ in range(2))
    expected, got = (np.empty((300, 1), np.float32) for _ in range(2))
    with_it.read(expected, 1.0001)
    monkeypatch.setattr(blocks, "compiled", None)
    without.read(got, 1.0001)
    np.testing.assert_allclose(got, expected, rtol=0, atol=3e-7)
    assert blocks.peak(ring) == in_numpy(ring)


@given(arrays.arrays(np.float32, st.tuples(st.integers(0, 300), st.integers(1, 3))), st.booleans())
def test_a_block_that_is_taken_is_bytes_then_and_all_zero(
    frames: Float32Array, in_numpy_alone: bool
) -> None:
    before = frames.copy()
    with pytest.MonkeyPatch.context() as patch:
        if in_numpy_alone:
            patch.setattr(blocks, "compiled", None)
        taken = blocks.emptied(frames)
    if np.isfinite(before).all():
        assert taken == before.tobytes()
        assert frames.tobytes() == bytes(frames.nbytes)
    else:
        assert taken is None
        np.testing.assert_array_equal(frames, before)


@needs_compiled
@pytest.mark.parametrize(
    "array", [np.zeros((4, 2), np.float32)[:, :1], b"1234", None, np.zeros(4, np.int16)]
)
def test_what_cannot_be_taken_is_refused(array: object) -> None:
    assert blocks.compiled is not None
    with pytest.raises((TypeError, BufferError)):
        blocks.compiled.peak(array)  # type: ignore[arg-type]


VOLTS = st.floats(-30.0, 30.0) | st.sampled_from([0.0, -0.0, 5e-324, 1e101, math.nan, -math.inf])


@pytest.mark.exhaustive
@needs_compiled
@given(arrays.arrays(np.float64, st.integers(0, 1_300), elements=VOLTS), st.integers(1, 1_300))
def test_the_linear_model_moves_the_same_compiled_and_in_numpy(
    volts: FloatArray, blocksize: int
) -> None:
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


@needs_compiled
@pytest.mark.parametrize(
    "change",
    [
        {"volts": np.zeros(8, np.float32)},
        {"volts": np.zeros((8, 1))},
        {"volts": np.zeros(16)[::2]},
        {"poles": np.zeros((2, 5))},
        {"poles": np.zeros((3, 6))},
        {"state": np.zeros(7)},
        {"state": np.frombuffer(bytes(64))},
        {"taps": np.zeros((1, 3))},
        {"taps": np.zeros((2, 4))},
        {"moved": np.zeros((1, 7))},
        {"moved": np.zeros(8)},
        {"start": 5, "stop": 4},
        {"stop": 9},
        {"start": -1},
        {"limit": "high"},
    ],
)
def test_what_is_no_motion_is_refused_and_nothing_is_moved(change: dict[str, object]) -> None:
    assert blocks.compiled is not None
    state, moved = np.zeros(8), np.zeros((1, 8))
    fitting: dict[str, object] = {
        "volts": np.ones(8),
        "poles": np.ones((2, 6)),
        "state": state,
        "taps": np.ones((1, 4)),
        "moved": moved,
        "start": 0,
        "stop": 8,
        "limit": 1e100,
    }
    move: Callable[..., int] = blocks.compiled.linear_motion
    with pytest.raises((TypeError, ValueError, BufferError, OverflowError)):
        move(**(fitting | change))
    assert not state.any()
    assert not moved.any()
    assert move(**fitting) == 0
    assert moved.any()
