import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from device.clock.delay_line import CubicReader, NewestFrames


@pytest.mark.sweep
@settings(max_examples=40)
@given(st.lists(st.integers(0, 1_300), max_size=12), st.floats(0.1, 3.0), st.integers(0, 2**45))
def test_blocks_of_any_length_join_to_the_same_frames_as_one(blocks, step, start):
    ring = np.random.default_rng(1).uniform(-1, 1, (4_096, 2)).astype(np.float32)
    whole, parts = CubicReader(ring), CubicReader(ring)
    whole.jump_to(start)
    parts.jump_to(start)
    expected = np.empty((sum(blocks), 2), np.float32)
    whole.read(expected, step)
    got, first = np.empty_like(expected), 0
    for frames in blocks:
        parts.read(got[first : first + frames], step)
        first += frames
    # Sums of 1300 steps are rounded in another order: a billionth of a frame.
    np.testing.assert_allclose(got, expected, atol=2e-6)
    assert (parts.position - start + parts.fraction) == pytest.approx(sum(blocks) * step, abs=1e-8)
    assert 0.0 <= parts.fraction < 1.0


@pytest.mark.sweep
@settings(max_examples=40)
@given(st.integers(0, 3_000), st.floats(0.1, 3.0), st.floats(0.0, 0.999))
def test_readable_is_as_much_as_needs_no_frame_that_is_not_there(written, step, fraction):
    reader = CubicReader(np.zeros((4_096, 1), np.float32))
    reader.fraction = fraction
    frames = reader.readable(written, step)
    if frames:
        assert fraction + (frames - 1) * step < written - 2
    assert fraction + frames * step >= written - 2 - 1e-6


@pytest.mark.sweep
@settings(max_examples=40)
@given(st.lists(st.integers(0, 500), max_size=10))
def test_the_ring_holds_the_newest_frames_whatever_the_blocks(blocks):
    ring, written = NewestFrames(128, 1), 0
    for frames in blocks:
        written = ring.store(np.arange(written, written + frames, dtype=np.float32)[:, np.newaxis])
    assert ring.claimed == written == sum(blocks)
    for frame in range(max(0, ring.oldest), written):
        assert ring.frames[frame % 128, 0] == frame


def test_the_ring_says_what_it_overwrites_before_it_does():
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
def test_what_is_no_vibration_becomes_silence(wrong):
    ring = NewestFrames(8, 2)
    ring.store(np.array([[0.5, wrong], [wrong, -0.5]]))
    assert ring.frames[:2].tolist() == [[0.5, 0.0], [0.0, -0.5]]
