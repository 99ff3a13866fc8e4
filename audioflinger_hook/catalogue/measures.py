"""The measures in a record: the exposure of a vibration, and its course for a picture."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import scipy.fft
from scipy.signal import sosfilt

from device.drive.exposure import wk_sections
from device.rig import rig_by_name
from device.rig.actuator import LinearActuator
from device.rig.equations import seat_sections
from device.units import Float32Array, FloatArray

DAY_S = 8 * 3600.0
HIGHEST_HZ = 1_000.0  # vibration above is negligible
RESPONSE_HZ = 6_000
POINT_S = 0.02
POINTS = 120  # least points of the picture from 2.4 s on; at most twice as many


class VibrationMeter:
    """Measures a vibration in blocks of any length, as a rig would play it; memory is constant."""

    def __init__(self, rig: str) -> None:
        self._rig = rig
        self._energy: FloatArray = np.zeros(0)
        self._block: Float32Array = np.zeros((0, 0), np.float32)
        self._peaks: list[float] = []
        self._rate = self._filled = self._point_frames = self._in_point = 0
        self._fold = 1  # points of POINT_S in one of the picture's points

    def watch(self, vibration: FloatArray | Float32Array, samplerate: int) -> None:
        """Take a block, (frames, channels)."""
        if not self._rate:
            self._rate = samplerate
            channels = vibration.shape[1]
            self._energy = np.zeros(channels)
            self._point_frames = max(1, round(POINT_S * samplerate))
            self._block = np.zeros((POINTS * self._point_frames, channels), np.float32)
        while len(vibration):
            taken = vibration[: len(self._block) - self._filled]
            self._block[self._filled : self._filled + len(taken)] = taken
            self._filled += len(taken)
            vibration = vibration[len(taken) :]
            if self._filled == len(self._block):
                self._take_block()

    def measures(self) -> dict[str, Any]:
        """Return exposure and course of all that was taken.

        exposure_a8_m_s2: A(8) of ISO 2631-1 that the sound adds to a day, by the strongest channel.
            It is the weighted acceleration of the rig's linear model at full volume, over 8 h.
        course: 1 to 240 peaks in thousandths of full scale, in order of time.
        course_step_s: the time of each peak.
        """
        if self._filled:
            self._take_block()
        energy = self._energy.max() if len(self._energy) else 0.0
        return {
            "exposure_a8_m_s2": float(np.sqrt(energy / DAY_S)),
            "course": [round(1e3 * peak) for peak in self._peaks],
            "course_step_s": self._fold * self._point_frames / max(1, self._rate),
        }

    def _take_block(self) -> None:
        block = self._block[: self._filled]
        self._filled = 0
        self._energy += _weighted_energy(block, self._rate, self._rig)
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


def _weighted_energy(block: Float32Array, rate: int, rig: str) -> FloatArray:
    """Return the energy of the weighted acceleration of each channel, in m²/s³."""
    gain = _weighted_gain(rig, rate, len(block))
    spectrum = scipy.fft.rfft(block, axis=0)[: len(gain)]
    squares = spectrum.real**2 + spectrum.imag**2
    # Parseval; not by BLAS, whose threads would cost more time than the rendering.
    energy: FloatArray = (gain[:, None] * squares).sum(axis=0) * (2.0 / (len(block) * rate))
    return energy


@lru_cache(maxsize=16)
def _weighted_gain(rig: str, rate: int, frames: int) -> FloatArray:
    """Return |weighted acceleration / full scale|² at the frequencies of a spectrum."""
    response, step_hz = _weighted_response(rig)
    frequencies = np.arange(frames // 2 + 1) * (rate / frames)
    frequencies = frequencies[frequencies < HIGHEST_HZ]
    gain: FloatArray = np.interp(frequencies, np.arange(len(response)) * step_hz, response)
    return gain


@lru_cache(maxsize=4)
def _weighted_response(name: str) -> tuple[FloatArray, float]:
    """Return |weighted acceleration / full scale|² at frequencies from 0, and their distance."""
    rig = rig_by_name(name)
    impulse = np.zeros(4 * RESPONSE_HZ)
    impulse[0] = rig.dac.full_scale_v * rig.amplifier.gain
    source = rig.amplifier.source_impedance_ohm
    if rig.seat:
        moved = sosfilt(seat_sections(rig.actuator, rig.seat, RESPONSE_HZ, source), impulse)
    else:
        actuator = LinearActuator(rig.actuator, RESPONSE_HZ, source)
        moved = actuator.move(impulse, ("acceleration_m_s2",)).acceleration_m_s2
    response = np.fft.rfft(sosfilt(wk_sections(RESPONSE_HZ), moved))
    return np.abs(response) ** 2, RESPONSE_HZ / len(impulse)
