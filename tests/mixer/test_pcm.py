"""Sample formats: exact decoding, one rounding rule, clamping, and what is refused."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from audioflinger_hook.mixer.pcm import PcmFormat, decode, encode
from device.errors import UsageError

INTEGERS = [PcmFormat.U8, PcmFormat.I16, PcmFormat.I24, PcmFormat.I32]
BITS = {PcmFormat.U8: 8, PcmFormat.I16: 16, PcmFormat.I24: 24, PcmFormat.I32: 32}

samples = st.floats(-4.0, 4.0, width=32)


def stored_steps(encoded: bytes, pcm_format: PcmFormat) -> list[int]:
    """The stored integers, read byte by byte with Python's own arithmetic; u8 around 0."""
    size = BITS[pcm_format] // 8
    signed = pcm_format is not PcmFormat.U8
    steps = [
        int.from_bytes(encoded[first : first + size], "little", signed=signed)
        for first in range(0, len(encoded), size)
    ]
    return steps if signed else [step - 128 for step in steps]


def rounded_half_away(sample: float, bits: int) -> int:
    """The stored integer by exact rational arithmetic."""
    full = 2 ** (bits - 1)
    exact = min(max(Fraction(sample) * full, Fraction(-full)), Fraction(full - 1))
    magnitude = int(abs(exact) + Fraction(1, 2))
    return magnitude if exact >= 0 else -magnitude


@pytest.mark.sweep
@pytest.mark.parametrize("pcm_format", INTEGERS)
@given(frames=arrays(np.float32, (5, 2), elements=samples))
def test_every_sample_is_clamped_and_rounded_half_away_from_zero(pcm_format, frames) -> None:
    expected = [rounded_half_away(float(x), BITS[pcm_format]) for x in frames.ravel()]
    assert stored_steps(encode(frames, pcm_format), pcm_format) == expected


@pytest.mark.parametrize("pcm_format", INTEGERS)
def test_halves_go_away_from_zero_and_what_lies_just_below_them_does_not(pcm_format) -> None:
    full = 2.0 ** (BITS[pcm_format] - 1)
    steps = np.array([0.5, -0.5, 1.5, -2.5, 0.5 - 2.0**-54, -0.49999999, 3.0])
    encoded = encode((steps / full)[:, None], pcm_format)
    assert stored_steps(encoded, pcm_format) == [1, -1, 2, -3, 0, 0, 3]


@pytest.mark.parametrize("pcm_format", INTEGERS)
def test_full_scale_and_beyond_are_clamped_to_the_ends_of_the_integers(pcm_format) -> None:
    full = 2 ** (BITS[pcm_format] - 1)
    frames = np.array([[1.0], [-1.0], [7.0], [-7.0], [np.inf], [-np.inf], [np.nan]], np.float32)
    steps = stored_steps(encode(frames, pcm_format), pcm_format)
    assert steps == [full - 1, -full, full - 1, -full, full - 1, -full, 0]


@pytest.mark.sweep
@pytest.mark.parametrize("pcm_format", [PcmFormat.U8, PcmFormat.I16, PcmFormat.I24])
@given(seed=st.integers(0, 2**32 - 1), channels=st.integers(1, 4))
def test_integers_up_to_24_bits_survive_decode_and_encode_to_the_bit(
    pcm_format, seed, channels
) -> None:
    frame_bytes = channels * pcm_format.bytes_per_sample
    stored = np.random.default_rng(seed).bytes(16 * frame_bytes)
    frames = decode(stored, pcm_format, channels)
    assert frames.shape == (16, channels)
    assert np.abs(frames).max() <= 1.0
    assert encode(frames, pcm_format) == stored


@given(st.lists(st.integers(-(2**31), 2**31 - 1), min_size=1, max_size=20))
def test_32_bit_integers_are_rounded_to_the_nearest_float_and_no_further(numbers) -> None:
    stored = np.array(numbers, "<i4")
    frames = decode(stored, PcmFormat.I32, 1)
    np.testing.assert_array_equal(frames[:, 0], (stored / 2.0**31).astype(np.float32))
    again = np.frombuffer(encode(frames, PcmFormat.I32), "<i4")
    # a float32 has 24 bits: half a step of the upper binade is 2^6, and 1.0 is clamped
    assert np.abs(again.astype(np.int64) - stored).max() <= 2**6


@given(arrays(np.uint32, (4, 3)))
def test_float_frames_pass_with_every_bit(bits) -> None:
    frames = decode(bits.view(np.float32), PcmFormat.FLOAT, 3)
    np.testing.assert_array_equal(frames.view(np.uint32), bits)


@given(arrays(np.float32, (6, 2), elements=st.floats(-2.0, 2.0, width=32)))
def test_float_sinks_take_up_to_two_unchanged_and_clamp_there(frames) -> None:
    again = decode(encode(frames, PcmFormat.FLOAT), PcmFormat.FLOAT, 2)
    np.testing.assert_array_equal(again.view(np.uint32), frames.view(np.uint32))
    beyond = np.array([[2.5, -1e9], [np.nan, np.inf]], np.float32)
    clamped = decode(encode(beyond, PcmFormat.FLOAT), PcmFormat.FLOAT, 2)
    assert clamped.tolist() == [[2.0, -2.0], [0.0, 2.0]]


def test_packed_24_bits_are_three_bytes_little_endian_with_their_sign() -> None:
    stored = bytes([0x01, 0x00, 0x00, 0xFF, 0xFF, 0xFF, 0x00, 0x00, 0x80, 0xFF, 0xFF, 0x7F])
    frames = decode(stored, PcmFormat.I24, 2)
    expected = np.array([[1, -1], [-(2**23), 2**23 - 1]]) / 2.0**23
    np.testing.assert_array_equal(frames, expected)


def test_bytes_memory_and_arrays_say_the_same() -> None:
    array = np.arange(-6, 6, dtype="<i2").reshape(6, 2)
    expected = decode(array, PcmFormat.I16, 2)
    for same in (array.tobytes(), bytearray(array.tobytes()), array.data, array.ravel()):
        np.testing.assert_array_equal(decode(same, PcmFormat.I16, 2), expected)
    every_second = np.repeat(array.ravel(), 2).data[::2]
    np.testing.assert_array_equal(decode(every_second, PcmFormat.I16, 2), expected)


@pytest.mark.parametrize("pcm_format", list(PcmFormat))
def test_no_frames_are_no_error(pcm_format) -> None:
    assert decode(b"", pcm_format, 3).shape == (0, 3)
    assert encode(np.zeros((0, 3), np.float32), pcm_format) == b""


def test_decoding_copies() -> None:
    source = np.zeros((2, 1), np.float32)
    frames = decode(source, PcmFormat.FLOAT, 1)
    source[:] = 1.0
    assert not frames.any()


@pytest.mark.parametrize(
    ("stored", "pcm_format", "channels", "said"),
    [
        (b"\0" * 7, PcmFormat.I16, 2, "7 bytes .* multiple of 4"),
        (b"\0" * 7, PcmFormat.I24, 1, "7 bytes .* multiple of 3"),
        (np.zeros((4, 2)), PcmFormat.FLOAT, 2, "float64 .* float32"),
        (np.zeros(4, ">i2"), PcmFormat.I16, 1, ">i2 .* int16"),
        (np.zeros((4, 3), np.float32), PcmFormat.FLOAT, 2, r"\(4, 3\) .* 2 channels"),
        (np.zeros((2, 2, 2), np.float32), PcmFormat.FLOAT, 2, r"\(2, 2, 2\)"),
        (np.zeros(5, np.float32), PcmFormat.FLOAT, 2, "multiple of 2"),
        ([0.0, 1.0], PcmFormat.FLOAT, 2, "list"),
    ],
)
def test_what_does_not_fit_the_format_is_refused_with_what_is_wanted(
    stored, pcm_format, channels, said
) -> None:
    with pytest.raises(UsageError, match=said):
        decode(stored, pcm_format, channels)
