"""The normal mix buffer: AudioFlinger's own values, and what holds for any rate."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from audioflinger_hook.mixer.mix_buffer import normal_buffer_frames


@pytest.mark.parametrize(
    ("hal_frames", "expected"),
    [(192, 960), (240, 960), (256, 768), (512, 1024), (600, 1152), (960, 960), (1920, 1920)],
)
def test_the_values_of_audioflinger_at_48_khz(hal_frames: int, expected: int) -> None:
    assert normal_buffer_frames(48_000, hal_frames) == expected


@given(samplerate=st.integers(1_000, 768_000), hal_frames=st.integers(1, 100_000))
def test_a_buffer_is_whole_sixteens_and_never_shorter_than_a_hal_buffer(
    samplerate: int, hal_frames: int
) -> None:
    frames = normal_buffer_frames(samplerate, hal_frames)
    assert frames % 16 == 0
    assert frames >= hal_frames


@given(samplerate=st.integers(8_000, 768_000), hal_frames=st.integers(1, 100_000))
def test_a_buffer_lasts_13_to_24_ms_unless_the_hal_buffer_is_longer(
    samplerate: int, hal_frames: int
) -> None:
    frames = normal_buffer_frames(samplerate, hal_frames)
    # floor(20 ms / h) leaves at least two thirds: 2 h to 3 h for 2 < 20 ms / h < 3
    assert frames > samplerate * 0.020 * 2 / 3 - 16
    if hal_frames <= samplerate * 0.020:
        assert frames <= max(samplerate * 0.024, samplerate * 0.020 + 32)
