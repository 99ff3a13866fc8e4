import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from audioflinger_hook.mixer.pcm import PcmFormat, decode, encode
from audioflinger_hook.mixer.resampler import Resampler
from device.errors import UsageError
from tests.support.signals import level_db

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


STOP_BAND_DB = -90.0
"""AOSP's own check asks for -60 dB."""
RIPPLE_DB = 0.01
"""AOSP's own check asks for 0.2 dB."""

# exact with one and with many phases, up and down, few and many taps; and interpolated
PAIRS = [
    *((44_100, 48_000), (48_000, 44_100), (48_000, 32_000), (48_000, 22_050), (8_000, 48_000)),
    *((192_000, 48_000), (47_999, 48_000), (48_000, 47_999), (96_001, 48_000)),
]
EACH_PAIR = pytest.mark.parametrize(("rate_in", "rate_out"), PAIRS)


def produced(resampler, count, channels=1):
    frames = np.full((count, channels), np.nan, np.float32)
    resampler.produce(frames)
    return frames


def resampled(source, rate_in, rate_out, count):
    resampler = Resampler(rate_in, rate_out, source.shape[1], count)
    resampler.feed(source[: resampler.frames_needed(count)])
    return produced(resampler, count, source.shape[1])


def tone(frequency_hz: float, rate: int, count: int) -> np.ndarray:
    return np.sin(2 * np.pi * frequency_hz * np.arange(count) / rate).astype(np.float32)[:, None]


@pytest.mark.sweep
@EACH_PAIR
@settings(max_examples=60)
@given(
    channels=st.integers(1, 3),
    demands=st.lists(st.integers(0, 400), min_size=1, max_size=12),
    pieces=st.lists(st.integers(1, 900), min_size=1, max_size=5),
    ahead=st.integers(0, 300),
)
def test_any_split_gives_the_same_bits(rate_in, rate_out, channels, demands, pieces, ahead):
    total = sum(demands)
    source = np.random.default_rng(channels).standard_normal((24_000, channels), np.float32)
    whole = resampled(source, rate_in, rate_out, max(total, 1))[:total]
    resampler = Resampler(rate_in, rate_out, channels, 16)
    sizes, fed, parts = itertools.cycle(pieces), 0, []
    for demand in demands:
        # in pieces, and further than needed
        end = fed + resampler.frames_needed(demand) + ahead
        while fed < end:
            size = min(next(sizes), end - fed)
            resampler.feed(source[fed : fed + size])
            fed += size
        parts.append(produced(resampler, demand, channels))
    np.testing.assert_array_equal(np.concatenate(parts).view(np.uint32), whole.view(np.uint32))


@EACH_PAIR
def test_a_second_in_mix_periods_needs_exact_counts(rate_in, rate_out):
    resampler, fed = Resampler(rate_in, rate_out, 2, 960), 0
    for first in range(0, rate_out - 960, 960):
        needed = resampler.frames_needed(960)
        resampler.feed(np.zeros((needed, 2), np.float32))
        fed += needed
        # up to the input frame at or before the last output frame, not one more
        assert fed == (first + 959) * rate_in // rate_out + 1
        produced(resampler, 960, 2)


@pytest.mark.parametrize(
    ("rate_in", "rate_out"),
    [(48_000, 32_000), (48_000, 22_050), (48_000, 22_100), (96_001, 48_000)],
)
def test_the_stop_band_lets_nothing_fold_back(rate_in, rate_out):
    count = rate_out // 8
    for frequency_hz in np.linspace(rate_out / 2, rate_in / 2 - 10, 30):
        source = tone(frequency_hz, rate_in, rate_in // 8 + 10)
        settled = resampled(source, rate_in, rate_out, count)[count // 4 :]
        assert level_db(settled) < STOP_BAND_DB, f"{frequency_hz:.0f} Hz"


@EACH_PAIR
def test_the_pass_band_is_flat_and_images_are_gone(rate_in, rate_out):
    low, gains_db = min(rate_in, rate_out), []
    for frequency_hz in np.linspace(20, 0.9 * low / 2, 20):
        source, count = tone(frequency_hz, rate_in, rate_in // 4 + 10), rate_out // 4
        frames = resampled(source, rate_in, rate_out, count)[count // 4 :, 0].astype(np.float64)
        phase = 2 * np.pi * frequency_hz * np.arange(len(frames)) / rate_out
        basis = np.stack([np.sin(phase), np.cos(phase)], axis=1)
        weights = np.linalg.lstsq(basis, frames)[0]
        gains_db.append(20 * np.log10(np.hypot(*weights)))
        assert level_db(frames - basis @ weights) < STOP_BAND_DB, f"{frequency_hz:.0f} Hz"
    assert np.ptp(gains_db) < RIPPLE_DB
    assert np.abs(gains_db).max() < RIPPLE_DB


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("rate_in", "rate_out"), [(44_100, 48_000), (44_117, 48_000), (96_000, 48_000)]
)
def test_the_position_is_exact_after_a_minute(rate_in, rate_out):
    frequency_hz, resampler = 997.0, Resampler(rate_in, rate_out, 1, 9_600)
    fed = made = 0
    while made < 60 * rate_out:
        needed = resampler.frames_needed(9_600)
        instants = np.arange(fed, fed + needed) / rate_in
        resampler.feed(np.sin(2 * np.pi * frequency_hz * instants).astype(np.float32)[:, None])
        part = produced(resampler, 9_600)
        fed, made = fed + needed, made + len(part)
    instants = np.arange(made - len(part), made) / rate_out - (resampler.latency_frames / rate_in)
    expected = np.sin(2 * np.pi * frequency_hz * instants)
    # the filter's own error; one frame of drift would be 0.13
    np.testing.assert_allclose(part[:, 0], expected, rtol=0, atol=3e-5)


@pytest.mark.parametrize(
    ("rate_in", "rate_out"),
    [*PAIRS, (1_000, 768_000), (768_000, 1_000), (767_999, 8_000), (1_001, 48_000)],
)
def test_a_constant_stays_that_and_silence_is_exact_even_at_extreme_rates(rate_in, rate_out):
    source, count = np.ones((rate_in, 1), np.float32), rate_out // 4
    frames = resampled(source, rate_in, rate_out, count)
    # a float32 sum of many coefficients
    np.testing.assert_allclose(frames[count // 2 :], 1.0, rtol=0, atol=4e-6)
    assert not resampled(0 * source, rate_in, rate_out, count).any()


@EACH_PAIR
def test_its_tail_brings_out_all_that_was_fed(rate_in, rate_out):
    source = np.random.default_rng(1).standard_normal((rate_in // 20, 1), np.float32)
    resampler = Resampler(rate_in, rate_out, 1, rate_out)
    resampler.feed(source)
    resampler.feed(np.zeros((resampler.tail_frames, 1), np.float32))
    frames = produced(resampler, (len(source) + resampler.tail_frames) * rate_out // rate_in)
    # interpolated sums over the whole response: its spectrum at 0 Hz, which passes as it is
    assert frames.sum(dtype=np.float64) / rate_out == pytest.approx(
        source.sum(dtype=np.float64) / rate_in, abs=1e-6
    )
    resampler.feed(np.zeros((resampler.frames_needed(64) + 1, 1), np.float32))
    rest = produced(resampler, 64)
    # the filter ends at its window's edge: a step of 1/I0(beta) times a sinc's 64th side lobe
    assert np.abs(rest).max() < 1e-4
    assert np.abs(rest[2 * rate_out // rate_in + 2 :]).max(initial=0.0) == 0.0


def test_reset_makes_a_new_stream():
    source = np.random.default_rng(2).standard_normal((4_000, 2), np.float32)
    resampler, runs = Resampler(44_100, 48_000, 2, 960), []
    for _ in range(2):
        resampler.feed(source[: resampler.frames_needed(777)])
        runs.append(produced(resampler, 777, 2))
        resampler.reset()
    np.testing.assert_array_equal(runs[0], runs[1])


@EACH_PAIR
def test_samples_that_are_not_finite_count_as_zero(rate_in, rate_out):
    source = np.random.default_rng(3).standard_normal((rate_in // 10, 2), np.float32)
    cleaned = source.copy()
    cleaned[500:503] = 0.0
    source[500:503] = np.nan, np.inf
    source[501] = -np.inf
    made = [resampled(one, rate_in, rate_out, rate_out // 12) for one in (source, cleaned)]
    np.testing.assert_array_equal(*made)
