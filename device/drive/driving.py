"""What is done to vibration on its way to a rig: damping, protection, and a look at exposure."""

from functools import lru_cache

import numpy as np

from device.drive.damping import Damper, Damping, choose_damping
from device.drive.exposure import Exposure, ExposureMeter, cap_gain
from device.drive.exposure.dose import ACTION_A8_M_S2, ACTION_VDV, LIMIT_A8_M_S2, LIMIT_VDV
from device.drive.processing import BlockProcessor
from device.drive.protection import ProtectionStatus, Protector
from device.rig import ActuatorParameters, Rig, rig_by_name
from device.units import Block, FloatArray, check_channels

CAPS: dict[str, tuple[float, float] | None] = {
    "off": None,
    "action": (ACTION_A8_M_S2, ACTION_VDV),
    "limit": (LIMIT_A8_M_S2, LIMIT_VDV),
}
"""A(8) and VDV that a cap of the exposure keeps to, by name: those of 2002/44/EC."""


class Driving:
    """Damper, if one is wanted, protector and exposure meter of one rig, as one processor.

    rig: what is driven, one actuator a channel; samplerate: Hz, 6000 or more; channels: 1 or
    more. damped: whether by the damping that `choose_damping` finds for the rig's own amplifier,
    without any delay. Protection is always there: a damped drive has transients above full scale,
    which must not be clipped. exposure_cap: of `CAPS`, what the vibration since the start is not to
    exceed; it turns down slowly from half of that dose on.

    One thread calls `process`, `reset` and `owed`; any thread may call the rest.

    Raises
    ------
    UsageError
        The samplerate is too low for one of them.
    """

    def __init__(
        self,
        rig: Rig,
        samplerate: int,
        channels: int,
        *,
        damped: bool = False,
        exposure_cap: str = "off",
    ) -> None:
        self.rig = rig
        self.channels = channels
        self._protector = Protector(rig, samplerate, channels)
        self._meter = ExposureMeter(rig, samplerate, channels)
        self.exposure_cap = exposure_cap
        self._cap = CAPS[exposure_cap]
        self._processors: list[BlockProcessor] = [self._protector, self._meter]
        if damped:
            damping = damping_for(rig.actuator, rig.amplifier.source_impedance_ohm)
            self._processors.insert(0, Damper(damping, samplerate, channels))

    @property
    def latency_frames(self) -> int:
        """By how many frames the vibration comes later."""
        return sum(processor.latency_frames for processor in self._processors)

    def reset(self) -> None:
        """Begin anew, at rest: counts and doses are 0."""
        for processor in self._processors:
            processor.reset()
        self._protector.most = 1.0

    def process(self, block: Block) -> Block:
        """Treat a block of (frames, channels) in place, any number of frames, and return it."""
        check_channels(block, self.channels)
        for processor in self._processors:
            processor.process(block)
        if self._cap:
            # What was last added to the dose; the meter looks ten times a second.
            self._protector.most = cap_gain(self._meter.exposure(), *self._cap)
        return block

    def owed(self) -> FloatArray:
        """The last (latency_frames, channels), which are still held when a signal has ended."""
        return self.process(np.zeros((self.latency_frames, self.channels)))

    def protection(self) -> ProtectionStatus:
        """What the protection did so far, and sees."""
        return self._protector.status()

    def exposure(self) -> Exposure:
        """How much vibration there has been so far."""
        return self._meter.exposure()

    @property
    def knows_seat(self) -> bool:
        """Whether exposure is that of the rig's own seat; else the seat moves as the mass does."""
        return self._meter.knows_seat

    @property
    def exposure_gain(self) -> float:
        """The gain that the cap leaves, 0 to 1; 1 without a cap."""
        return self._protector.most


def driving_for(
    rig: str,
    samplerate: int,
    channels: int,
    *,
    damping: str = "off",
    protection: str = "off",
    exposure_cap: str = "off",
) -> Driving | None:
    """What is to be done for a rig, None for nothing: where all three are "off".

    rig: a name or file, see `rig_by_name`; for the rest see `Driving`.

    Raises
    ------
    UsageError
        There is no such rig, or the samplerate is too low for it.
    """
    if (damping, protection, exposure_cap) == ("off", "off", "off"):
        return None
    damped = damping != "off"
    return Driving(rig_by_name(rig), samplerate, channels, damped=damped, exposure_cap=exposure_cap)


@lru_cache(maxsize=8)
def damping_for(actuator: ActuatorParameters, source_impedance_ohm: float) -> Damping:
    """The damping that is chosen for a rig; it takes some tenths of a second the first time."""
    return choose_damping(actuator, source_impedances_ohm=(source_impedance_ohm,)).damping
