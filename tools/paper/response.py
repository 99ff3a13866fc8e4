"""Measures the rig's frequency response with exponential sweeps, as in a laboratory: Figure 6.

The sweep passes DAC, amplifier and actuator. Accelerometer, conditioning amplifier and DAQ measure
the motion; a second input of the DAQ measures the coil's current with a probe. Acceleration per
ampere is the response of mass, spring and friction, equation (8) of the paper, with a peak at their
resonance. Acceleration per volt includes the actuator's electrical damping, so its peak is flatter
and higher in frequency.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import chirp

from audioflinger_hook.transform import FloatArray
from device.errors import InternalError
from device.rig import Rig
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.electronics import Amplifier, Dac, Daq, InstrumentChain

SAMPLERATE = 48_000
SWEEP_HZ = (1.0, 500.0)
SHOWN_HZ = (5.0, 300.0)
LEVEL = 0.4  # amplitude, full scale 1
PROBE_V_PER_A = 1.0
TAKES = 4
SWEEP_S = 12.0
REST_S = 1.0
FADE_S = 0.25
COHERENT = 0.95

GATE_S = (0.1, 0.9)
"""Duration in s of the impulse response that is kept before and after its start. The sweep's
harmonics arrive more than a second earlier, since they pass each frequency earlier.
"""
_GATE_EDGE_S = 0.05
_EDGES_HZ = (1.5, 4.0, 400.0, 480.0)
_TOLERANCE = 1e-4
_SEED = 6


Spectrum = np.ndarray[tuple[int, ...], np.dtype[np.complex128]]


@dataclass(frozen=True)
class Response:
    """A measured response at ascending frequencies; each array is (bins,).

    per_ampere: complex, m/s^2 per A.
    per_volt: complex, m/s^2 per V at the amplifier's output.
    coherence: 0 to 1, between acceleration and sweep.
    excursion_share: peak excursion during the measurement, relative to Xmax, the excursion limit.
    """

    frequency_hz: FloatArray
    per_ampere: Spectrum
    per_volt: Spectrum
    coherence: FloatArray
    excursion_share: float

    @property
    def resonance_hz(self) -> float:
        """The frequency of the largest acceleration per ampere."""
        return float(self.frequency_hz[np.argmax(np.abs(self.per_ampere))])


def measure_response(rig: Rig) -> Response:
    """Return the response at frequencies from 5 to 300 Hz with a coherence of 0.95 or more.

    UsageError: the rig describes no instruments.
    InternalError: the rig has no DAQ, or a converter or amplifier clipped.
    """
    dac, amplifier = Dac(rig.dac), Amplifier(rig.amplifier, SAMPLERATE)
    actuator = AdaptiveActuator(rig, SAMPLERATE, _TOLERANCE)
    instruments = InstrumentChain(rig, SAMPLERATE, _SEED)
    if rig.daq is None:
        raise InternalError(f"rig {rig.name!r} has instruments without a DAQ")
    second_input = Daq(rig.daq, SAMPLERATE, _SEED + 2)
    sweep = _sweep()
    drive = np.fft.rfft(sweep) * (rig.dac.full_scale_v * rig.amplifier.gain)
    moved, flowed, largest_m = [], [], 0.0
    for _ in range(TAKES):
        motion = actuator.move(amplifier.drive(dac.volts(sweep)))
        largest_m = max(largest_m, float(np.abs(motion.displacement_m).max()))
        moved.append(np.fft.rfft(instruments.acceleration_m_s2(motion.acceleration_m_s2)))
        read_v = second_input.volts(motion.current_a * PROBE_V_PER_A)
        flowed.append(np.fft.rfft(read_v / PROBE_V_PER_A))
    clipped = dac.clipped_samples + amplifier.clipped_samples + instruments.clipped_samples
    if clipped + second_input.clipped_samples:
        raise InternalError(f"{clipped + second_input.clipped_samples} samples of a sweep clipped")

    frequency_hz: FloatArray = np.fft.rfftfreq(sweep.size, 1.0 / SAMPLERATE).astype(np.float64)
    acceleration, current = np.mean(moved, axis=0), np.mean(flowed, axis=0)
    power = np.mean(np.abs(moved) ** 2, axis=0)
    coherence = np.abs(acceleration) ** 2 / np.maximum(power, np.finfo(float).tiny)
    per_volt = _gated(acceleration, drive, frequency_hz)
    amperes_per_volt = _gated(current, drive, frequency_hz)
    low_hz, high_hz = SHOWN_HZ
    shown = (frequency_hz >= low_hz) & (frequency_hz <= high_hz) & (coherence >= COHERENT)
    return Response(
        frequency_hz=frequency_hz[shown],
        per_ampere=per_volt[shown] / amperes_per_volt[shown],
        per_volt=per_volt[shown],
        coherence=coherence[shown],
        excursion_share=largest_m / rig.actuator.x_max_m,
    )


def _gated(read: Spectrum, drive: Spectrum, frequency_hz: FloatArray) -> Spectrum:
    """Return the ratio of two spectra, (bins,), without harmonics of the drive signal.

    A. Farina, "Simultaneous measurement of impulse response and distortion with a swept-sine
    technique", 2000. In the impulse response, the products of distortion precede the linear
    response, and are removed.
    """
    swept = np.interp(frequency_hz, _EDGES_HZ, (0.0, 1.0, 1.0, 0.0))
    soft = np.sin(0.5 * np.pi * swept) ** 2
    ratio = np.zeros_like(read)
    np.divide(read * soft, drive, out=ratio, where=soft > 0.0)
    frames = 2 * (frequency_hz.size - 1)
    impulse = np.fft.irfft(ratio, frames)
    time_s = np.fft.fftfreq(frames, 1.0 / frames) / SAMPLERATE  # the second half has negative times
    before_s, after_s = GATE_S
    room_s = np.minimum(time_s + before_s, after_s - time_s)
    return np.fft.rfft(
        impulse * np.sin(0.5 * np.pi * np.clip(room_s / _GATE_EDGE_S, 0.0, 1.0)) ** 2
    )


def _sweep() -> FloatArray:
    """Return an exponential sweep with fades, then silence, (frames,), full scale 1."""
    time_s = np.arange(round(SWEEP_S * SAMPLERATE)) / SAMPLERATE
    low_hz, high_hz = SWEEP_HZ
    wave = chirp(time_s, low_hz, SWEEP_S, high_hz, method="logarithmic", phi=-90.0)
    edge = np.minimum(1.0, np.minimum(time_s, time_s[::-1]) / FADE_S)
    soft = LEVEL * np.sin(0.5 * np.pi * edge) ** 2 * wave
    return np.concatenate([soft, np.zeros(round(REST_S * SAMPLERATE))])
