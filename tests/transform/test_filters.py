"""Filters and spectra of designs are SciPy's."""

import numpy as np
import pytest
import scipy.fft
import scipy.signal

from audioflinger_hook.transform import filters

RATES = (1_000, 8_000, 11_025, 44_100, 48_000, 96_000, 768_000)
ELLIPTIC = (((6, 0.5, 40.0), filters.ELLIPTIC_6), ((3, 0.5, 26.0), filters.ELLIPTIC_3))


def equal(found, wanted):
    """Equal but for the last bits, which differ between versions of SciPy."""
    for one, other in zip(found, wanted, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-13)


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("share", [0.0004, 0.03, 0.21, 0.48])
def test_filters_are_those_of_scipy(rate, share):
    edge = share * rate
    for order, prototype in ELLIPTIC:
        for kind, made in (("lowpass", filters.low_pass), ("highpass", filters.high_pass)):
            wanted = scipy.signal.ellip(*order, edge, kind, fs=rate, output="zpk")
            equal(made(prototype, edge, rate), wanted)
            b, a = scipy.signal.zpk2tf(*wanted)
            hz = np.arange(0.0, edge, edge / 50.0)
            _, response = scipy.signal.freqz(b, a, hz, fs=rate)
            np.testing.assert_allclose(filters.response(b, a, hz, rate), response, rtol=1e-13)
    edges = (0.5 * edge, edge)
    wanted = scipy.signal.butter(2, edges, "bandpass", fs=rate, output="zpk")
    equal(filters.band_pass(filters.BUTTERWORTH, *edges, rate), wanted)
    wanted = scipy.signal.butter(2, edge, "highpass", fs=rate, output="zpk")
    equal(filters.high_pass(filters.BUTTERWORTH, edge, rate), wanted)


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
        wide = filters.fast_length(least, (2, 3, 5, 7, 11))
        assert wide == scipy.fft.next_fast_len(least)
