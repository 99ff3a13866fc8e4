"""The acceleration of frame, cushion and sitter as a linear filter of the volts."""

import numpy as np
import scipy

from device.rig.actuator import first_order_hold
from device.rig.co_energy import linear_energies
from device.rig.equations import FLUX, FRAME_SPEED, Equations
from device.rig.parameters import ActuatorParameters, SeatParameters
from device.units import FloatArray

_SILENT = 1e-30


class SeatMotion:
    """Linear acceleration of the seat; each channel has its own actuator and seat.

    It is exact for a voltage that is a straight line between samples. One thread calls it.
    """

    def __init__(
        self,
        p: ActuatorParameters,
        seat: SeatParameters,
        samplerate: float,
        source_impedance_ohm: float,
        channels: int,
    ) -> None:
        self._sections = seat_sections(p, seat, samplerate, source_impedance_ohm)
        self._channels = channels
        self.reset()

    def reset(self) -> None:
        """Come to rest."""
        self._state = np.zeros((len(self._sections), 2, self._channels))

    def move(self, volts: FloatArray) -> FloatArray:
        """Return (frames, channels), m/s^2, for finite volts of that shape."""
        acceleration, self._state = scipy.signal.sosfilt(
            self._sections, volts, axis=0, zi=self._state
        )
        if np.abs(self._state).max() < _SILENT:
            self._state[:] = 0.0
        return np.asarray(acceleration)


def seat_sections(
    p: ActuatorParameters, seat: SeatParameters, samplerate: float, source_impedance_ohm: float
) -> FloatArray:
    """Return second-order sections, (3, 6), from volts to the seat's acceleration, m/s^2."""
    equations = Equations(p, linear_energies(p), source_impedance_ohm, seat)
    # In coordinates whose squares are energies, entries do not differ by factors of millions.
    scale = equations.scale
    rate, drive = scale[:, None] * equations.rate / scale, np.zeros(equations.states)
    drive[FLUX] = scale[FLUX]
    shown = equations.rate[FRAME_SPEED] / scale
    step, from_last, from_new = first_order_hold(rate, drive, 1.0 / samplerate)
    # The state takes the last volt only; the output takes the new one.
    entered = (step @ from_new + from_last)[:, None]
    zeros, poles, gain = scipy.signal.ss2zpk(
        step, entered, shown[None], np.array([[shown @ from_new]])
    )
    return np.asarray(scipy.signal.zpk2sos(zeros, poles, gain))
