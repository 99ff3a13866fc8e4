"""Float frames as bytes of a card: one rounding rule, clamped, and what the bytes stand for."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from audioflinger_hook.mixer.pcm import PcmFormat, decode
from audioflinger_hook.mixer.pcm import encode as mixer_encode
from device.stream.sample_format import Encoder, SampleFormat

INTEGERS = {
    SampleFormat.S16: PcmFormat.I16,
    SampleFormat.S24_3: PcmFormat.I24,
    SampleFormat.S32: PcmFormat.I32,
}

integers = pytest.mark.parametrize("sample_format", INTEGERS)
blocks = arrays(
    np.float32,
    st.tuples(st.integers(0, 9), st.just(3)),
    elements=st.floats(-4.0, 4.0, width=32) | st.floats(-(2.0**-20), 2.0**-20, width=32),
)


def steps_of(stored: bytes, sample_format: SampleFormat) -> list[int]:
    """The stored integers, read byte by byte with Python's own arithmetic."""
    size = sample_format.bytes_per_sample
    return [
        int.from_bytes(stored[first : first + size], "little", signed=True)
        for first in range(0, len(stored), size)
    ]


def rounded_half_away(sample: float, bits: int) -> int:
    """The stored integer by exact rational arithmetic."""
    full = 2 ** (bits - 1)
    exact = min(max(Fraction(sample) * full, Fraction(-full)), Fraction(full - 1))
    magnitude = int(abs(exact) + Fraction(1, 2))
    return magnitude if exact >= 0 else -magnitude


@pytest.mark.exhaustive
@integers
@given(frames=blocks)
def test_every_sample_is_clamped_and_rounded_half_away_from_zero(sample_format, frames) -> None:
    stored = Encoder(sample_format, 3, 4).encode(frames)
    expected = [rounded_half_away(float(x), sample_format.bits) for x in frames.ravel()]
    assert steps_of(stored, sample_format) == expected


@integers
@given(frames=blocks)
def test_cards_and_the_mixers_sinks_get_the_same_bytes(sample_format, frames) -> None:
    assert Encoder(sample_format, 3, 4).encode(frames) == mixer_encode(
        frames, INTEGERS[sample_format]
    )


@pytest.mark.sweep
@integers
@given(frames=blocks)
def test_what_was_encoded_is_what_the_bytes_stand_for_and_gives_them_again(
    sample_format, frames
) -> None:
    encoder = Encoder(sample_format, 3, 4)
    stored = encoder.encode(frames)
    meant = encoder.decode_last()
    assert meant.dtype == np.float32
    assert not meant.flags.writeable
    np.testing.assert_array_equal(meant, decode(stored, INTEGERS[sample_format], 3))
    assert encoder.encode(meant) == stored


@integers
def test_full_scale_infinity_and_what_is_no_number_stay_within_the_integers(sample_format) -> None:
    full = 2 ** (sample_format.bits - 1)
    frames = np.array([1.0, -1.0, np.inf, -np.inf, np.nan, -0.0], np.float32)[:, None]
    stored = Encoder(sample_format, 1, 6).encode(frames)
    assert steps_of(stored, sample_format) == [full - 1, -full, full - 1, -full, 0, 0]


@integers
def test_blocks_do_not_depend_on_those_before_them(sample_format) -> None:
    encoder = Encoder(sample_format, 2, 8)
    first = np.linspace(-1.0, 1.0, 16, dtype=np.float32).reshape(8, 2)
    kept = encoder.encode(first), encoder.decode_last().copy()
    meant = encoder.decode_last()
    for frames in (3, 8, 0):
        encoder.encode(np.zeros((frames, 2), np.float32))
        assert not encoder.decode_last().any()
    np.testing.assert_array_equal(meant, kept[1])
    assert encoder.encode(first) == kept[0]
