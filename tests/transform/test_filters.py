"""Filters and spectra of designs are SciPy's."""

import numpy as np
import pytest
import scipy.fft
import scipy.signal

from audioflinger_hook.core.rounding import round_sections
from audioflinger_hook.transform import filters

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
