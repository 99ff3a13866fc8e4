"""The recording's vibration and what the seat makes of it, with damping or without: Figure 8."""

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
    """Vibration and motion, float64 (frames,) each, all at one samplerate.

    vibration: what is wanted, at the time of its sound, full scale 1; drive: that, damped or not;
    acceleration_m_s2: as the instruments show it; over: where the sound asks for no vibration, so
    that all that moves is residual; clipped_samples: of the DAC, the amplifier and instruments.
    """

    samplerate: int
    vibration: FloatArray
    drive: FloatArray
    acceleration_m_s2: FloatArray
    over: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
    clipped_samples: int

    def within(self, start_s: float, end_s: float) -> Felt:
        """The same, cut to a stretch of time."""
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
        """When vibration ends that nothing follows for `pause_s`, s from the first frame."""
        frames = np.flatnonzero(np.diff(self.over.astype(np.int8)) == 1) + 1
        pause = round(pause_s * self.samplerate)
        return [f / self.samplerate for f in frames.tolist() if self.over[f : f + pause].all()]

    def residual_db(self, end_s: float, window_s: float = 0.05) -> float:
        """Energy of the acceleration in `window_s` after an end, in dB of that before it."""
        end, frames = round(end_s * self.samplerate), round(window_s * self.samplerate)
        power = self.acceleration_m_s2**2
        return 10.0 * math.log10(power[end : end + frames].sum() / power[end - frames : end].sum())


def wanted_vibration(mono: FloatArray, samplerate: int) -> FloatArray:
    """The vibration of sound (frames,) by the reference form, at its sound's own time."""
    transform = HapticTransform(samplerate, 1, form="reference")
    late = np.concatenate([transform.process(mono)[:, 0], transform.finish()[:, 0]])
    return late[transform.latency_frames :]


def chosen_damping(rig: Rig) -> Damping:
    """What the automatic choice takes for the rig, at the strength of undamped vibration."""
    return damping_for(rig.actuator, rig.amplifier.source_impedance_ohm)


def felt(vibration: FloatArray, rig: Rig, samplerate: int, damping: Damping | None = None) -> Felt:
    """What the rig does with vibration (frames,), full scale 1, and what its instruments show."""
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
    """The share of a signal's energy, (frames,), that lies from 20 to 220 Hz."""
    power = np.abs(np.fft.rfft(signal * np.hanning(signal.size))) ** 2
    frequency_hz = np.fft.rfftfreq(signal.size, 1.0 / samplerate)
    inside = (frequency_hz >= BAND_HZ[0]) & (frequency_hz <= BAND_HZ[1])
    return float(power[inside].sum() / power.sum())
