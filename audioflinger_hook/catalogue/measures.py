"""Measures a vibration: the predicted exposure to it, and its peaks over time."""

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
HIGHEST_HZ = 1_000.0  # higher frequencies have negligible weight in ISO 2631-1
RESPONSE_HZ = 6_000
POINT_S = 0.02
POINTS = 120  # a picture of at least 2.4 s of sound has 120 to 240 points


class VibrationMeter:
    """Measures exposure and peaks of a vibration, block by block. Memory is constant."""

    def __init__(self, rig: str) -> None:
        self._rig = rig
        self._energy: FloatArray = np.zeros(0)
        self._block: Float32Array = np.zeros((0, 0), np.float32)
        self._peaks: list[float] = []
        self._rate = self._filled = self._point_frames = self._in_point = 0
        self._fold = 1  # intervals of POINT_S in each point of the picture

    def watch(self, vibration: FloatArray | Float32Array, samplerate: int) -> None:
        """Measure the next block, (frames, channels). samplerate: Hz."""
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
        """Return exposure and peaks of all blocks.

        exposure_a8_m_s2: largest daily exposure A(8) of all channels (ISO 2631-1), predicted by the
            rig's linear model, if this sound is played once a day at full volume.
        course: up to 240 peaks over time, in thousandths of full scale.
        course_step_s: duration of the interval of each peak.
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
        # The time integral of the squared weighted acceleration, m²/s³, by Parseval's theorem. BLAS
        # is not used, since its threads would compete with other workers.
        gain = _weighted_gain(self._rig, self._rate, len(block))
        spectrum = scipy.fft.rfft(block, axis=0)[: len(gain)]
        squares = spectrum.real**2 + spectrum.imag**2
        self._energy += (gain[:, None] * squares).sum(axis=0) * (2.0 / (len(block) * self._rate))
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
    response, step_hz = _weighted_response(rig)
    frequencies = np.arange(frames // 2 + 1) * (rate / frames)
    frequencies = frequencies[frequencies < HIGHEST_HZ]
    gain: FloatArray = np.interp(frequencies, np.arange(len(response)) * step_hz, response)
    return gain


@lru_cache(maxsize=4)
def _weighted_response(name: str) -> tuple[FloatArray, float]:
    """Return |weighted acceleration / full scale|² from 0 Hz on, and the frequency step in Hz."""
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
