"""The exposure meter in the live path: it looks at the drive and leaves it as it is."""

import numpy as np
from scipy.signal import sosfilt

from device.drive.exposure.decimator import Decimator
from device.drive.exposure.dose import Dose, Exposure
from device.drive.exposure.weighting import wk_sections
from device.errors import InternalError, UsageError
from device.rig import Rig
from device.rig.actuator import LinearActuator
from device.rig.seat import SeatMotion
from device.units import Block, FloatArray, check_channels, finite_or_zero

_LOWEST_HZ = 6_000
"""Rate at which the actuator and Wk are computed at least: the straight lines between samples
then take 0.06 % from 80 Hz and 0.5 % from 220 Hz."""
_PART_S = 0.1
_SILENT = 1e-30


class ExposureMeter:
    """Predicts the seat's acceleration from the drive, weights it and adds it up.

    rig: what is driven, one actuator a channel; samplerate: Hz, 6000 or more; channels: 1 or
    more, each a dose of its own, of which the worst is shown. transmission: acceleration of the
    seat over that of the moving mass on the ground; None for what the rig says of its seat, and 1,
    the careful assumption, where it says nothing. knows_seat: whether the rig's seat was taken.

    Frames are gathered and looked at ten times a second: that costs less than in every block.
    One thread calls `process`; any thread may call `exposure`.

    Raises
    ------
    UsageError
        The rate is too low, or the transmission is not a number of 0 or more.
    """

    def __init__(
        self, rig: Rig, samplerate: int, channels: int, *, transmission: float | None = None
    ) -> None:
        if samplerate < _LOWEST_HZ:
            raise UsageError(
                f"samplerate={samplerate} Hz is too low; choose {_LOWEST_HZ} Hz or more"
            )
        self.knows_seat = transmission is None and rig.seat is not None
        transmission = 1.0 if transmission is None else transmission
        if not (np.isfinite(transmission) and transmission >= 0.0):
            raise UsageError(f"transmission={transmission!r} must be 0 or more; correct it")
        if channels < 1:
            raise InternalError(f"channels={channels} must be 1 or more")
        self.samplerate = samplerate
        self.channels = channels
        factor = samplerate // _LOWEST_HZ
        self._decimator = Decimator(factor, channels)
        rate = samplerate / factor
        source = rig.amplifier.source_impedance_ohm
        self._actuators: list[LinearActuator] = []
        self._seat: SeatMotion | None = None
        if self.knows_seat and rig.seat:
            self._seat = SeatMotion(rig.actuator, rig.seat, rate, source, channels)
        else:
            self._actuators = [LinearActuator(rig.actuator, rate, source) for _ in range(channels)]
        self._sections = wk_sections(rate)
        self._m_s2_v = transmission * rig.dac.full_scale_v * rig.amplifier.gain
        self._dose = Dose(rate, channels)
        self._part: FloatArray = np.zeros((factor * round(_PART_S * rate), channels))
        self.reset()

    @property
    def latency_frames(self) -> int:
        """0: the vibration is not changed."""
        return 0

    def reset(self) -> None:
        """Begin a new day, at rest."""
        self._filled = 0
        self._decimator.reset()
        for actuator in self._actuators:
            actuator.reset()
        if self._seat:
            self._seat.reset()
        self._state = np.zeros((len(self._sections), 2, self.channels))
        self._dose.reset()

    def process(self, block: Block) -> Block:
        """Look at a block of (frames, channels), full scale ±1.0, and return it as it is.

        Any number of frames; nothing depends on how the stream is cut into blocks. Samples that
        are not finite, or beyond a million times full scale, count as 0.
        """
        check_channels(block, self.channels)
        start = 0
        while start < len(block):
            count = min(len(self._part) - self._filled, len(block) - start)
            self._part[self._filled : self._filled + count] = block[start : start + count]
            self._filled += count
            start += count
            if self._filled == len(self._part):
                self._filled = 0
                self._add(self._part)
        return block

    def exposure(self) -> Exposure:
        """Readings; the last tenth of a second may be missing. Any thread."""
        return self._dose.exposure()

    def _add(self, part: FloatArray) -> None:
        drive, _ = finite_or_zero(part, 1e6)
        volts = self._decimator.process(drive) * self._m_s2_v
        weighted, self._state = sosfilt(
            self._sections, self._acceleration(volts), axis=0, zi=self._state
        )
        if np.abs(self._state).max() < _SILENT:
            self._state[:] = 0.0
        self._dose.add(weighted)

    def _acceleration(self, volts: FloatArray) -> FloatArray:
        """(frames, channels): of the seat or, where none is described, of the moving masses."""
        if self._seat:
            return self._seat.move(volts)
        return np.column_stack(
            [
                actuator.move(column, ("acceleration_m_s2",)).acceleration_m_s2
                for actuator, column in zip(self._actuators, volts.T, strict=True)
            ]
        )
