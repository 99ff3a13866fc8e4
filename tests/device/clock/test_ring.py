"""Frames between frames, and the joins between pieces."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from device.clock.ring import CubicReader, Joint, NewestFrames
from tests.support.signals import tone


def error_db(hz: float, step: float, samplerate: int = 48_000) -> float:
    sound = tone(hz, 2.0, samplerate)
    reader = CubicReader(sound.astype(np.float32)[:, np.newaxis])
    reader.jump_to(1)
    out = np.empty((reader.readable(len(sound), step), 1), np.float32)
    reader.read(out, step)
    at = 1 + np.arange(len(out)) * step
    error = out[:, 0] - np.sin(2 * np.pi * hz * at / samplerate + 0.3)
    return float(10 * np.log10(2 * (error**2).mean()))


@pytest.mark.parametrize(
    "step",
    [
        pytest.param(0.9997, marks=pytest.mark.exhaustive),
        1.000153,
        44_100 / 48_000,
        pytest.param(48_000 / 44_100, marks=pytest.mark.exhaustive),
    ],
)
@pytest.mark.parametrize(
    ("hz", "limit_db"),
    [pytest.param(20, -148, marks=pytest.mark.exhaustive), (250, -147), (500, -129)],
)
def test_a_sine_is_read_as_exactly_as_float32_and_four_frames_allow(
    hz: float, limit_db: float, step: float
) -> None:
    assert error_db(hz, step) < limit_db


@pytest.mark.sweep
@settings(max_examples=40)
@given(st.lists(st.integers(0, 1_300), max_size=12), st.floats(0.1, 3.0), st.integers(0, 2**45))
def test_blocks_of_any_length_join_to_the_same_frames_as_one(
    blocks: list[int], step: float, start: int
) -> None:
    ring = np.random.default_rng(1).uniform(-1, 1, (4_096, 2)).astype(np.float32)
    whole, parts = CubicReader(ring), CubicReader(ring)
    whole.jump_to(start)
    parts.jump_to(start)
    expected = np.empty((sum(blocks), 2), np.float32)
    whole.read(expected, step)
    got = np.empty_like(expected)
    first = 0
    for frames in blocks:
        parts.read(got[first : first + frames], step)
        first += frames
    # Sums of 1300 steps are rounded in another order: a billionth of a frame.
    np.testing.assert_allclose(got, expected, atol=2e-6)
    moved = parts.position - start + parts.fraction
    assert moved == pytest.approx(sum(blocks) * step, abs=1e-8)
    assert 0.0 <= parts.fraction < 1.0


def test_a_ratio_that_changes_from_block_to_block_leaves_the_sine_whole() -> None:
    sound = tone(100, 4.0, 48_000)
    reader = CubicReader(sound.astype(np.float32)[:, np.newaxis])
    reader.jump_to(1)
    at, out = 1.0, np.empty((256, 1), np.float32)
    for number in range(700):
        step = 1.0 + 0.002 * np.sin(number / 20)
        reader.read(out, step)
        places = at + np.arange(256) * step
        wanted = np.sin(2 * np.pi * 100 * places / 48_000 + 0.3)
        assert np.abs(out[:, 0] - wanted).max() < 1e-6
        at += 256 * step


@pytest.mark.sweep
@settings(max_examples=40)
@given(st.integers(0, 3_000), st.floats(0.1, 3.0), st.floats(0.0, 0.999))
def test_readable_is_as_much_as_needs_no_frame_that_is_not_there(
    written: int, step: float, fraction: float
) -> None:
    reader = CubicReader(np.zeros((4_096, 1), np.float32))
    reader.fraction = fraction
    frames = reader.readable(written, step)
    if frames:
        assert fraction + (frames - 1) * step < written - 2
    assert fraction + frames * step >= written - 2 - 1e-6


@pytest.mark.sweep
@settings(max_examples=40)
@given(st.lists(st.integers(0, 500), max_size=10))
def test_the_ring_holds_the_newest_frames_whatever_the_blocks(blocks: list[int]) -> None:
    ring = NewestFrames(128, 1)
    written = 0
    for frames in blocks:
        block = np.arange(written, written + frames, dtype=np.float32)[:, np.newaxis]
        written = ring.store(block)
    assert ring.claimed == written == sum(blocks)
    for frame in range(max(0, ring.oldest), written):
        assert ring.frames[frame % 128, 0] == frame


def test_the_ring_says_what_it_overwrites_before_it_does() -> None:
    class Watched(NewestFrames):
        claims: list[int]

        def __setattr__(self, name: str, value: object) -> None:
            if name == "claimed" and "claims" in self.__dict__:
                self.claims.append(int(self.frames.any()))
            super().__setattr__(name, value)

    ring = Watched(16, 1)
    ring.claims = []
    ring.store(np.ones((4, 1), np.float32))
    assert ring.claims == [0]


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 1e300, -3e38])
def test_what_is_no_vibration_becomes_silence(wrong: float) -> None:
    ring = NewestFrames(8, 2)
    ring.store(np.array([[0.5, wrong], [wrong, -0.5]]))
    assert ring.frames[:2].tolist() == [[0.5, 0.0], [0.0, -0.5]]


@pytest.mark.parametrize("hz", [20, pytest.param(60, marks=pytest.mark.exhaustive), 250])
@pytest.mark.parametrize("to_silence", [True, False])
def test_a_join_has_no_step_in_value_or_slope(hz: float, to_silence: bool) -> None:
    before = tone(hz, 0.1, 48_000, 0.8, phase=1.0).astype(np.float32)[:, np.newaxis]
    after = tone(hz, 0.1, 48_000, 0.8, phase=3.5).astype(np.float32)[:, np.newaxis]
    if to_silence:
        after[:] = 0.0
    joint = Joint(48_000, 1)
    joint.apply(before)
    joint.begin()
    for first in range(0, len(after), 100):
        joint.apply(after[first : first + 100])
    joined = np.concatenate((before, after))[:, 0].astype(np.float64)
    steepest = 0.8 * 2 * np.pi * hz / 48_000
    assert np.abs(np.diff(joined)).max() < 2 * steepest + 0.8 * np.pi / 240
    # A hard join bends by up to 1.6 in one frame.
    assert np.abs(np.diff(joined, 2)).max() < 0.006
    assert np.abs(joined).max() < 1.2
