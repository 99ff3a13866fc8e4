"""The processing of one rig: damping, protection, and a meter of the exposure."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from device.drive.damping import Damper, Damping, choose_damping
from device.drive.exposure import Exposure, ExposureMeter, cap_gain
from device.drive.exposure.dose import ACTION_A8_M_S2, ACTION_VDV, LIMIT_A8_M_S2, LIMIT_VDV
from device.drive.protection import ProtectionStatus, Protector
from device.rig import ActuatorParameters, Rig, rig_by_name
from device.units import Block, FloatArray, amplitude_to_db, check_channels

CAPS: dict[str, tuple[float, float] | None] = {
    "off": None,
    "action": (ACTION_A8_M_S2, ACTION_VDV),
    "limit": (LIMIT_A8_M_S2, LIMIT_VDV),
}
"""Limits of each exposure cap, from 2002/44/EC: A(8) in m/s² and VDV in m/s^1.75."""


class RigProcessor:
    """Damper, protector and exposure meter of one rig, in that order.

    The damper makes up for the strength that damping takes. Protection is always on, since a damped
    signal exceeds full scale and must not be clipped. One thread calls `process`, `reset` and
    `drain`; any thread may call the rest.

    rig: the driven rig, with one actuator per channel.
    samplerate: rate in Hz, 6000 or more.
    channels: number of channels, 1 or more.
    damped: whether to damp, with the damping that `choose_damping` finds for the rig's amplifier.
    exposure_cap: one of `CAPS`. Above half of the cap's dose the gain falls slowly.
    knows_seat: whether the rig describes its seat; if not, the seat is taken to move like the mass.
    UsageError: the sample rate is too low.
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
        self.knows_seat = self._meter.knows_seat
        self.exposure_cap = exposure_cap
        self._cap = CAPS[exposure_cap]
        self._damper: Damper | None = None
        self._undamped: ExposureMeter | None = None
        if damped:
            damping = damping_for(rig.actuator, rig.amplifier.source_impedance_ohm)
            self._damper = Damper(damping, samplerate, channels)
            self._undamped = ExposureMeter(rig, samplerate, channels)

    @property
    def latency_frames(self) -> int:
        """Delay of the vibration in frames: that of the protection."""
        return self._protector.latency_frames

    def reset(self) -> None:
        """Return to rest; counts and doses become 0."""
        if self._damper and self._undamped:
            self._damper.reset()
            self._undamped.reset()
        self._protector.reset()
        self._meter.reset()
        self._protector.most = 1.0

    def process(self, block: Block) -> Block:
        """Process a block, (frames, channels), in place and return it."""
        check_channels(block, self.channels)
        if self._damper and self._undamped:
            self._undamped.process(block)
            self._damper.process(block)
        self._protector.process(block)
        self._meter.process(block)
        if self._cap:
            # The dose so far sets the gain of the next block; the meter updates the dose every 0.1
            # s.
            self._protector.most = cap_gain(self._meter.exposure(), *self._cap)
        return block

    def drain(self) -> FloatArray:
        """Return the frames held back when a signal has ended, (latency_frames, channels)."""
        return self.process(np.zeros((self.latency_frames, self.channels)))

    def protection(self) -> ProtectionStatus:
        """Return counts and readings of the protection."""
        return self._protector.status()

    def exposure(self) -> Exposure:
        """Return the exposure so far."""
        return self._meter.exposure()

    @property
    def makeup_db(self) -> float:
        """Gain of the damping that makes up for what it takes at the resonance; 0 without it."""
        return amplitude_to_db(self._damper.damping.gain) if self._damper else 0.0

    @property
    def strength_db(self) -> float | None:
        """Perceived strength so far in dB, against no damping and no protection.

        It is the ratio of the Wk-weighted r.m.s.; None without damping or before any vibration.
        """
        if self._undamped is None:
            return None
        felt, without = self._meter.exposure().a8_m_s2, self._undamped.exposure().a8_m_s2
        return amplitude_to_db(felt / without) if felt and without else None

    @property
    def exposure_gain(self) -> float:
        """Gain that the exposure cap allows, 0 to 1; 1 without a cap."""
        return self._protector.most


def make_rig_processor(
    rig: str,
    samplerate: int,
    channels: int,
    *,
    damping: str = "off",
    protection: str = "off",
    exposure_cap: str = "off",
) -> RigProcessor | None:
    """Return the processor for these choices; None if all three are "off".

    rig: a name or a file, see `rig_by_name`. UsageError: there is no such rig, or the sample rate
    is too low for the processing.
    """
    if (damping, protection, exposure_cap) == ("off", "off", "off"):
        return None
    damped = damping != "off"
    return RigProcessor(
        rig_by_name(rig), samplerate, channels, damped=damped, exposure_cap=exposure_cap
    )


@lru_cache(maxsize=8)
def damping_for(actuator: ActuatorParameters, source_impedance_ohm: float) -> Damping:
    """Return the damping chosen for a rig, made up; the first call per rig takes about a second."""
    chosen = choose_damping(actuator, source_impedance_ohm=source_impedance_ohm)[0]
    return replace(chosen.damping, gain=chosen.makeup)
