"""Computes drive signals for a rig with the C core."""

from __future__ import annotations

import numpy as np

from audioflinger_hook.core.compiled_core import Core
from audioflinger_hook.core.design import core_design
from audioflinger_hook.drive.drive import DrivenRig
from device.drive.damping import Damping
from device.drive.design import DriveDesign
from device.drive.exposure import Exposure
from device.drive.protection.design import Limits, ProtectionStatus, limits_of
from device.rig import Rig
from device.units import Float32Array, FloatArray


class RigDriver(DrivenRig):
    """Damping, protection and level meters of one rig on each channel. Only one thread may use it.

    rig, samplerate, damping, exposure_cap, limits: see `DriveDesign`. channels: 1 or more.
    UsageError: the sample rate is too low.
    """

    def __init__(
        self,
        rig: Rig,
        samplerate: int,
        channels: int = 1,
        *,
        damping: Damping | None = None,
        exposure_cap: str = "off",
        limits: Limits | None = None,
    ) -> None:
        design = DriveDesign(rig, samplerate, damping, exposure_cap, limits)
        self.limits = limits or limits_of(rig)
        self.core = Core(core_design(samplerate, channels, drives=[design] * channels))
        for channel in range(channels):
            self.core.controls.actuators[channel].source = channel
        super().__init__(design, self.core.controls, self.core.readings, range(channels))

    def process(self, vibration: Float32Array | FloatArray) -> Float32Array:
        """Return the drive signal for a block of vibration, (frames, channels)."""
        return self.core.process(vibration)

    def through(self, vibration: Float32Array | FloatArray) -> Float32Array:
        """Return the drive signal for a whole vibration without the delay. First call `reset`."""
        silence = np.zeros((self.latency_frames, self.channels))
        return np.concatenate([self.process(vibration), self.process(silence)])[
            self.latency_frames :
        ]

    def reset(self) -> None:
        """Reset the actuators to rest and to their initial temperature, and the exposure to 0."""
        self.core.reset(doses_too=True)

    @property
    def readings(self) -> tuple[ProtectionStatus, Exposure]:
        """The status of protection, and the exposure."""
        return self.protection(), self.exposure()
