"""A simulated rig in place of a device: DAC, amplifier and actuator for each channel."""

from collections.abc import Callable, Sequence

import numpy as np

from device.errors import InternalError, UsageError
from device.output import VibrationOutput
from device.rig.actuator import LinearActuator, Motion
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.electronics import CONDITIONING_V_PER_M_S2, Amplifier, Dac
from device.rig.model_record import SHOWN, ModelRecord, SecondReport, actuator_of
from device.rig.parameters import Model
from device.rig.rig import Rig
from device.units import Float32Array, FloatArray, check_channels


class SimulatedRig:
    """A `VibrationOutput` that moves one simulated actuator for each channel.

    One thread writes; any thread may read the attributes at any time. Unless tolerance is None, the
    rig is simulated in blocks of 0.1 s, independent of the writes; `close` processes the rest.
    rig: one for all channels, or a list with one for each channel, None for an unconnected channel.
    channels: 1 or more; None for the list's length. recorder: records the accelerations as samples,
    1.0 for ACCELERATION_FULL_SCALE_M_S2; `close` and `abort` also close and abort the recorder.
    tolerance, model: see `AdaptiveActuator`; tolerance None for `LinearActuator`. clock: returns
    the CPU time, s, for `seconds`; None for no reports.
    acceleration_m_s2: (frames, channels) of the last `write` or `close`; 0 in channels without rig.
    peak_acceleration_m_s2, peak_displacement_m, peak_current_a: largest magnitudes since the start
    or `reset`. overcurrent_samples: number of samples with a current beyond the amplifier's limit.
    """

    def __init__(
        self,
        rig: Rig | Sequence[Rig | None],
        samplerate: int,
        channels: int | None = None,
        *,
        recorder: VibrationOutput | None = None,
        tolerance: float | None = None,
        model: Model = "auto",
        clock: Callable[[], float] | None = None,
    ) -> None:
        if samplerate < 1_000:
            raise UsageError(f"samplerate={samplerate} Hz is too low; choose 1000 Hz or more")
        rigs = [rig] * (channels or 0) if isinstance(rig, Rig) else list(rig)
        if not rigs or channels not in (None, len(rigs)):
            raise InternalError(f"channels={channels} must be 1 or more, the number of rigs")
        if recorder and (recorder.samplerate, recorder.channels) != (samplerate, len(rigs)):
            raise InternalError(
                f"the recorder needs {recorder.channels} channels at {recorder.samplerate} Hz, "
                f"the simulated rig gives {len(rigs)} at {samplerate} Hz"
            )
        self.samplerate, self.channels = samplerate, len(rigs)
        self._recorder, self._closed = recorder, False
        self._stages: list[_Stage] = []
        for one in dict.fromkeys(filter(None, rigs)):
            columns = [column for column, other in enumerate(rigs) if other == one]
            self._stages.append(_Stage(one, columns, samplerate, tolerance, model, clock))
        chosen = [one for one in self.actuators if isinstance(one, AdaptiveActuator)]
        self._grid_frames = max((one.block_frames for one in chosen), default=0)
        self.reset()

    @property
    def actuators(self) -> list[LinearActuator | AdaptiveActuator]:
        """The actuators, grouped by rig."""
        return [actuator for stage in self._stages for actuator in stage.actuators]

    @property
    def clipped_samples(self) -> int:
        """Number of samples that DACs or amplifiers have clipped."""
        return sum(one.dac.clipped_samples + one.amplifier.clipped_samples for one in self._stages)

    @property
    def replaced_samples(self) -> int:
        """Number of samples that were not finite and became 0."""
        return sum(stage.dac.replaced_samples for stage in self._stages)

    @property
    def seconds(self) -> list[SecondReport]:
        """For each second of signal, the report of the rig with the largest error in it."""
        records = [stage.record.seconds for stage in self._stages if stage.record]
        together = zip(*records, strict=False)
        return [max(several, key=lambda one: one.error_percent) for several in together]

    def reset(self) -> None:
        """Reset actuators, peaks and counts; recorded frames are kept."""
        for stage in self._stages:
            stage.reset()
        self.acceleration_m_s2: FloatArray = np.zeros((0, self.channels))
        self._waiting: FloatArray = np.zeros((0, self.channels))
        self.peak_acceleration_m_s2 = self.peak_displacement_m = self.peak_current_a = 0.0
        self.overcurrent_samples = 0

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Move the actuators by one block of (frames, channels), full scale ±1.0."""
        if self._closed:
            raise InternalError("the simulated rig is closed: nothing can be written to it")
        check_channels(vibration, self.channels)
        if not (grid := self._grid_frames):
            self.acceleration_m_s2 = self._move(vibration)
            return
        known: FloatArray = np.concatenate((self._waiting, vibration))
        whole = len(known) // grid * grid
        self._waiting = known[whole:].copy()
        moved = [self._move(known[first : first + grid]) for first in range(0, whole, grid)]
        self.acceleration_m_s2 = np.concatenate([np.zeros((0, self.channels)), *moved])

    def _move(self, vibration: FloatArray | Float32Array) -> FloatArray:
        # Channels as rows: each actuator then reads and writes contiguous memory.
        acceleration = np.zeros(vibration.shape[::-1])
        for stage in self._stages:
            volts = stage.volts(vibration)
            limit_a = stage.rig.amplifier.current_limit_a
            for index, channel in enumerate(stage.columns):
                motion = stage.move(index, volts[index])
                acceleration[channel] = motion.acceleration_m_s2
                self.peak_displacement_m = _larger(self.peak_displacement_m, motion.displacement_m)
                self.peak_current_a = _larger(self.peak_current_a, motion.current_a)
                over = np.abs(motion.current_a) > limit_a
                self.overcurrent_samples += int(np.count_nonzero(over))
            if stage.record:
                stage.record.advance(len(vibration))
        self.peak_acceleration_m_s2 = _larger(self.peak_acceleration_m_s2, acceleration)
        if self._recorder:
            self._recorder.write(acceleration.T * CONDITIONING_V_PER_M_S2)
        return acceleration.T

    def close(self) -> None:
        """Process the frames of an incomplete block, and close the recorder."""
        if self._closed:
            return
        if self._grid_frames:
            waiting, self._waiting = self._waiting, self._waiting[:0]
            self.acceleration_m_s2 = self._move(waiting)
        for stage in self._stages:
            if stage.record:
                stage.record.finish()
        if self._recorder:
            self._recorder.close()
        self._closed = True

    def abort(self) -> None:
        """Discard the frames of an incomplete block, and the recorded frames."""
        if not self._closed and self._recorder:
            self._recorder.abort()
        self._closed = True


class _Stage:
    """DAC, amplifier and actuators of all channels with the same rig."""

    def __init__(
        self,
        rig: Rig,
        columns: list[int],
        samplerate: int,
        tolerance: float | None,
        model: Model,
        clock: Callable[[], float] | None,
    ) -> None:
        self.rig, self.columns = rig, columns
        self.dac = Dac(rig.dac)
        self.amplifier = Amplifier(rig.amplifier, samplerate)
        source = rig.amplifier.source_impedance_ohm
        self.actuators: list[LinearActuator | AdaptiveActuator] = [
            LinearActuator(rig.actuator, samplerate, source)
            if tolerance is None
            else actuator_of(rig, samplerate, model, tolerance)
            for _ in columns
        ]
        self._samplerate, self._clock = samplerate, clock

    def reset(self) -> None:
        for part in (self.dac, self.amplifier, *self.actuators):
            part.reset()
        self.record: ModelRecord | None = None
        chosen = [one for one in self.actuators if isinstance(one, AdaptiveActuator)]
        if self._clock and chosen:
            self.record = ModelRecord(chosen, self._samplerate, self._clock)

    def move(self, index: int, volts: FloatArray) -> Motion:
        if self.record:
            return self.record.move(index, volts)
        return self.actuators[index].move(volts, SHOWN)

    def volts(self, vibration: FloatArray | Float32Array) -> FloatArray:
        """Return the amplifier's output, (columns, frames), contiguous."""
        own = vibration[:, self.columns]
        return np.ascontiguousarray(self.amplifier.drive(self.dac.volts(own)).T)


def _larger(peak: float, samples: FloatArray) -> float:
    return max(peak, float(np.max(np.abs(samples), initial=0.0)))
