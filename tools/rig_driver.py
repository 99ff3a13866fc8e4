"""One rig driven through the core, without sources and delays."""

from __future__ import annotations

import numpy as np

from audioflinger_hook.core.compiled_core import Core
from audioflinger_hook.core.design import core_design
from audioflinger_hook.drive.driven_rig import DrivenRig
from device.drive.damping import Damping
from device.drive.design import DriveDesign
from device.drive.exposure import Exposure
from device.drive.protection import ProtectionStatus
from device.drive.protection.limits import Limits, limits_of
from device.rig import Rig
from device.units import Float32Array, FloatArray


class RigDriver(DrivenRig):
    """Damps, protects and meters one rig on each of some channels. One thread uses it.

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
        """Return what leaves for a block, (frames, channels)."""
        return self.core.process(vibration)

    def through(self, vibration: Float32Array | FloatArray) -> Float32Array:
        """Return all that leaves for a vibration, from its beginning on."""
        silence = np.zeros((self.latency_frames, self.channels))
        return np.concatenate([self.process(vibration), self.process(silence)])[
            self.latency_frames :
        ]

    def reset(self) -> None:
        """Return to rest and cool down; doses become 0."""
        self.core.reset(doses_too=True)

    @property
    def readings(self) -> tuple[ProtectionStatus, Exposure]:
        """Readings of protection and exposure."""
        return self.protection(), self.exposure()
