"""The twin: a simulated rig in the place where hardware goes."""

import numpy as np

from device.errors import InternalError, UsageError
from device.output import VibrationOutput
from device.rig.actuator import LinearActuator
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.electronics import Amplifier, Dac
from device.rig.instruments import AccelerometerChain
from device.rig.rig import Rig
from device.units import Float32Array, FloatArray, check_channels


class Twin:
    """DAC, amplifier and one actuator a channel behind `VibrationOutput`; all channels alike.

    samplerate: Hz, 1000 or more; channels: 1 or more; recorder: takes the acceleration that the
    instruments show, at the same rate and channels, 1.0 for ACCELERATION_FULL_SCALE_M_S2; the
    twin closes or aborts it. tolerance: None for linear actuators, else that of
    `AdaptiveActuator`, block by block; then temperature: coils warm up.

    One thread calls the methods; any thread may read these while it does:

    acceleration_m_s2: (frames, channels) of the last block; a new array each time.
    peak_acceleration_m_s2, peak_displacement_m, peak_current_a: largest magnitude of any channel
    since the start or `reset`. overcurrent_samples: where the current is beyond the amplifier's
    limit; a real one would limit it, or switch off. actuators: one a channel, of `LinearActuator`
    or `AdaptiveActuator`, for their reports.

    Raises
    ------
    UsageError
        The rate is too low.
    InternalError
        The recorder has another rate or number of channels; see `VibrationOutput` for `write`.
    """

    def __init__(
        self,
        rig: Rig,
        samplerate: int,
        channels: int,
        *,
        recorder: VibrationOutput | None = None,
        tolerance: float | None = None,
        temperature: bool = False,
    ) -> None:
        if samplerate < 1_000:
            raise UsageError(f"samplerate={samplerate} Hz is too low; choose 1000 Hz or more")
        if channels < 1:
            raise InternalError(f"channels={channels} must be 1 or more")
        if recorder and (recorder.samplerate, recorder.channels) != (samplerate, channels):
            raise InternalError(
                f"the recorder takes {recorder.channels} channels at {recorder.samplerate} Hz, "
                f"the twin gives {channels} at {samplerate} Hz"
            )
        self.rig = rig
        self._samplerate = samplerate
        self._channels = channels
        self._recorder = recorder
        self._closed = False
        self._dac = Dac(rig.dac)
        self._amplifier = Amplifier(rig.amplifier, samplerate)
        source = rig.amplifier.source_impedance_ohm
        self.actuators: list[LinearActuator | AdaptiveActuator] = [
            LinearActuator(rig.actuator, samplerate, source)
            if tolerance is None
            else AdaptiveActuator(rig, samplerate, tolerance, temperature=temperature)
            for _ in range(channels)
        ]
        self._instruments = AccelerometerChain()
        self.reset()

    def reset(self) -> None:
        """Come to rest and forget peaks and counts; what was recorded stays."""
        self._dac.reset()
        self._amplifier.reset()
        for actuator in self.actuators:
            actuator.reset()
        self.acceleration_m_s2: FloatArray = np.zeros((0, self._channels))
        self.peak_acceleration_m_s2 = 0.0
        self.peak_displacement_m = 0.0
        self.peak_current_a = 0.0
        self.overcurrent_samples = 0

    @property
    def samplerate(self) -> int:
        """Rate in Hz."""
        return self._samplerate

    @property
    def channels(self) -> int:
        """Number of channels, which is the number of actuators."""
        return self._channels

    @property
    def clipped_samples(self) -> int:
        """Samples that the DAC or the amplifier clipped so far."""
        return self._dac.clipped_samples + self._amplifier.clipped_samples

    @property
    def replaced_samples(self) -> int:
        """Samples that were not finite and became 0 so far."""
        return self._dac.replaced_samples

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Move the actuators by one block of (frames, channels), full scale ±1.0."""
        if self._closed:
            raise InternalError("the twin is closed: nothing can be written to it")
        check_channels(vibration, self._channels)
        # Channels as rows: each actuator then reads and writes one segment of memory.
        volts = np.ascontiguousarray(self._amplifier.drive(self._dac.volts(vibration)).T)
        acceleration = np.empty(volts.shape)
        limit_a = self.rig.amplifier.current_limit_a
        for row, (actuator, drive) in enumerate(zip(self.actuators, volts, strict=True)):
            motion = actuator.move(drive, ("acceleration_m_s2", "displacement_m", "current_a"))
            acceleration[row] = motion.acceleration_m_s2
            self.peak_displacement_m = _larger(self.peak_displacement_m, motion.displacement_m)
            self.peak_current_a = _larger(self.peak_current_a, motion.current_a)
            self.overcurrent_samples += int(np.count_nonzero(np.abs(motion.current_a) > limit_a))
        self.peak_acceleration_m_s2 = _larger(self.peak_acceleration_m_s2, acceleration)
        self.acceleration_m_s2 = acceleration.T
        if self._recorder:
            self._recorder.write(self._instruments.volts(self.acceleration_m_s2))

    def close(self) -> None:
        """Finish, and close the recorder."""
        if not self._closed and self._recorder:
            self._recorder.close()
        self._closed = True

    def abort(self) -> None:
        """Finish, and discard what was recorded."""
        if not self._closed and self._recorder:
            self._recorder.abort()
        self._closed = True


def _larger(peak: float, samples: FloatArray) -> float:
    """The larger of a peak and the largest magnitude among the samples."""
    return max(peak, float(np.max(np.abs(samples), initial=0.0)))
