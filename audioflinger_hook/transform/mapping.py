"""From audio to vibration: the frequency and the amplitude of each principal frequency.

Equation (4) gives every octave of sound the same span in Hz, 25 Hz with the defaults. What can be
told apart grows with the frequency itself: the just noticeable difference of whole-body vibration
rises linearly from 5 to 40 Hz (Bellmann, 2002), and over 20 to 90 Hz it is a third of the
frequency and more (Merchel, Altinsoy and Stamm, Internoise 2011). Under equation (4) the highest
octave of sound is felt over less than one JND. `jnd` gives every octave of sound the same ratio
instead, 1.34 with the defaults.

A steady tone of amplitude A has r = A R, where R = 1.30 fs/N is the r of a full-scale one. Both
amplitude mappings give it A. They differ for everything that is more than one tone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.parameters import TransformParameters


@dataclass(frozen=True, eq=False)
class VibrationMapping:
    """The mapping of frequency and amplitude for one set of parameters."""

    band_low_hz: float  # f_m: the lowest frequency of audio
    bottom_hz: float  # F_b: the vibration frequency of f_m
    scale_hz: float  # B_c: Hz of vibration per factor e of audio frequency; 0 for mapping "jnd"
    scale_ratio: float  # for "jnd", the power of audio frequency that vibration follows; else 0
    energy_mapping: int  # amplitude mapping: 1 for "energy", 0 for "tonal"
    full_scale_r: float  # R: r of a full-scale tone, in Hz

    @classmethod
    def of(cls, parameters: TransformParameters, full_scale_r: float = 1.0) -> VibrationMapping:
        """Return the mapping for these parameters."""
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
        """Return the vibration frequencies s(x) in Hz, of any shape.

        `paper`: s(x) = B_c ln(x / f_m) + F_b; `jnd`: s(x) = F_b (x / f_m)^c, with c such that the
        band's ends are the same. By default, 1 kHz becomes 130 Hz by the first, 77 by the second.
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
        """Return the amplitudes of one window's principal frequencies, (partials,), not limited.

        amplitude: their heights A; r: A times half-power bandwidth df, Hz.

        `tonal`: P_k r_k / R with P_k = r_k / sum r, equation (6): a sound of many is weak.
        `energy`: sqrt(A_k r_k / R), so that the power a_k^2 is what a spectral peak of that height
        and width holds. A full-scale sample, whose spectrum is flat, comes out 25 dB weaker.
        """
        if self.energy_mapping:
            return np.asarray(np.sqrt(amplitude * r / self.full_scale_r))
        return np.asarray(r * r / (r.sum() * self.full_scale_r))


def vibration_hz(audio_hz: FloatArray, parameters: TransformParameters) -> FloatArray:
    """Return the vibration frequencies s(x) in Hz, of any shape, for audio frequencies in Hz."""
    return VibrationMapping.of(parameters).vibration_hz(audio_hz)
