"""Mapping of principal frequencies of sound to frequencies and amplitudes of vibration.

By default, the mapping `paper`, equation (4), maps every octave of sound to 25 Hz of vibration. For
whole-body vibration, the just noticeable difference (JND) of frequency grows with frequency
(Bellmann, 2002). From 20 to 90 Hz the JND is at least a third of the frequency (Merchel, Altinsoy
and Stamm, Internoise 2011). The mapping `paper` therefore maps the highest octave of sound to a
range of less than one JND. The mapping `jnd` maps every octave of sound to the same ratio of
vibration frequencies, by default 1.34.

r is a peak's amplitude times its half-power bandwidth. A steady tone of amplitude A has r = A R
with R = 1.30 fs/N (fs: samplerate, N: frames of a window). Its vibration has the same amplitude.
"""

from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.parameters import TransformParameters


@dataclass(frozen=True, eq=False)
class VibrationMapping:
    """Mapping of frequency and amplitude for given parameters."""

    band_low_hz: float  # f_m, lowest audio frequency
    bottom_hz: float  # F_b, vibration frequency of f_m
    scale_hz: float  # B_c, Hz of vibration per factor e of audio frequency; 0 for mapping "jnd"
    scale_ratio: float  # exponent c of the mapping "jnd"; 0 for mapping "paper"
    energy_mapping: int  # amplitude mapping: 1 for "energy", 0 for "tonal"
    full_scale_r: float  # R, r of a full-scale tone in Hz

    @classmethod
    def of(cls, parameters: TransformParameters, full_scale_r: float = 1.0) -> "VibrationMapping":
        """Return the mapping for given parameters."""
        equal_jnds = parameters.mapping == "jnd"
        return cls(
            band_low_hz=parameters.band_low_hz,
            bottom_hz=parameters.vibration_bottom_hz,
            scale_hz=0.0 if equal_jnds else parameters.scale_hz,
            scale_ratio=parameters.scale_ratio if equal_jnds else 0.0,
            energy_mapping=int(parameters.amplitude_mapping == "energy"),
            full_scale_r=full_scale_r,
        )

    def vibration_hz(self, audio_hz: FloatArray) -> FloatArray:
        """Return the vibration frequencies s(x), in Hz, of audio frequencies x of any shape.

        `paper`: s(x) = B_c ln(x / f_m) + F_b, by default 130 Hz for 1 kHz. `jnd`: s(x) =
        F_b (x / f_m)^c, by default 77 Hz for 1 kHz. The mappings agree at both ends of the band.
        """
        octaves = np.log(audio_hz / self.band_low_hz)
        if self.scale_ratio:
            return np.asarray(self.bottom_hz * np.exp(self.scale_ratio * octaves))
        return self.scale_hz * octaves + self.bottom_hz

    def audio_hz(self, vibration_hz: float) -> float:
        """Return the audio frequency in Hz that is mapped to a vibration frequency in Hz."""
        if self.scale_ratio:
            octaves = np.log(vibration_hz / self.bottom_hz) / self.scale_ratio
        else:
            octaves = (vibration_hz - self.bottom_hz) / self.scale_hz
        return self.band_low_hz * float(np.exp(octaves))

    def amplitudes(self, amplitude: FloatArray, r: FloatArray) -> FloatArray:
        """Return the vibration amplitudes of one window's principal frequencies, (partials,).

        amplitude: heights A_k of the spectral peaks. r: A_k times half-power bandwidth, Hz.

        `tonal`: P_k r_k / R with P_k = r_k / sum r, equation (6). Sound with many
        principal frequencies thus has weak vibration. `energy`: sqrt(A_k r_k / R). The square of
        this amplitude is proportional to the power of the spectral peak.
        """
        if self.energy_mapping:
            return np.asarray(np.sqrt(amplitude * r / self.full_scale_r))
        return np.asarray(r * r / (r.sum() * self.full_scale_r))


def vibration_hz(audio_hz: FloatArray, parameters: TransformParameters) -> FloatArray:
    """Return the vibration frequencies, in Hz, of audio frequencies in Hz."""
    return VibrationMapping.of(parameters).vibration_hz(audio_hz)
