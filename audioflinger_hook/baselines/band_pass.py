"""The traditional method: the frequencies of the sound from 50 to 250 Hz, unchanged."""

from __future__ import annotations

from scipy.signal import butter

from audioflinger_hook.baselines.stages import Baseline, Filter
from audioflinger_hook.transform import FloatArray

BAND_HZ = (50.0, 250.0)


class Method(Baseline):
    """A fourth-order Butterworth band-pass (second order at each edge) on the mono mix."""

    def __init__(self, samplerate: int, channels: int) -> None:
        super().__init__(samplerate, channels)
        self._filter = Filter(butter(2, BAND_HZ, "bandpass", fs=samplerate, output="sos"))

    def vibration(self, sound: FloatArray) -> FloatArray:
        """Return the band-passed sound."""
        return self._filter(sound)
