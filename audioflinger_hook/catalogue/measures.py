"""What a record says about a vibration file: its exposure, and its course for a picture."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import scipy.fft
import soundfile
from scipy.signal import sosfilt

from device.drive.exposure.dose import wk_sections
from device.rig import rig_by_name
from device.rig.actuator import LinearActuator
from device.rig.seat import SeatMotion
from device.units import Float32Array, FloatArray

DAY_S = 8 * 3600.0
BLOCK_S = 8.0
HIGHEST_HZ = 1_000.0
"""Vibration above is negligible."""

RESPONSE_HZ = 6_000
POINTS = 120
"""Points of the picture; each is the peak of its share of the time."""


@dataclass(frozen=True)
class Measures:
    """Exposure and course of a vibration.

    exposure_a8_m_s2: A(8) of ISO 2631-1 that the sound adds to a day, of the strongest channel:
        the weighted acceleration of the rig's linear model at full volume, spread over eight hours.
    course: peaks in thousandths of full scale, up to 120, in order of time.
    """

    exposure_a8_m_s2: float
    course: list[int]


def measure(path: Path, rig: str) -> Measures:
    """Return the measures of a vibration file that libsndfile reads; memory does not grow.

    rig: name or file of the rig.
    """
    with soundfile.SoundFile(path) as file:
        rate, frames = file.samplerate, max(1, file.frames)
        blocksize = round(BLOCK_S * rate)
        energy = np.zeros(file.channels)
        course = np.zeros(min(POINTS, frames))
        done = 0
        buffer = np.empty((blocksize, file.channels), np.float32)
        while len(block := file.read(out=buffer)):
            energy += _weighted_energy(block, rate, rig)
            # Frame n belongs to point n · points // frames; a point may lie in two blocks.
            first = done * len(course) // frames
            last = (done + len(block) - 1) * len(course) // frames
            points = np.arange(first, last + 1)
            starts = np.maximum(-(-points * frames // len(course)) - done, 0)
            high, low = (one.reduceat(block, starts) for one in (np.maximum, np.minimum))
            peaks = np.maximum(high, -low).max(axis=1)
            course[points] = np.maximum(course[points], peaks)
            done += len(block)
    a8 = float(np.sqrt(energy.max() / DAY_S))
    return Measures(a8, [round(1e3 * float(point)) for point in course])


def _weighted_energy(block: Float32Array, rate: int, rig: str) -> FloatArray:
    """Return the energy of the weighted acceleration of each channel, in m²/s³."""
    gain = _weighted_gain(rig, rate, len(block))
    spectrum = scipy.fft.rfft(block, axis=0)[: len(gain)]
    squares = spectrum.real**2 + spectrum.imag**2
    energy: FloatArray = (gain @ squares) * (2.0 / (len(block) * rate))  # Parseval
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
    impulse = np.zeros((4 * RESPONSE_HZ, 1))
    impulse[0] = rig.dac.full_scale_v * rig.amplifier.gain
    source = rig.amplifier.source_impedance_ohm
    if rig.seat:
        moved = SeatMotion(rig.actuator, rig.seat, RESPONSE_HZ, source, 1).move(impulse)[:, 0]
    else:
        actuator = LinearActuator(rig.actuator, RESPONSE_HZ, source)
        moved = actuator.move(impulse[:, 0], ("acceleration_m_s2",)).acceleration_m_s2
    response = np.fft.rfft(sosfilt(wk_sections(RESPONSE_HZ), moved))
    return np.abs(response) ** 2, RESPONSE_HZ / len(impulse)
