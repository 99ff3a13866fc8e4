"""A laboratory that plays sweeps on the simulated rig and reads its instruments."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from device.errors import UsageError
from device.identification.recording import PLAYED, Recording, Sweep
from device.rig.actuator import Motion
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.electronics import Amplifier, Band, Dac, Daq, InstrumentChain
from device.rig.parameters import AmplifierParameters, DaqParameters, Model
from device.rig.rig import Rig
from device.units import FloatArray

LARGEST_SHARE = 0.15  # largest excursion / Xmax; a larger one hardens the spring, which shifts f0
USUAL_SHARE = 0.05


class SimulatedLaboratory:
    """A simulated `Laboratory`. snr_db: of acceleration and current. move: actuator simulation."""

    def __init__(
        self,
        rig: Rig,
        *,
        seat: bool = False,
        model: Model = "nonlinear",
        snr_db: float = math.inf,
        seed: int = 0,
        move: Callable[[FloatArray, float], Motion] | None = None,
    ) -> None:
        self.rig, self._move = rig, move
        self._seat, self._model, self._snr_db, self._seed = seat, model, snr_db, seed
        InstrumentChain(rig, 48_000)  # raises UsageError for a rig without instruments

    def sweep_at_excursion(self, sweep: Sweep, share: float = USUAL_SHARE) -> Sweep:
        """Return the sweep at the level, at most 1, for a peak excursion of share * Xmax."""
        return sweep_at_excursion(self.rig, sweep, share, seat=self._seat)

    def measure(self, sweep: Sweep, pairs: Sequence[tuple[str, str]]) -> list[Recording]:
        """Return a recording for each pair (reference, response), as in `calibration.ALL_PAIRS`."""
        rate = sweep.samplerate
        amplifier = self.rig.amplifier
        drive = Amplifier(amplifier, rate).drive(Dac(self.rig.dac).volts(sweep.samples()))
        if self._move:
            motion = self._move(drive, rate)
        else:
            adaptive = AdaptiveActuator(self.rig, rate, model=self._model, seat=self._seat)
            motion = adaptive.move(drive, ["acceleration_m_s2", "current_a"])
        voltage = drive - amplifier.source_impedance_ohm * motion.current_a

        chain = InstrumentChain(self.rig, rate, self._seed)
        daq = self.rig.daq
        assert daq is not None  # the constructor has refused a rig without DAQ
        current_range = min(
            amplifier.current_limit_a, amplifier.output_limit_v / self.rig.actuator.resistance_ohm
        )
        first, second = np.random.SeedSequence(self._seed).spawn(2)
        acceleration = self._add_noise(sweep, motion.acceleration_m_s2, first)
        current = self._add_noise(sweep, motion.current_a, second)
        read = {
            "acceleration": chain.acceleration_m_s2(acceleration),
            "current": _read_scaled(daq, current_range, rate, self._seed + 2, current),
            # the voltage is large, so the added noise is omitted
            "voltage": _read_scaled(daq, amplifier.output_limit_v, rate, self._seed + 3, voltage),
            PLAYED: sweep.samples(),
        }
        step = 2.0 ** (1 - daq.bits)
        limits = {
            "acceleration": daq.range_v * (1.0 - step) / chain.v_per_m_s2,
            "current": current_range * (1.0 - step),
            "voltage": amplifier.output_limit_v * (1.0 - step),
            PLAYED: math.inf,
        }
        recordings = []
        for reference, response in pairs:
            ends = limits[reference], limits[response]
            found = Recording(sweep, read[reference], read[response], (reference, response), ends)
            if response == "acceleration":
                found = replace(found, correction=chain.band.response(found.frequencies_hz))
            if reference == PLAYED:
                found = through_amplifier(found, amplifier)
            recordings.append(found)
        return recordings

    def _add_noise(
        self, sweep: Sweep, signal: FloatArray, seed: np.random.SeedSequence
    ) -> FloatArray:
        if math.isinf(self._snr_db):
            return signal
        sounding = signal[sweep.lead_frames : len(signal) - round(sweep.tail_s * sweep.samplerate)]
        rms = float(np.sqrt(np.mean(sounding**2))) * 10.0 ** (-self._snr_db / 20.0)
        return np.asarray(signal + rms * np.random.default_rng(seed).standard_normal(len(signal)))


def through_amplifier(recording: Recording, amplifier: AmplifierParameters) -> Recording:
    """Return the recording with the amplifier's frequency response as its correction."""
    band = Band(amplifier.low_cut_hz, amplifier.high_cut_hz, recording.sweep.samplerate)
    correction = band.response(recording.frequencies_hz)
    return replace(recording, correction=correction, high_pass_hz=amplifier.low_cut_hz)


def sweep_at_excursion(rig: Rig, sweep: Sweep, share: float, *, seat: bool = False) -> Sweep:
    """Return the sweep with the level, at most 1, that moves a linear rig by `share` of Xmax.

    UsageError: share is not above 0, or is above LARGEST_SHARE.
    """
    if not 0.0 < share <= LARGEST_SHARE:
        raise UsageError(
            f"share={share!r} of Xmax must be above 0, up to {LARGEST_SHARE}: louder, f0 "
            "shifts; choose a lower one"
        )
    adaptive = AdaptiveActuator(rig, sweep.samplerate, model="linear", seat=seat)
    loud = replace(sweep, level=1.0)
    amplifier = Amplifier(replace(rig.amplifier, output_limit_v=1e9), sweep.samplerate)
    volts = amplifier.drive(Dac(rig.dac).volts(loud.samples()))
    peak_m = float(np.abs(adaptive.move(volts, ["displacement_m"]).displacement_m).max())
    return replace(sweep, level=min(1.0, share * rig.actuator.x_max_m / peak_m))


def _read_scaled(
    daq: DaqParameters, full_range: float, rate: float, seed: int, signal: FloatArray
) -> FloatArray:
    """Read a signal through the DAQ, scaled so that full_range becomes the DAQ's range."""
    scale = full_range / daq.range_v
    return np.asarray(Daq(daq, rate, seed).volts(signal / scale) * scale)
