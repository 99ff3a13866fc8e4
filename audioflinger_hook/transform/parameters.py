"""The transform's parameters and derived quantities. The paper's symbols are in parentheses."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from audioflinger_hook.transform.filters import fast_length
from device.errors import UsageError
from device.layouts import CHANNELS_MAX
from device.values import Choice, Described, Number, Refusal, Text

SAMPLERATE_MIN_HZ = 1_000
SAMPLERATE_MAX_HZ = 768_000
THRESHOLD_MIN_HZ = 0.001
_POINT = r"[1-9]\d{0,3}(\.\d+)?:-?\d{1,2}(\.\d+)?(e-\d+)?"
CURVE = re.compile(f"{_POINT}(,{_POINT})*")  # sensitivity by frequency, HZ:DB,...


@dataclass(frozen=True)
class TransformParameters(Described):
    """Parameters of the transform. The defaults are the paper's values.

    The reference form uses only `amplitude_mapping`, `mapping` and the first six fields (`window_s`
    to `partials_max`). If `loudness_db` is 0, six fields have no effect: `loudness_target_db`,
    `loudness_floor_db`, `loudness_gate_db`, `dynamics`, `rise_db` and `jitter_db`.
    A full-scale tone has a level of 0 dB. A full-scale tone of 1 kHz has a loudness of 0 dB.

    Raises
    ------
    UsageError
        Parameters are out of range or contradict each other; the message names these parameters.
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
            "product of amplitude and bandwidth that a principal frequency exceeds (C_th)",
            THRESHOLD_MIN_HZ,
            1_000.0,
            "Hz",
        ),
    ] = 0.3
    partials_max: Annotated[
        int, Number("largest number of principal frequencies at one time (n)", 1, 64, whole=True)
    ] = 16
    loudness_db: Annotated[
        float,
        Number(
            "largest gain of loudness control for soft sound; 0: loudness control is off",
            0,
            60,
            "dB",
        ),
    ] = 0.0
    loudness_target_db: Annotated[
        float,
        Number(
            "level of the vibration for sound of usual loudness; 0 dB: full scale", -40.0, 0.0, "dB"
        ),
    ] = -18.0
    dynamics: Annotated[
        float, Number("change of the vibration's level for each phon of loudness", 0.1, 1.0, "dB")
    ] = 0.275
    loudness_floor_db: Annotated[
        float,
        Number(
            "lowest loudness of sound that causes vibration; 0 dB: full-scale tone of 1 kHz",
            -90.0,
            -30.0,
            "dB",
        ),
    ] = -60.0
    loudness_gate_db: Annotated[
        float,
        Number(
            "range of loudness above the noise floor in which the vibration fades in",
            1.0,
            30.0,
            "dB",
        ),
    ] = 10.0
    rise_db: Annotated[
        float,
        Number(
            "largest extra gain while some frequencies of the sound become louder; 0: off",
            0.0,
            12.0,
            "dB",
        ),
    ] = 6.0
    jitter_db: Annotated[
        float,
        Number("changes of loudness that are smaller than this value are averaged", 0.0, 6.0, "dB"),
    ] = 2.5
    speech_suppression_db: Annotated[
        float,
        Number("attenuation of the vibration of speech (live form only); 0: off", 0.0, 24.0, "dB"),
    ] = 0.0
    amplitude_mapping: Annotated[
        str,
        Choice(
            "amplitudes by the paper's equation (6), which favours tones (tonal), or by energy, so "
            "that noise is as strong as a tone of equal energy (energy)",
            ("tonal", "energy"),
        ),
    ] = "tonal"
    strength: Annotated[
        str,
        Choice(
            "weight of amplitudes in the strength: 1 (flat), the sensitivity of a seated body "
            "(felt), the sensitivity that `cushion fit` has measured (fit), or that of a seated "
            "body times the rig's response (rig)",
            ("flat", "felt", "fit", "rig"),
        ),
    ] = "flat"
    fit: Annotated[
        str,
        Text("fit that strength = fit uses; default: the device's", "the name of a fit", least=0),
    ] = ""
    resonance_hz: Annotated[
        float,
        Number(
            "resonance frequency that strength = rig compensates; 0: that of the rig",
            0.0,
            400.0,
            "Hz",
        ),
    ] = 0.0
    resonance_q: Annotated[float, Number("Q of the resonance at resonance_hz", 0.1, 20.0)] = 1.0
    resonance_gain_db: Annotated[
        float, Number("gain that damping adds to the drive", 0.0, 40.0, "dB")
    ] = 0.0
    merge_ratio: Annotated[
        float,
        Number("partials closer than this share of their frequency are merged; 0: off", 0.0, 1.0),
    ] = 0.0
    mapping: Annotated[
        str,
        Choice(
            "how vibration frequencies follow from those of the sound: by the paper's equation 4 "
            "(paper), or by the same ratio for every octave of the sound (jnd)",
            ("paper", "jnd"),
        ),
    ] = "paper"

    @classmethod
    def contradictions(cls, values: Mapping[str, Any]) -> dict[str, Refusal]:
        """Return, by field name, why frequency limits are too close, and why `fit` is no curve."""
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
        if values.get("strength") == "fit" and not CURVE.fullmatch(values.get("fit", "")):
            found["fit"] = Refusal("is not a curve", "sensitivity in dB, as HZ:DB,...")
        return found

    @property
    def vibration_bottom_hz(self) -> float:
        """F_b = 1/T, the lowest vibration frequency in Hz."""
        return 1.0 / self.window_s

    @property
    def scale_hz(self) -> float:
        """B_c of the mapping "paper": rise of vibration in Hz per factor e of audio frequency."""
        span = math.log(self.band_high_hz / self.band_low_hz)
        return (self.vibration_top_hz - self.vibration_bottom_hz) / span

    @property
    def scale_ratio(self) -> float:
        """Exponent c of the audio frequency in the mapping "jnd"."""
        span = math.log(self.band_high_hz / self.band_low_hz)
        return math.log(self.vibration_top_hz / self.vibration_bottom_hz) / span

    @property
    def live_threshold_hz(self) -> float:
        """C_th of the live form: `threshold_hz` lowered by `loudness_db`, but at least 0.001 Hz."""
        return max(self.threshold_hz * math.pow(10.0, -self.loudness_db / 20.0), THRESHOLD_MIN_HZ)

    def window_frames(self, samplerate: int) -> int:
        """Return N = round(T fs), the number of frames in an analysis window."""
        return round(self.window_s * samplerate)

    def fft_length(self, samplerate: int) -> int:
        """Return the length of the zero-padded FFT: 2 N or more, with only the factors 2, 3, 5."""
        return fast_length(2 * self.window_frames(samplerate))

    def unit_strength_hz(self, samplerate: int) -> float:
        """Return amplitude times half-power bandwidth of a full-scale tone: 1.30 fs/N, in Hz."""
        return 1.30 * samplerate / self.window_frames(samplerate)


def check_format(samplerate: int, channels: int) -> None:
    """Raise UsageError if the samplerate (Hz) or the number of channels is not supported."""
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
