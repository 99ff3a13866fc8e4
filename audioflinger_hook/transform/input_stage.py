"""The input stage: replaces unusable samples, and band-passes for the analysis."""

from __future__ import annotations

import numpy as np
import scipy

from audioflinger_hook.transform.arrays import FloatArray, Frames
from audioflinger_hook.transform.filters import BUTTERWORTH, Roots, band_pass, high_pass
from audioflinger_hook.transform.parameters import TransformParameters
from device.errors import UsageError

SAMPLES = (np.dtype(np.float32), np.dtype(np.float64))  # in the machine's own byte order
# Samples above this (60 dB over full scale) count as damaged, like NaN and Inf.
MAGNITUDE_MAX = 1e3

DENORMAL_GUARD = 1e-25
"""Added to every sample, so that filters do not decay into denormal numbers in a long silence.
Arithmetic with those is many times slower. It is too small to change any result."""

NYQUIST_MARGIN = 0.49
"""A band edge from this fraction of the samplerate up cannot be filtered; the low edge alone is."""


def fit_block(frames: Frames, channels: int) -> Frames:
    """Return a block as (frames, channels) of one of `SAMPLES`, aligned in memory.

    frames: (frames, channels) or, of one channel, (frames,); of any floating-point type.
    UsageError: the block has another type or shape.
    """
    frames = np.asarray(frames)
    if frames.dtype.kind != "f":
        raise UsageError(
            f"a block of {frames.dtype} is not sound in full scale; allowed: float32, float64; "
            "divide integers by their own full scale first"
        )
    if frames.ndim == 1:
        frames = frames[:, None]
    if frames.ndim != 2 or frames.shape[1] != channels:
        raise UsageError(
            f"a block of shape {frames.shape} does not fit this stream; "
            f"allowed: (frames, {channels})"
        )
    if frames.dtype in SAMPLES:
        return frames if frames.flags.aligned else frames.copy()
    return frames.astype(np.float64)


def replace_unusable(frames: Frames) -> tuple[Frames, int]:
    """Return the frames with unusable samples set to 0, and the number of these samples.

    Unusable samples are not finite, or above `MAGNITUDE_MAX`. Usable sound is not copied. Any
    shape. Called on the audio thread.
    """
    flat = frames.reshape(-1)
    # One product proves most blocks usable: no sample exceeds the root of the sum of squares,
    # and one that is not finite makes the sum so. (vdot, unlike dot, does not warn of that.)
    if np.vdot(flat, flat) <= MAGNITUDE_MAX**2:
        return frames, 0
    usable = np.abs(frames) <= MAGNITUDE_MAX
    if usable.all():
        return frames, 0
    return np.where(usable, frames, frames.dtype.type(0)), int(usable.size - usable.sum())


def channel_rows(usable: Frames) -> FloatArray:
    """Return samples (frames, channels) as (channels, frames) float64, contiguous."""
    return np.asarray(usable.T, np.float64, order="C")


def band_pass_roots(parameters: TransformParameters, samplerate: int) -> Roots:
    """Return a second-order Butterworth band-pass.

    UsageError: the whole band lies above what the samplerate in Hz can hold.
    """
    low, high = parameters.band_low_hz, parameters.band_high_hz
    if low >= NYQUIST_MARGIN * samplerate:
        raise UsageError(
            f"band_low_hz={low:g} cannot be filtered at samplerate={samplerate} Hz; "
            f"allowed: under {NYQUIST_MARGIN * samplerate:g} Hz"
        )
    if high >= NYQUIST_MARGIN * samplerate:
        return high_pass(BUTTERWORTH, low, samplerate)
    return band_pass(BUTTERWORTH, low, high, samplerate)


def design_band_pass(
    parameters: TransformParameters, samplerate: int
) -> tuple[FloatArray, FloatArray]:
    """Return b and a of `band_pass_roots`; raise as it does."""
    b, a = scipy.signal.zpk2tf(*band_pass_roots(parameters, samplerate))
    return b, a


class BandPass:
    """The band-passed stream, continued from block to block; any split gives the same bytes.

    b, a: of `design_band_pass`. One direct-form recursion costs a quarter of second-order
    sections. Its rounding stays under 1e-10 of full scale up to 96 kHz (2e-9 at 192 kHz, 1e-6 at
    768 kHz).
    """

    def __init__(self, b: FloatArray, a: FloatArray, guard: float = DENORMAL_GUARD) -> None:
        self._b, self._a, self._guard = b, a, guard
        self.reset()

    def reset(self) -> None:
        """Return to the zero state of a new stream."""
        self._state = np.zeros(self._a.size - 1)

    def process(self, mono: FloatArray) -> FloatArray:
        """Return the filtered block, (frames,) float64. Called on the audio thread."""
        if not mono.size:
            return mono
        filtered, self._state = scipy.signal.lfilter(
            self._b, self._a, mono + self._guard, zi=self._state
        )
        return np.asarray(filtered)
