"""The input stage: replacement of invalid samples, and the band-pass before the analysis."""

import numpy as np
import scipy

from audioflinger_hook.transform.arrays import FloatArray, Frames
from audioflinger_hook.transform.filters import BUTTERWORTH, Roots, band_pass, high_pass
from audioflinger_hook.transform.parameters import TransformParameters
from device.errors import UsageError

SAMPLES = (np.dtype(np.float32), np.dtype(np.float64))  # in native byte order
MAGNITUDE_MAX = 1e3  # larger samples (60 dB above full scale) are invalid, like NaN and Inf
DENORMAL_GUARD = 1e-25  # added to every sample to avoid slow subnormal numbers in filters
NYQUIST_MARGIN = 0.49  # highest edge of the band-pass, as a share of the samplerate


def fit_block(frames: Frames, channels: int) -> Frames:
    """Return a block as an aligned array (frames, channels) of float32 or float64.

    frames: (frames, channels), or (frames,) for one channel, of any floating-point type.
    UsageError: `frames` has the wrong type or shape.
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
    """Return frames of any shape with invalid samples set to 0, and the number of these samples.

    A sample is invalid if it is not finite, or beyond +-`MAGNITUDE_MAX`.
    """
    flat = frames.reshape(-1)
    # This fast test accepts most blocks. No sample exceeds the root of the sum of squares, and a
    # non-finite sample makes the sum non-finite. Unlike dot, vdot does not warn.
    if np.vdot(flat, flat) <= MAGNITUDE_MAX**2:
        return frames, 0
    usable = np.abs(frames) <= MAGNITUDE_MAX
    if usable.all():
        return frames, 0
    return np.where(usable, frames, frames.dtype.type(0)), int(usable.size - usable.sum())


def channel_rows(usable: Frames) -> FloatArray:
    """Return samples, (frames, channels), as contiguous float64, (channels, frames)."""
    return np.asarray(usable.T, np.float64, order="C")


def band_pass_roots(parameters: TransformParameters, samplerate: int) -> Roots:
    """Return a Butterworth band-pass, or a high-pass if `band_high_hz` needs a higher samplerate.

    Each edge has order 2. UsageError: `band_low_hz` is too high for the samplerate.
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
    """Return the coefficients (b, a) of `band_pass_roots`, with the same UsageError."""
    b, a = scipy.signal.zpk2tf(*band_pass_roots(parameters, samplerate))
    return b, a


class BandPass:
    """Band-pass of a stream, in blocks of any size. b, a: from `design_band_pass`."""

    def __init__(self, b: FloatArray, a: FloatArray, guard: float = DENORMAL_GUARD) -> None:
        self._b, self._a, self._guard = b, a, guard
        self.reset()

    def reset(self) -> None:
        """Start a new stream."""
        self._state = np.zeros(self._a.size - 1)

    def process(self, mono: FloatArray) -> FloatArray:
        """Return the filtered samples, (frames,)."""
        if not mono.size:
            return mono
        filtered, self._state = scipy.signal.lfilter(
            self._b, self._a, mono + self._guard, zi=self._state
        )
        return np.asarray(filtered)
