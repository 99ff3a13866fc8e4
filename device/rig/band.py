"""The band of a stage: a high-pass and a low-pass, each of second order, without a ripple."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt, sosfreqz

from device.units import FloatArray

_OUT_OF_REACH = 0.45
"""A low-pass from this share of the sample rate on leaves all that can be there as it is."""


class Band:
    """Butterworth filters of second order at one sample rate, Hz. One thread calls `passed`.

    low_cut_hz, high_cut_hz: the corners, -3 dB; 0 and infinity leave an end open. A corner that
    the sample rate cannot show is left out.
    """

    def __init__(self, low_cut_hz: float, high_cut_hz: float, samplerate: float) -> None:
        self.samplerate = samplerate
        sections: list[NDArray[Any]] = []
        if 0.0 < low_cut_hz < _OUT_OF_REACH * samplerate:
            sections.append(butter(2, low_cut_hz, "high", fs=samplerate, output="sos"))
        if high_cut_hz < _OUT_OF_REACH * samplerate:
            sections.append(butter(2, high_cut_hz, "low", fs=samplerate, output="sos"))
        self._sections = np.concatenate(sections) if sections else np.empty((0, 6))
        self.reset()

    @property
    def sections(self) -> FloatArray:
        """(n, 6): the second-order sections, n 0 to 2; not to be written to."""
        return self._sections

    def reset(self) -> None:
        """Come to rest; the next block may have another number of channels."""
        self._state: FloatArray | None = None

    def passed(self, volts: FloatArray) -> FloatArray:
        """(frames,) or (frames, channels) filtered; the same array where nothing is to be done."""
        if not len(self._sections) or not len(volts):
            return volts
        if self._state is None:
            self._state = np.zeros((len(self._sections), 2, *volts.shape[1:]))
        filtered, self._state = sosfilt(self._sections, volts, axis=0, zi=self._state)
        return np.asarray(filtered)

    def response(self, frequencies_hz: FloatArray) -> NDArray[np.complex128]:
        """What it does to each frequency, Hz, (bins,): for taking it out of a measurement."""
        if not len(self._sections):
            return np.ones(len(frequencies_hz), np.complex128)
        _, found = sosfreqz(self._sections, worN=frequencies_hz, fs=self.samplerate)
        return np.asarray(found, np.complex128)
