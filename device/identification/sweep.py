"""The exponential sine sweep and the times at which its harmonics appear.

The frequency rises exponentially. After deconvolution each order of distortion therefore precedes
the linear response by another time (Farina, AES 108th Convention, 2000).
"""

import math
from dataclasses import dataclass

import numpy as np

from device.errors import UsageError
from device.units import FloatArray


@dataclass(frozen=True)
class Sweep:
    """A sweep between two silences; full scale is 1.0."""

    low_hz: float = 20.0
    high_hz: float = 400.0
    duration_s: float = 5.0  # of the sweep itself
    level: float = 0.1  # amplitude, above 0, up to 1
    lead_s: float = 0.2  # silence before it, which shows the noise
    tail_s: float = 0.8  # silence after it, in which the rig comes to rest
    samplerate: int = 48_000

    def __post_init__(self) -> None:
        checks = {
            f"samplerate={self.samplerate!r} Hz must be 1000 or more": self.samplerate >= 1_000,
            f"low_hz={self.low_hz!r} must be 1 or more": self.low_hz >= 1.0,
            f"high_hz={self.high_hz!r} must be at least twice low_hz and at most 0.4 of the "
            f"sample rate": 2.0 * self.low_hz <= self.high_hz <= 0.4 * self.samplerate,
            f"duration_s={self.duration_s!r} must be 0.5 to 60": 0.5 <= self.duration_s <= 60.0,
            f"level={self.level!r} must be above 0, up to 1": 0.0 < self.level <= 1.0,
            f"lead_s={self.lead_s!r} must be 0.1 to 10": 0.1 <= self.lead_s <= 10.0,
            f"tail_s={self.tail_s!r} must be 0.1 to 10": 0.1 <= self.tail_s <= 10.0,
        }
        if wrong := [words for words, holds in checks.items() if not holds]:
            raise UsageError(f"sweep: {'; '.join(wrong)}; choose another value")

    def wave(self, frames: int, duration_s: float) -> FloatArray:
        """Return a sweep of that duration over the band, (frames,), without fades."""
        rise_s = duration_s / math.log(self.high_hz / self.low_hz)
        time_s = np.arange(frames) / self.samplerate
        return np.asarray(np.sin(math.tau * self.low_hz * rise_s * np.expm1(time_s / rise_s)))

    @property
    def lead_frames(self) -> int:
        """Frames of silence before the sweep."""
        return round(self.lead_s * self.samplerate)

    @property
    def frames(self) -> int:
        """Frames of sweep and silences."""
        return round((self.lead_s + self.duration_s + self.tail_s) * self.samplerate)

    def samples(self) -> FloatArray:
        """Return (frames,) between ±level, faded in over two periods and out over 1 %."""
        sounding = round(self.duration_s * self.samplerate)
        wave = self.wave(sounding, self.duration_s)
        fade_in = min(2.0 / self.low_hz, 0.1 * self.duration_s)
        for frames, part in (
            (round(fade_in * self.samplerate), wave),
            (round(0.01 * self.duration_s * self.samplerate), wave[::-1]),
        ):
            part[:frames] *= 0.5 - 0.5 * np.cos(np.pi * np.arange(frames) / frames)
        whole = np.zeros(self.frames)
        whole[self.lead_frames : self.lead_frames + sounding] = self.level * wave
        return whole

    def harmonic_lead_s(self, order: int) -> float:
        """Return how long a harmonic's response precedes the linear one: 0 for order 1."""
        return self.duration_s / math.log(self.high_hz / self.low_hz) * math.log(order)


MARK_S, GAP_S, REST_S = 0.25, 0.4, 0.2
"""Length of a mark, of the silence after the first one, and after the last one."""


class Excitation:
    """One measurement: a mark, the sweep between its silences, the mark again.

    Two equal marks show the drift between two clocks, because the rig changes both alike.
    """

    def __init__(self, sweep: Sweep) -> None:
        self.sweep, rate = sweep, sweep.samplerate
        self.mark_frames = round(MARK_S * rate)
        self.sweep_start = self.mark_frames + round(GAP_S * rate)  # of its first silence
        self.second_mark = self.sweep_start + sweep.frames
        self.frames = self.second_mark + self.mark_frames + round(REST_S * rate)
        wave = sweep.wave(self.mark_frames, MARK_S)
        wave *= sweep.level * np.hanning(len(wave)) ** 0.25
        self.samples = np.zeros(self.frames)
        self.samples[: len(wave)] = wave
        self.samples[self.sweep_start : self.second_mark] = sweep.samples()
        self.samples[self.second_mark : self.second_mark + len(wave)] = wave
