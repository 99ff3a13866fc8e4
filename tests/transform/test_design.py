import pickle
import struct
import zlib
from dataclasses import FrozenInstanceError, fields
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.fft
import scipy.signal
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import ellip, freqz

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.core import blob, rounding
from audioflinger_hook.core.rounding import round_filter, round_number, round_sections, round_table
from audioflinger_hook.transform import TransformParameters, filters
from audioflinger_hook.transform.design import SECTIONS, LiveDesign, _designed
from audioflinger_hook.transform.design.synthesis import SynthesisDesign
from audioflinger_hook.transform.filters import Roots, low_pass
from device.errors import UsageError

RATE = 8_000
DESIGN = LiveDesign.of(TransformParameters(), RATE)
BLOB = DESIGN.to_bytes()
PARAMETERS = [
    TransformParameters(),
    TransformParameters(loudness_db=20.0, speech_suppression_db=12.0),
    TransformParameters(mapping="jnd", amplitude_mapping="energy", window_s=0.03, partials_max=3),
]


@pytest.mark.parametrize("parameters", PARAMETERS, ids=["default", "followers", "mappings"])
@pytest.mark.parametrize("samplerate", [1_000, 8_000, 44_100, 48_000, 192_000])
def test_a_design_is_read_as_it_was_written(parameters, samplerate):
    design = LiveDesign.of(parameters, samplerate)
    again = LiveDesign.from_bytes(design.to_bytes())
    assert (again, hash(again)) == (design, hash(design))
    for name, value in design.settings().items():
        read = again.settings()[name]
        assert type(read) is type(value) or isinstance(value, type(read)), name
        assert np.shape(read) == np.shape(value), name
    assert (again.to_bytes(), pickle.loads(pickle.dumps(design))) == (design.to_bytes(), design)


def test_designs_of_other_parameters_or_rates_are_others_and_of_whole_numbers_the_same():
    designs = [LiveDesign.of(parameters, RATE) for parameters in PARAMETERS]
    designs.append(LiveDesign.of(PARAMETERS[0], 2 * RATE))
    designs.append(LiveDesign.of(PARAMETERS[0], RATE, find_onsets=False))
    assert len(set(designs)) == len(designs)
    assert DESIGN != BLOB
    whole = TransformParameters(band_low_hz=50, loudness_target_db=-18, threshold_hz=1)
    exact = TransformParameters(band_low_hz=50.0, loudness_target_db=-18.0, threshold_hz=1.0)
    design = LiveDesign.of(whole, RATE)
    assert design == LiveDesign.of(exact, RATE) == LiveDesign.from_bytes(design.to_bytes())


def test_a_design_cannot_be_changed_and_every_setting_has_one_name():
    with pytest.raises(FrozenInstanceError):
        DESIGN.samplerate = 1  # type: ignore[misc]
    for name, value in DESIGN.settings().items():
        if isinstance(value, np.ndarray):
            assert not value.flags.writeable, name
    names = [item.name for kind in SECTIONS.values() for item in fields(kind)]
    assert len(names) == len(set(names)) == len(DESIGN.settings())
    assert max(map(len, names)) <= 36


@given(
    at=st.integers(0, len(BLOB) - 1),
    flip=st.integers(1, 255),
    more=st.binary(min_size=1, max_size=64),
)
def test_a_blob_that_is_changed_cut_or_too_long_is_refused(at, flip, more):
    damaged = bytearray(BLOB)
    damaged[at] ^= flip
    for wrong in (bytes(damaged), BLOB[:at], BLOB + more, more):
        with pytest.raises(UsageError, match=r"design"):
            LiveDesign.from_bytes(wrong)


def sealed(data):
    data = bytearray(data)
    struct.pack_into("<I", data, 12, len(data))
    struct.pack_into("<I", data, len(data) - 8, zlib.crc32(bytes(data[:-8])))
    return bytes(data)


def test_a_blob_of_another_version_or_number_of_values_is_refused_with_what_is_wrong():
    other = bytearray(BLOB)
    struct.pack_into("<I", other, 8, 99)
    with pytest.raises(UsageError, match=r"version 99; allowed: 4"):
        LiveDesign.from_bytes(sealed(other))
    values = blob.unpack(BLOB)
    with pytest.raises(UsageError, match=r"lacks hop_s"):
        LiveDesign.from_bytes(blob.pack({k: v for k, v in values.items() if k != "hop_s"}))
    with pytest.raises(UsageError, match=r"unknown values: extra"):
        LiveDesign.from_bytes(blob.pack({**values, "extra": 1}))
    with pytest.raises(UsageError, match=r"ticks, or holds it as something else"):
        LiveDesign.from_bytes(blob.pack({**values, "ticks": 1.5}))


@given(at=st.integers(blob.HEADER.size, len(BLOB) - 9), flip=st.integers(1, 255))
def test_a_damaged_blob_with_a_fitting_checksum_is_refused_or_holds_other_numbers(at, flip):
    damaged = bytearray(BLOB)
    damaged[at] ^= flip
    try:
        design = LiveDesign.from_bytes(sealed(damaged))
    except UsageError:
        return
    assert design != DESIGN


RATES = (1_000, 8_000, 11_025, 44_100, 48_000, 96_000, 768_000)
BUTTERWORTHS = ((1, filters.BUTTERWORTH_1), (2, filters.BUTTERWORTH), (5, filters.BUTTERWORTH_5))


def equal(found, wanted):
    """Equal but for the last bits, which differ between versions of SciPy."""
    for one, other in zip(found, wanted, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-13)


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("share", [0.0004, 0.03, 0.21, 0.48])
def test_filters_are_those_of_scipy(rate, share):
    edge = share * rate
    for kind, made in (("lowpass", filters.low_pass), ("highpass", filters.high_pass)):
        wanted = scipy.signal.ellip(6, 0.5, 40.0, edge, kind, fs=rate, output="zpk")
        equal(made(filters.ELLIPTIC_6, edge, rate), wanted)
        b, a = scipy.signal.zpk2tf(*wanted)
        hz = np.arange(0.0, edge, edge / 50.0)
        _, response = scipy.signal.freqz(b, a, hz, fs=rate)
        np.testing.assert_allclose(filters.response(b, a, hz, rate), response, rtol=1e-13)
        for order, prototype in BUTTERWORTHS:
            sections = round_sections(*made(prototype, edge, rate))
            sos = scipy.signal.butter(order, edge, kind, fs=rate, output="sos")
            _, wanted = scipy.signal.sosfreqz(sos, hz, fs=rate)
            found = filters.response_of_sections(sections, hz, rate)
            # Roots keep 40 bits after the point.
            np.testing.assert_allclose(found, wanted, rtol=0, atol=2e-4 if share < 0.001 else 1e-8)
    edges = (0.5 * edge, edge)
    wanted = scipy.signal.butter(2, edges, "bandpass", fs=rate, output="zpk")
    equal(filters.band_pass(filters.BUTTERWORTH, *edges, rate), wanted)


@pytest.mark.parametrize("count", [264, 1_456, 4_095, 17_829])
def test_low_bins_are_those_of_scipy(count):
    samples = np.random.default_rng(count).normal(size=count)
    for bins, length in ((8_578, 64 * count), (10_114, 128 * count), (50, count)):
        wanted = scipy.signal.zoom_fft(samples, (0, bins), bins, fs=length)
        found = filters.lowest_bins(samples, bins, length)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-15 * np.abs(wanted).max())


def test_lengths_are_those_of_scipy():
    for least in (*range(1, 300), 4_095, 10_007, 153_601):
        assert filters.fast_length(least) == scipy.fft.next_fast_len(least, real=True)
        assert filters.fast_length(least, (2, 3, 5, 7, 11)) == scipy.fft.next_fast_len(least)


EPSILON = np.finfo(float).eps


def test_a_number_keeps_forty_bits_a_table_thirty_two_and_a_rounded_filter_is_the_filter():
    rng = np.random.default_rng(1)
    for number in (*rng.normal(0, 1, 100), 1e-300, 1e300, -0.018):
        rounded = round_number(number)
        assert abs(rounded - number) <= 2.0**-40 * abs(number)
        assert round_number(rounded) == rounded
    for number in (0.0, np.inf, -np.inf, 3.0, -1024.0):
        assert round_number(number) == number
    table = rng.normal(0, 1, (3, 50)) * 10.0 ** rng.uniform(-8, 8, 50)
    coarse = round_table(table)
    assert np.abs(coarse - table).max() <= 2.0**-32 * np.abs(table).max()
    np.testing.assert_array_equal(round_table(coarse), coarse)
    assert round_table(np.zeros(0)).size == 0
    # What is 0 but for rounding becomes 0.
    quarters = np.cos(np.arange(5) * np.pi / 2.0)
    np.testing.assert_array_equal(round_table(quarters), [1.0, 0.0, -1.0, 0.0, 1.0])
    zeros, poles, gain = ellip(6, 0.5, 50.0, 0.2, output="zpk")
    _, wanted = freqz(*ellip(6, 0.5, 50.0, 0.2))
    _, found = freqz(*round_filter(zeros, poles, gain))
    assert np.abs(found - wanted).max() < 1e-9


@pytest.mark.parametrize("samplerate", [8_000, 44_100, 48_000, 192_000])
def test_other_last_bits_of_a_library_give_the_same_design(samplerate, monkeypatch):
    """All cosines, sines, powers and filters of the design are off by a unit in the last place.

    But not within `filters`: a low-pass with poles close to 1 turns that into 1e-6 of its response.
    """
    designs = {name: LiveDesign.of(parameters_of(name), samplerate) for name in PROFILES}

    def off(function):
        def rounded_otherwise(*arguments, **options):
            return function(*arguments, **options) * (1.0 + EPSILON)

        return rounded_otherwise

    def filter_off(*arguments, **options):
        zeros, poles, gain = low_pass(*arguments, **options)
        return Roots(zeros, poles * (1.0 + EPSILON), gain * (1.0 + EPSILON))

    monkeypatch.setattr(filters, "np", SimpleNamespace(**vars(np)))
    for name in ("cos", "sin", "exp", "log", "interp"):
        monkeypatch.setattr(np, name, off(getattr(np, name)))
    monkeypatch.setattr("audioflinger_hook.transform.filters.low_pass", filter_off)
    for name, design in designs.items():
        again = _designed.__wrapped__(parameters_of(name), samplerate, True)
        assert again is not design
        assert again == design


def test_without_rounding_the_last_bits_would_show(monkeypatch):
    design = LiveDesign.of(parameters_of("cinema"), 48_000)
    monkeypatch.setattr(rounding, "TABLE_BITS", 60)
    monkeypatch.setattr(rounding, "TABLE_FLOOR_BITS", 60)
    again = _designed.__wrapped__(parameters_of("cinema"), 48_000, True)
    assert not np.array_equal(again.synthesis.glide, design.synthesis.glide)
    assert isinstance(again.synthesis, SynthesisDesign)
