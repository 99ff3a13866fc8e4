"""The exposure meter in the live path, which leaves the vibration unchanged."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import firwin, sosfilt

from device.drive.exposure.dose import Dose, Exposure, wk_sections
from device.errors import UsageError
from device.rig import Rig
from device.rig.actuator import LinearActuator
from device.rig.seat import SeatMotion
from device.units import Block, FloatArray, check_channels, finite_or_zero

_LOWEST_HZ = 6_000
"""Least rate of the actuator model and Wk: linear interpolation then loses 0.06 % at 80 Hz and
0.5 % at 220 Hz."""
_PART_S = 0.1
_SILENT = 1e-30


_LENGTHS = 6
_KAISER_BETA = 8.0
"""80 dB down at the frequencies that alias onto the vibration."""


class ExposureMeter:
    """Predicts the seat's acceleration from the drive, weights it and accumulates it.

    The meter computes ten times per second, which costs less than once per block. One thread calls
    `process`; any thread may call `exposure`.

    Parameters
    ----------
    rig : Rig
        The driven rig, with one actuator per channel.
    samplerate : int
        Rate in Hz, 6000 or more.
    channels : int
        Number of channels, 1 or more. Each has a dose; each reading is the largest of all.

    Attributes
    ----------
    knows_seat : bool
        Whether the rig describes its seat; if not, the seat is assumed to move like the mass.

    Raises
    ------
    UsageError
        The rate is too low.
    """

    def __init__(self, rig: Rig, samplerate: int, channels: int) -> None:
        if samplerate < _LOWEST_HZ:
            raise UsageError(
                f"samplerate={samplerate} Hz is too low; choose {_LOWEST_HZ} Hz or more"
            )
        self.knows_seat = rig.seat is not None
        self.samplerate = samplerate
        self.channels = channels
        factor = samplerate // _LOWEST_HZ
        self._decimator = Decimator(factor, channels)
        rate = samplerate / factor
        source = rig.amplifier.source_impedance_ohm
        self._actuators: list[LinearActuator] = []
        self._seat: SeatMotion | None = None
        if rig.seat:
            self._seat = SeatMotion(rig.actuator, rig.seat, rate, source, channels)
        else:
            self._actuators = [LinearActuator(rig.actuator, rate, source) for _ in range(channels)]
        self._sections = wk_sections(rate)
        self._m_s2_v = rig.dac.full_scale_v * rig.amplifier.gain
        self._dose = Dose(rate, channels)
        self._part: FloatArray = np.zeros((factor * round(_PART_S * rate), channels))
        self.reset()

    def reset(self) -> None:
        """Start a new day, at rest."""
        self._filled = 0
        self._decimator.reset()
        for actuator in self._actuators:
            actuator.reset()
        if self._seat:
            self._seat.reset()
        self._state = np.zeros((len(self._sections), 2, self.channels))
        self._dose.reset()

    def process(self, block: Block) -> Block:
        """Measure a block, (frames, channels), full scale ±1.0, and return it unchanged.

        The lengths of blocks do not matter. Samples that are not finite, or beyond a million times
        full scale, count as 0.
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
        """Return the readings; the last 0.1 s may be missing. Any thread."""
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
        """Return the acceleration of the seat or, if none is described, of the moving masses."""
        if self._seat:
            return self._seat.move(volts)
        return np.column_stack(
            [
                actuator.move(column, ("acceleration_m_s2",)).acceleration_m_s2
                for actuator, column in zip(self._actuators, volts.T, strict=True)
            ]
        )


class Decimator:
    """Low-passes a stream and keeps every `factor`-th frame. One thread calls it.

    Up to a twentieth of the new rate the error is at most 1e-3, and aliases are 80 dB down.

    factor: 1 or more; 1 changes nothing.
    channels: number of channels, 1 or more.
    """

    def __init__(self, factor: int, channels: int) -> None:
        self.factor = factor
        self._channels = channels
        taps = _LENGTHS * factor + 1
        # The corner is half the new rate: only the low end is needed, so the slope may be wide.
        self._taps = (
            firwin(taps, 1.0 / factor, window=("kaiser", _KAISER_BETA))
            if factor > 1
            else np.ones(1)
        )
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._past = np.zeros((len(self._taps) - 1, self._channels))

    def process(self, frames: FloatArray) -> FloatArray:
        """Return (n, channels) for (n * factor, channels)."""
        if self.factor == 1:
            return frames
        longer = np.concatenate([self._past, frames])
        self._past = longer[len(frames) :].copy()
        windows = sliding_window_view(longer, len(self._taps), axis=0)
        decimated: FloatArray = windows[self.factor - 1 :: self.factor] @ self._taps
        return decimated
