"""The transform's parameters: their defaults, their ranges and what follows from them.

Symbols in parentheses are the paper's: T, f_m, f_h, C_th, n, F_b, B_c.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from audioflinger_hook.transform.filters import fast_length
from device.errors import UsageError
from device.layouts import CHANNELS_MAX
from device.values import Choice, Described, Number, Refusal

SAMPLERATE_MIN_HZ = 1_000
SAMPLERATE_MAX_HZ = 768_000
THRESHOLD_MIN_HZ = 0.001


@dataclass(frozen=True)
class TransformParameters(Described):
    """All parameters that shape the vibration; the defaults are the paper's.

    The fields `loudness_*` and `speech_suppression_db` act only in the live form. If `loudness_db`
    is 0, the other four loudness fields, `dynamics`, `rise_db` and `jitter_db` have no effect. For
    all levels, 0 dB is a full-scale tone; for loudness, a full-scale tone of 1 kHz.

    Raises
    ------
    UsageError
        Parameters are out of range or contradict each other; the message names all of them.
    """

    window_s: Annotated[float, Number("length of the analysis window (T)", 0.01, 0.2, "s")] = (
        0.04643
    )
    band_low_hz: Annotated[float, Number("lowest audio frequency (f_m)", 20.0, 1_000.0, "Hz")] = (
        50.0
    )
    band_high_hz: Annotated[
        float, Number("highest audio frequency (f_h)", 200.0, 20_000.0, "Hz")
    ] = 12_000.0
    vibration_top_hz: Annotated[
        float, Number("vibration frequency of the highest audio frequency", 60.0, 400.0, "Hz")
    ] = 220.0
    threshold_hz: Annotated[
        float,
        Number(
            "least amplitude times bandwidth of a principal frequency (C_th)",
            THRESHOLD_MIN_HZ,
            1_000.0,
            "Hz",
        ),
    ] = 0.3
    partials_max: Annotated[
        int, Number("most principal frequencies at one time (n)", 1, 64, whole=True)
    ] = 16
    loudness_db: Annotated[
        float, Number("largest gain for soft sound; 0: loudness is not followed", 0, 60, "dB")
    ] = 0.0
    loudness_target_db: Annotated[
        float, Number("level of the vibration at usual loudness", -40.0, 0.0, "dB")
    ] = -18.0
    dynamics: Annotated[
        float, Number("change of the vibration for each phon of loudness", 0.1, 1.0, "dB")
    ] = 0.275
    loudness_floor_db: Annotated[
        float, Number("loudness below which there is no vibration", -90.0, -30.0, "dB")
    ] = -60.0
    loudness_gate_db: Annotated[
        float, Number("range above the floor in which vibration fades in", 1.0, 30.0, "dB")
    ] = 10.0
    rise_db: Annotated[
        float,
        Number("most that vibration gains where one band of sound rises; 0: off", 0.0, 12.0, "dB"),
    ] = 6.0
    jitter_db: Annotated[
        float, Number("changes of loudness up to this are averaged", 0.0, 6.0, "dB")
    ] = 2.5
    speech_suppression_db: Annotated[
        float, Number("reduction of speech (live form only); 0: off", 0.0, 24.0, "dB")
    ] = 0.0
    amplitude_mapping: Annotated[
        str,
        Choice(
            "amplitudes as in the paper, which favours tones (tonal), or noise as strong as a tone "
            "of the same energy (energy)",
            ("tonal", "energy"),
        ),
    ] = "tonal"
    strength: Annotated[
        str,
        Choice(
            "measure of strength: full scale (flat), sensitivity of a seated body (felt), or that "
            "with the rig's resonance levelled (rig)",
            ("flat", "felt", "rig"),
        ),
    ] = "flat"
    resonance_hz: Annotated[
        float, Number("resonance that strength = rig levels; 0: that of the rig", 0.0, 400.0, "Hz")
    ] = 0.0
    resonance_q: Annotated[float, Number("Q of resonance_hz", 0.1, 20.0)] = 1.0
    resonance_gain_db: Annotated[
        float, Number("gain of the drive before resonance_hz, by damping", 0.0, 40.0, "dB")
    ] = 0.0
    merge_ratio: Annotated[
        float,
        Number("partials closer than this share of their frequency are one; 0: off", 0.0, 1.0),
    ] = 0.0
    mapping: Annotated[
        str,
        Choice(
            "vibration frequency by the paper's equation (4) (paper), or the same ratio for every "
            "octave (jnd)",
            ("paper", "jnd"),
        ),
    ] = "paper"

    @classmethod
    def contradictions(cls, values: Mapping[str, Any]) -> dict[str, Refusal]:
        """Return the frequency limits that are too close to each other."""
        found: dict[str, Refusal] = {}
        low, high = values.get("band_low_hz"), values.get("band_high_hz")
        if low is not None and high is not None and high < 2 * low:
            found["band_high_hz"] = Refusal(
                f"is under twice band_low_hz={low:g}", f"at least {2 * low:g} Hz"
            )
        window_s, top = values.get("window_s"), values.get("vibration_top_hz")
        if window_s is not None and top is not None and top < 2 / window_s:
            found["vibration_top_hz"] = Refusal(
                f"leaves no room above 1/window_s={1 / window_s:.1f} Hz",
                f"at least {2 / window_s:.1f} Hz at this window_s",
            )
        return found

    @property
    def vibration_bottom_hz(self) -> float:
        """F_b = 1/T: the lowest vibration that has a whole cycle in one unit sequence, in Hz."""
        return 1.0 / self.window_s

    @property
    def scale_hz(self) -> float:
        """B_c: vibration Hz per factor e of audio frequency; s(f_h) is `vibration_top_hz`."""
        span = math.log(self.band_high_hz / self.band_low_hz)
        return (self.vibration_top_hz - self.vibration_bottom_hz) / span

    @property
    def scale_ratio(self) -> float:
        """Factors e of vibration frequency per factor e of audio frequency, for mapping "jnd"."""
        span = math.log(self.band_high_hz / self.band_low_hz)
        return math.log(self.vibration_top_hz / self.vibration_bottom_hz) / span

    @property
    def live_threshold_hz(self) -> float:
        """C_th of the live form: lower by `loudness_db`, the most that loudness may add."""
        lowered = self.threshold_hz * math.pow(10.0, -self.loudness_db / 20.0)
        return max(lowered, THRESHOLD_MIN_HZ)

    def window_frames(self, samplerate: int) -> int:
        """N = round(T fs): frames in one unit sequence."""
        return round(self.window_s * samplerate)

    def fft_length(self, samplerate: int) -> int:
        """Length of the zero-padded FFT: the smallest fast length of at least 2 N."""
        return fast_length(2 * self.window_frames(samplerate))

    def unit_strength_hz(self, samplerate: int) -> float:
        """r of a steady full-scale tone, 1.30 fs/N: the half-power width of a Hamming window."""
        return 1.30 * samplerate / self.window_frames(samplerate)


def check_format(samplerate: int, channels: int) -> None:
    """Raise UsageError if a stream's rate or channel count is not supported."""
    problems = []
    if not SAMPLERATE_MIN_HZ <= samplerate <= SAMPLERATE_MAX_HZ:
        problems.append(
            f"samplerate={samplerate} Hz is out of range; "
            f"allowed: {SAMPLERATE_MIN_HZ} to {SAMPLERATE_MAX_HZ} Hz; resample the sound first"
        )
    if not 1 <= channels <= CHANNELS_MAX:
        problems.append(
            f"channels={channels} is out of range; allowed: 1 to {CHANNELS_MAX}; "
            "mix some of them down first"
        )
    if problems:
        raise UsageError("; ".join(problems))
