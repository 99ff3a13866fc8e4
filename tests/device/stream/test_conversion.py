"""Float frames as bytes of a card: those of the mixer's sinks, and what the bytes stand for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from audioflinger_hook.mixer.pcm import PcmFormat, decode
from audioflinger_hook.mixer.pcm import encode as mixer_encode
from device.stream.sample_format import Encoder, SampleFormat

S16, S24, S32 = SampleFormat.S16, SampleFormat.S24_3, SampleFormat.S32
INTEGERS = {S16: PcmFormat.I16, S24: PcmFormat.I24, S32: PcmFormat.I32}

integers = pytest.mark.parametrize("sample_format", INTEGERS)
samples = (
    st.floats(-4.0, 4.0, width=32)
    | st.floats(-(2.0**-20), 2.0**-20, width=32)
    | st.sampled_from([1.0, -1.0, -0.0, np.inf, -np.inf, np.nan])
)
blocks = arrays(np.float32, st.tuples(st.integers(0, 9), st.just(3)), elements=samples)


@integers
@given(frames=blocks)
def test_cards_and_the_mixers_sinks_get_the_same_bytes(sample_format, frames):
    expected = mixer_encode(frames, INTEGERS[sample_format])
    assert Encoder(sample_format, 3, 4).encode(frames) == expected


@pytest.mark.sweep
@integers
@given(frames=blocks)
def test_what_was_encoded_is_what_the_bytes_stand_for_and_gives_them_again(sample_format, frames):
    encoder = Encoder(sample_format, 3, 4)
    stored, meant = encoder.encode(frames), encoder.decode_last()
    assert meant.dtype == np.float32
    assert not meant.flags.writeable
    np.testing.assert_array_equal(meant, decode(stored, INTEGERS[sample_format], 3))
    assert encoder.encode(meant) == stored


@integers
def test_blocks_do_not_depend_on_those_before_them(sample_format):
    encoder = Encoder(sample_format, 2, 8)
    first = np.linspace(-1.0, 1.0, 16, dtype=np.float32).reshape(8, 2)
    stored, meant = encoder.encode(first), encoder.decode_last()
    kept = meant.copy()
    for frames in (3, 8, 0):
        encoder.encode(np.zeros((frames, 2), np.float32))
        assert not encoder.decode_last().any()
    np.testing.assert_array_equal(meant, kept)
    assert encoder.encode(first) == stored
