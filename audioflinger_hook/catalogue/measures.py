"""Measures a vibration: the predicted exposure to it, and its peaks over time."""

from functools import lru_cache
from typing import Any

import numpy as np

from device.drive.exposure import DAY_S, PARTS
from device.rig import rig_by_name
from device.rig.co_energy import energies
from device.rig.equations import FRAME_SPEED, SPEED, VOLTS, Equations
from device.units import Float32Array, FloatArray

HIGHEST_HZ = 1_000.0  # higher frequencies have negligible weight in ISO 2631-1
RESPONSE_HZ = np.arange(0.0, HIGHEST_HZ + 0.25, 0.25)  # frequencies of a rig's response
POINT_S = 0.02
POINTS = 120  # a picture of at least 2.4 s of sound has 120 to 240 points


class VibrationMeter:
    """Measures exposure and peaks of a vibration. Memory is constant."""

    def __init__(self, rig: str) -> None:
        self._rig = rig
        self._energy = 0.0
        self._block: Float32Array = np.zeros((0, 0), np.float32)
        self._peaks: list[float] = []
        self._rate = self._filled = self._point_frames = self._in_point = 0
        self._fold = 1  # intervals of POINT_S in each point of the picture

    def watch(self, vibration: FloatArray | Float32Array, samplerate: int) -> None:
        """Measure the next block, (frames, channels). samplerate: Hz."""
        if not self._rate:
            self._rate = samplerate
            channels = vibration.shape[1]
            self._point_frames = max(1, round(POINT_S * samplerate))
            self._block = np.zeros((POINTS * self._point_frames, channels), np.float32)
        while len(vibration):
            taken = vibration[: len(self._block) - self._filled]
            self._block[self._filled : self._filled + len(taken)] = taken
            self._filled += len(taken)
            vibration = vibration[len(taken) :]
            if self._filled == len(self._block):
                self._take_block()

    def finish(self, power: FloatArray, samplerate: int) -> None:
        """Measure the exposure. power: summed spectra of windows, (frequencies, channels)."""
        # The time integral of the squared weighted acceleration, m²/s³, by Parseval's theorem. BLAS
        # is not used, since its threads would compete with other workers.
        frames = 2 * (len(power) - 1)
        gain = _weighted_gain(self._rig, samplerate, frames)
        squares = (gain[:, None] * power[: len(gain)]).sum(axis=0)
        self._energy = float(squares.max()) * 2.0 / (frames * samplerate)

    def measures(self) -> dict[str, Any]:
        """Return exposure and peaks of all blocks.

        exposure_a8_m_s2: largest daily exposure A(8) of all channels (ISO 2631-1), predicted by the
            rig's linear model, if this sound is played once a day at full volume.
        course: up to 240 peaks over time, in thousandths of full scale.
        course_step_s: duration of the interval of each peak.
        """
        if self._filled:
            self._take_block()
        return {
            "exposure_a8_m_s2": float(np.sqrt(self._energy / DAY_S)),
            "course": [round(1e3 * peak) for peak in self._peaks],
            "course_step_s": self._fold * self._point_frames / max(1, self._rate),
        }

    def _take_block(self) -> None:
        block = self._block[: self._filled]
        self._filled = 0
        starts = np.arange(0, len(block), self._point_frames)
        high, low = (one.reduceat(block, starts, axis=0) for one in (np.maximum, np.minimum))
        for peak in np.maximum(high, -low).max(axis=1).tolist():
            if self._in_point:
                self._peaks[-1] = max(self._peaks[-1], peak)
            else:
                self._peaks.append(peak)
            self._in_point = (self._in_point + 1) % self._fold
            if not self._in_point and len(self._peaks) == 2 * POINTS:
                self._peaks = [max(self._peaks[n : n + 2]) for n in range(0, 2 * POINTS, 2)]
                self._fold *= 2


@lru_cache(maxsize=16)
def _weighted_gain(rig: str, rate: int, frames: int) -> FloatArray:
    """Return |weighted acceleration / full scale|² at an FFT's frequencies below HIGHEST_HZ."""
    frequencies = np.arange(frames // 2 + 1) * (rate / frames)
    frequencies = frequencies[frequencies < HIGHEST_HZ]
    return np.asarray(np.interp(frequencies, RESPONSE_HZ, _weighted_response(rig)))


@lru_cache(maxsize=4)
def _weighted_response(name: str) -> FloatArray:
    """Return |weighted acceleration / full scale|² of a rig's linear model at RESPONSE_HZ."""
    rig = rig_by_name(name)
    p, source = rig.actuator, rig.amplifier.source_impedance_ohm
    linear = Equations(p, energies(p, None), source, rig.seat)
    s = 2j * np.pi * RESPONSE_HZ
    dynamics = s[:, None, None] * np.eye(len(linear.rate)) - linear.rate
    states = np.linalg.solve(dynamics, linear.entry[:, VOLTS, None])[..., 0]
    moved = states @ linear.rate[FRAME_SPEED if rig.seat else SPEED]
    for numerator, denominator, _ in PARTS:
        moved = moved * np.polyval(numerator, s) / np.polyval(denominator, s)
    return np.asarray(np.abs(rig.dac.full_scale_v * rig.amplifier.gain * moved) ** 2)
