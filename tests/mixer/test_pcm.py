import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from audioflinger_hook.mixer.pcm import PcmFormat, decode, encode
from device.errors import UsageError

BITS = {PcmFormat.U8: 8, PcmFormat.I16: 16, PcmFormat.I24: 24, PcmFormat.I32: 32}
INTEGERS = list(BITS)

samples = st.floats(-4.0, 4.0, width=32)


def stored_steps(encoded: bytes, pcm_format: PcmFormat) -> list[int]:
    """The stored integers, read byte by byte with Python's own arithmetic; u8 around 0."""
    size, is_u8 = BITS[pcm_format] // 8, pcm_format is PcmFormat.U8
    parts = [encoded[first : first + size] for first in range(0, len(encoded), size)]
    return [int.from_bytes(part, "little", signed=not is_u8) - 128 * is_u8 for part in parts]


@pytest.mark.sweep
@pytest.mark.parametrize("pcm_format", INTEGERS)
@given(frames=arrays(np.float32, (5, 2), elements=samples))
def test_every_sample_is_clamped_and_rounded_half_away_from_zero(pcm_format, frames):
    full = 2.0 ** (BITS[pcm_format] - 1)
    exact = np.clip(frames.ravel().astype(float) * full, -full, full - 1)
    expected = np.trunc(exact + np.copysign(0.5, exact)).tolist()
    assert stored_steps(encode(frames, pcm_format), pcm_format) == expected


@pytest.mark.parametrize("pcm_format", INTEGERS)
def test_so_are_halves_what_lies_just_below_them_full_scale_and_beyond(pcm_format):
    full = 2 ** (BITS[pcm_format] - 1)
    halves = [0.5, -0.5, 1.5, -2.5, 0.5 - 2.0**-54, -0.49999999, 3.0]
    frames = np.array([*halves, full, -full, 7 * full, -np.inf, np.inf, np.nan])[:, None] / full
    steps = stored_steps(encode(frames, pcm_format), pcm_format)
    assert steps == [1, -1, 2, -3, 0, 0, 3, full - 1, -full, full - 1, -full, full - 1, 0]


@pytest.mark.sweep
@pytest.mark.parametrize("pcm_format", [PcmFormat.U8, PcmFormat.I16, PcmFormat.I24])
@given(seed=st.integers(0, 2**32 - 1), channels=st.integers(1, 4))
def test_integers_up_to_24_bits_survive_decode_and_encode_to_the_bit(pcm_format, seed, channels):
    stored = np.random.default_rng(seed).bytes(16 * (channels * pcm_format.bytes_per_sample))
    frames = decode(stored, pcm_format, channels)
    assert frames.shape == (16, channels)
    assert np.abs(frames).max() <= 1.0
    assert encode(frames, pcm_format) == stored


@given(st.lists(st.integers(-(2**31), 2**31 - 1), min_size=1, max_size=20))
def test_32_bit_integers_are_rounded_to_the_nearest_float_and_no_further(numbers):
    stored = np.array(numbers, "<i4")
    frames = decode(stored, PcmFormat.I32, 1)
    np.testing.assert_array_equal(frames[:, 0], (stored / 2.0**31).astype(np.float32))
    again = np.frombuffer(encode(frames, PcmFormat.I32), "<i4")
    # a float32 has 24 bits: half a step of the upper binade is 2^6, and 1.0 is clamped
    assert np.abs(again.astype(np.int64) - stored).max() <= 2**6


@given(arrays(np.uint32, (4, 3)))
def test_float_frames_pass_with_every_bit(bits):
    frames = decode(bits.view(np.float32), PcmFormat.FLOAT, 3)
    np.testing.assert_array_equal(frames.view(np.uint32), bits)


@given(arrays(np.float32, (6, 2), elements=st.floats(-2.0, 2.0, width=32)))
def test_float_sinks_take_up_to_two_unchanged_and_clamp_there(frames):
    again = decode(encode(frames, PcmFormat.FLOAT), PcmFormat.FLOAT, 2)
    np.testing.assert_array_equal(again.view(np.uint32), frames.view(np.uint32))
    beyond = np.array([[2.5, -1e9], [np.nan, np.inf]], np.float32)
    clamped = decode(encode(beyond, PcmFormat.FLOAT), PcmFormat.FLOAT, 2)
    assert clamped.tolist() == [[2.0, -2.0], [0.0, 2.0]]


@pytest.mark.parametrize("pcm_format", list(PcmFormat))
def test_no_frames_are_no_error_and_decoding_copies(pcm_format):
    assert encode(np.zeros((0, 3), np.float32), pcm_format) == b""
    assert decode(b"", pcm_format, 3).shape == (0, 3)
    source = bytearray(encode(np.full((2, 3), 0.5, np.float32), pcm_format))
    frames = decode(source, pcm_format, 3)
    source[:] = bytes(len(source))
    assert (frames == 0.5).all()


def test_bytes_memory_and_arrays_say_the_same():
    array = np.arange(-6, 6, dtype="<i2").reshape(6, 2)
    expected = decode(array, PcmFormat.I16, 2)
    for same in (array.tobytes(), bytearray(array.tobytes()), array.data, array.ravel()):
        np.testing.assert_array_equal(decode(same, PcmFormat.I16, 2), expected)
    every_second = np.repeat(array.ravel(), 2).data[::2]
    np.testing.assert_array_equal(decode(every_second, PcmFormat.I16, 2), expected)


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
def test_what_does_not_fit_is_refused_with_what_is_wanted(stored, pcm_format, channels, said):
    with pytest.raises(UsageError, match=said):
        decode(stored, pcm_format, channels)
