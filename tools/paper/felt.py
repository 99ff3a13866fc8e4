"""Vibration of the recording, and response of the seat with and without damping: Figure 8."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform import FloatArray, HapticTransform
from device.drive.damping import Damping
from device.drive.design import damping_for
from device.rig import Rig
from device.rig.electronics import InstrumentChain
from device.rig.simulated_rig import SimulatedRig

BAND_HZ = (20.0, 220.0)
TOLERANCE = 1e-3
_SEED = 8


@dataclass(frozen=True)
class Felt:
    """Vibration and motion, float64 (frames,), at one sample rate.

    vibration: aligned with its sound, full scale 1. drive: the vibration after damping, if any.
    acceleration_m_s2: as measured by the instruments. over: True while the vibration is 0, so that
        any motion is residual. clipped_samples: number of samples that DAC, amplifier and
        instruments clipped.
    """

    samplerate: int
    vibration: FloatArray
    drive: FloatArray
    acceleration_m_s2: FloatArray
    over: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
    clipped_samples: int

    def within(self, start_s: float, end_s: float) -> Felt:
        """Return the part between two times in s."""
        part = slice(round(start_s * self.samplerate), round(end_s * self.samplerate))
        return Felt(
            self.samplerate,
            self.vibration[part],
            self.drive[part],
            self.acceleration_m_s2[part],
            self.over[part],
            self.clipped_samples,
        )

    def ends_s(self, pause_s: float = 0.05) -> list[float]:
        """Return the times in s at which vibration ends for at least `pause_s`."""
        frames = np.flatnonzero(np.diff(self.over.astype(np.int8)) == 1) + 1
        pause = round(pause_s * self.samplerate)
        return [f / self.samplerate for f in frames.tolist() if self.over[f : f + pause].all()]

    def residual_db(self, end_s: float, window_s: float = 0.05) -> float:
        """Return the acceleration's energy after the vibration ends, in dB relative to that before.

        end_s: time at which the vibration ends. window_s: duration of each of the two periods.
        """
        end, frames = round(end_s * self.samplerate), round(window_s * self.samplerate)
        power = self.acceleration_m_s2**2
        return 10.0 * math.log10(power[end : end + frames].sum() / power[end - frames : end].sum())


def wanted_vibration(mono: FloatArray, samplerate: int) -> FloatArray:
    """Return the reference form's vibration of sound (frames,), aligned with the sound."""
    transform = HapticTransform(samplerate, 1, form="reference")
    late = np.concatenate([transform.process(mono)[:, 0], transform.finish()[:, 0]])
    return late[transform.latency_frames :]


def chosen_damping(rig: Rig) -> Damping:
    """Return the damping that `damping = "auto"` selects for a rig."""
    return damping_for(rig.actuator, rig.amplifier.source_impedance_ohm)


def felt(vibration: FloatArray, rig: Rig, samplerate: int, damping: Damping | None = None) -> Felt:
    """Return the response of a simulated rig to vibration (frames,), as instruments show it."""
    drive = (damping.filtered(vibration, samplerate) if damping else vibration)[:, None]
    twin = SimulatedRig(rig, samplerate, 1, tolerance=TOLERANCE)
    twin.write(drive)
    moved = [twin.acceleration_m_s2]
    twin.close()
    moved.append(twin.acceleration_m_s2)
    instruments = InstrumentChain(rig, samplerate, _SEED)
    shown = instruments.acceleration_m_s2(np.concatenate(moved)[:, 0])
    return Felt(
        samplerate,
        vibration,
        drive[:, 0],
        shown,
        vibration == 0.0,
        twin.clipped_samples + instruments.clipped_samples,
    )


def share_in_band(signal: FloatArray, samplerate: int) -> float:
    """Return the share of a signal's energy between 20 and 220 Hz. signal: (frames,)."""
    power = np.abs(np.fft.rfft(signal * np.hanning(signal.size))) ** 2
    frequency_hz = np.fft.rfftfreq(signal.size, 1.0 / samplerate)
    inside = (frequency_hz >= BAND_HZ[0]) & (frequency_hz <= BAND_HZ[1])
    return float(power[inside].sum() / power.sum())
