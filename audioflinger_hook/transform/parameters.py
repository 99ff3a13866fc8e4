"""The transform's parameters: their defaults, their ranges and what follows from them.

Symbols in parentheses are the paper's: T, f_m, f_h, C_th, n, F_b, B_c.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

from scipy.fft import next_fast_len

from device.errors import UsageError

SAMPLERATE_MIN_HZ = 1_000
SAMPLERATE_MAX_HZ = 768_000
CHANNELS_MAX = 64

HALF_POWER_WIDTH_BINS = 1.30
"""Half-power width of a Hamming window in units of 1/T; a steady tone's r is A times this."""


@dataclass(frozen=True)
class Limits:
    """The closed range that a parameter may lie in, with its unit and meaning for messages."""

    low: float
    high: float
    unit: str
    meaning: str

    def __str__(self) -> str:
        return f"{self.low:g} to {self.high:g} {self.unit}".rstrip()


@dataclass(frozen=True)
class Choice:
    """The words that a parameter may be, the default first, with its meaning for messages."""

    values: tuple[str, ...]
    meaning: str

    def __str__(self) -> str:
        return ", ".join(self.values)


@dataclass(frozen=True)
class Problem:
    """What is wrong with one parameter, and what is allowed instead."""

    wrong: str
    allowed: str


LIMITS: dict[str, Limits] = {
    "window_s": Limits(0.01, 0.2, "s", "length of one unit sequence (T)"),
    "band_low_hz": Limits(20.0, 1_000.0, "Hz", "lowest audio frequency (f_m)"),
    "band_high_hz": Limits(200.0, 20_000.0, "Hz", "highest audio frequency (f_h)"),
    "vibration_top_hz": Limits(60.0, 400.0, "Hz", "vibration frequency of the band's top"),
    "threshold_hz": Limits(0.001, 1_000.0, "Hz", "amplitude x bandwidth to be principal (C_th)"),
    "partials_max": Limits(1, 64, "", "principal frequencies kept a unit (n)"),
    "loudness_db": Limits(0.0, 40.0, "dB", "most that loudness lifts vibration; 0: not followed"),
    "loudness_target_db": Limits(-40.0, 0.0, "dB", "vibration at the programme's level"),
    "loudness_slope_db": Limits(1.0, 20.0, "dB", "of vibration for 20 phon of loudness"),
    "loudness_floor_db": Limits(-90.0, -30.0, "dB", "loudness up to which nothing is felt"),
    "loudness_gate_db": Limits(1.0, 30.0, "dB", "from there to where all is felt"),
    "speech_suppression_db": Limits(0.0, 24.0, "dB", "by how much speech is lowered, live form"),
}

CHOICES: dict[str, Choice] = {
    "level_law": Choice(("tonal", "energy"), "how strong each principal frequency vibrates"),
    "mapping": Choice(("paper", "jnd"), "where in the vibration's range each of them is felt"),
}


@dataclass(frozen=True)
class TransformParameters:
    """Everything that shapes the vibration; the defaults are the paper's.

    window_s: seconds; band_low_hz, band_high_hz, vibration_top_hz: Hz; threshold_hz: full-scale
    amplitude times Hz; partials_max: a count; speech_suppression_db: dB, 0 for off, in the live
    form alone. Ranges stand in `LIMITS`.

    loudness_db: how far the live form's loudness follower (`follower.py`) lifts vibration; 0 turns
    it off, and the next four mean nothing. loudness_target_db: vibration, loudness_slope_db: more
    of it for 20 phon, loudness_floor_db: loudness, loudness_gate_db: more of it. A full-scale tone,
    for loudness of 1 kHz, is at 0 dB.

    level_law: `tonal`, the paper's r^2 / sum r, or `energy`, see `levels.law_amplitudes`; mapping:
    `paper`, equation (4), or `jnd`, see `scaling.vibration_hz`. The words stand in `CHOICES`.

    Raises
    ------
    UsageError
        Names every parameter that is out of range or contradicts another, all at once.
    """

    window_s: float = 0.04643
    band_low_hz: float = 50.0
    band_high_hz: float = 12_000.0
    vibration_top_hz: float = 220.0
    threshold_hz: float = 0.3
    partials_max: int = 16
    loudness_db: float = 0.0
    loudness_target_db: float = -18.0
    loudness_slope_db: float = 5.5
    loudness_floor_db: float = -60.0
    loudness_gate_db: float = 10.0
    speech_suppression_db: float = 0.0
    level_law: str = "tonal"
    mapping: str = "paper"

    def __post_init__(self) -> None:
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        problems = [
            f"{name}={_text(values[name])} {problem.wrong}; allowed: {problem.allowed}"
            for name, problem in self.problems(values).items()
        ]
        if problems:
            raise UsageError("; ".join(problems))

    @classmethod
    def problems(cls, values: dict[str, Any]) -> dict[str, Problem]:
        """Return what is wrong with a set of values, by parameter; absent ones are the defaults.

        Unknown names are the caller's to report. An empty dict means that the set is usable.
        """
        found: dict[str, Problem] = {}
        complete: dict[str, float] = {}
        for field in fields(cls):
            value = values.get(field.name, field.default)
            if choice := CHOICES.get(field.name):
                if not isinstance(value, str) or value not in choice.values:
                    found[field.name] = Problem("is not known", str(choice))
                continue
            limits = LIMITS[field.name]
            whole = field.name == "partials_max"
            if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)):
                kind = "a whole number" if whole else "a number"
                found[field.name] = Problem(f"is not {kind}", str(limits))
            elif not limits.low <= value <= limits.high:
                found[field.name] = Problem("is out of range", str(limits))
            else:
                complete[field.name] = value
        low, high = complete.get("band_low_hz"), complete.get("band_high_hz")
        if low is not None and high is not None and high < 2 * low:
            found["band_high_hz"] = Problem(
                f"is under twice band_low_hz={low:g}", f"at least {2 * low:g} Hz"
            )
        window_s, top = complete.get("window_s"), complete.get("vibration_top_hz")
        if window_s is not None and top is not None and top < 2 / window_s:
            found["vibration_top_hz"] = Problem(
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
        """B_c: vibration Hz for each factor e of audio frequency, from s(f_h) = the top."""
        span = math.log(self.band_high_hz / self.band_low_hz)
        return (self.vibration_top_hz - self.vibration_bottom_hz) / span

    @property
    def scale_ratio(self) -> float:
        """The factor e of vibration frequency for each of audio frequency, with equal JNDs."""
        span = math.log(self.band_high_hz / self.band_low_hz)
        return math.log(self.vibration_top_hz / self.vibration_bottom_hz) / span

    @property
    def heard_threshold_hz(self) -> float:
        """C_th of the live form: lower with the follower, by what that lifts. Its gate is soft."""
        lowered = self.threshold_hz * math.pow(10.0, -self.loudness_db / 20.0)
        return max(lowered, LIMITS["threshold_hz"].low)

    def window_frames(self, samplerate: int) -> int:
        """N = round(T fs): frames in one unit sequence."""
        return round(self.window_s * samplerate)

    def fft_length(self, samplerate: int) -> int:
        """The zero-padded spectrum's length: the first fast one from 2 N up."""
        return int(next_fast_len(2 * self.window_frames(samplerate), real=True))

    def unit_strength_hz(self, samplerate: int) -> float:
        """r of a steady full-scale tone, 1.30 fs/N: the divisor that brings it to full scale."""
        return HALF_POWER_WIDTH_BINS * samplerate / self.window_frames(samplerate)


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else repr(value)


def check_format(samplerate: int, channels: int) -> None:
    """Raise UsageError where a stream's rate or channel count is outside what is supported."""
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
