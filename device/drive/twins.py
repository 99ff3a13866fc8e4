"""Simulated rigs in the place of several actuators: each channel of the device its own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from device.drive.channel_map import ChannelMap
from device.drive.settings import ActuatorSettings
from device.errors import InternalError
from device.output import VibrationOutput
from device.rig import Rig, rig_by_name
from device.rig.twin import Twin
from device.units import Float32Array, FloatArray, check_channels


class Twins:
    """A `VibrationOutput` of as many channels as a device has, each with a rig or none.

    rigs: of every channel, None where nothing hangs. recorder: takes the acceleration that the
    instruments show, one channel for each of the device, as that of `Twin` does; the twins close
    or abort it. For threads, and what is raised, see `Twin`.
    """

    def __init__(
        self,
        rigs: Sequence[Rig | None],
        samplerate: int,
        *,
        recorder: VibrationOutput | None = None,
    ) -> None:
        if recorder and (recorder.samplerate, recorder.channels) != (samplerate, len(rigs)):
            raise InternalError(
                f"the recorder takes {recorder.channels} channels at {recorder.samplerate} Hz, "
                f"the twins give {len(rigs)} at {samplerate} Hz"
            )
        self._samplerate = samplerate
        self._recorder = recorder
        self._closed = False
        self._heard = [_Last(samplerate) for _ in rigs]
        self._twins = [
            Twin(rig, samplerate, 1, recorder=last) if rig else None
            for rig, last in zip(rigs, self._heard, strict=True)
        ]

    @property
    def samplerate(self) -> int:
        """Rate in Hz."""
        return self._samplerate

    @property
    def channels(self) -> int:
        """Channels of the device."""
        return len(self._twins)

    @property
    def peak_acceleration_m_s2(self) -> float:
        """The largest of any channel so far."""
        return max((t.peak_acceleration_m_s2 for t in self._twins if t), default=0.0)

    @property
    def peak_displacement_m(self) -> float:
        """The largest of any channel so far."""
        return max((t.peak_displacement_m for t in self._twins if t), default=0.0)

    @property
    def peak_current_a(self) -> float:
        """The largest of any channel so far."""
        return max((t.peak_current_a for t in self._twins if t), default=0.0)

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Move the actuators by one block of (frames, channels), full scale ±1.0."""
        if self._closed:
            raise InternalError("the twins are closed: nothing can be written to them")
        check_channels(vibration, self.channels)
        recorded = np.zeros(vibration.shape)
        for channel, (twin, last) in enumerate(zip(self._twins, self._heard, strict=True)):
            if twin is not None:
                twin.write(vibration[:, channel : channel + 1])
                recorded[:, channel] = last.block[:, 0]
        if self._recorder:
            self._recorder.write(recorded)

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


def twins_for(
    settings: Sequence[ActuatorSettings],
    channel_map: ChannelMap,
    samplerate: int,
    *,
    rig: str,
    recorder: VibrationOutput | None = None,
) -> Twins:
    """The rigs of these actuators on a device's channels; rig: where an actuator names none.

    UsageError: there is no such rig, or the samplerate is too low.
    """
    rigs = [rig_by_name(actuator.rig or rig) for actuator in settings]
    wired = [None if source is None else rigs[source] for source in channel_map.sources]
    return Twins(wired, samplerate, recorder=recorder)


class _Last:
    """Keeps the last block that one twin's instruments showed, (frames, 1)."""

    channels = 1

    def __init__(self, samplerate: int) -> None:
        self.samplerate = samplerate
        self.block: FloatArray | Float32Array = np.zeros((0, 1))

    def write(self, vibration: FloatArray | Float32Array) -> None:
        self.block = vibration

    def close(self) -> None:
        """Nothing is held."""

    def abort(self) -> None:
        """Nothing is held."""
