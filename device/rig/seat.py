"""What the seat does with the volts, as a linear filter: acceleration of frame, cushion, sitter."""

import numpy as np
from scipy.signal import sosfilt, ss2zpk, zpk2sos

from device.rig.actuator import first_order_hold
from device.rig.co_energy import linear_energies
from device.rig.equations import FLUX, FRAME_SPEED, Equations
from device.rig.parameters import ActuatorParameters, SeatParameters
from device.units import FloatArray

_SILENT = 1e-30


class SeatMotion:
    """Acceleration of a rig's seat on several channels, an actuator and a seat each; linear.

    samplerate: Hz; source_impedance_ohm: of the amplifier; channels: 1 or more. Exact for a
    voltage that is a straight line between samples. It holds its state; one thread calls it.
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
        """(frames, channels) in m/s^2 for finite volts of that shape."""
        acceleration, self._state = sosfilt(self._sections, volts, axis=0, zi=self._state)
        if np.abs(self._state).max() < _SILENT:
            self._state[:] = 0.0
        return np.asarray(acceleration)


def seat_sections(
    p: ActuatorParameters, seat: SeatParameters, samplerate: float, source_impedance_ohm: float
) -> FloatArray:
    """(3, 6): second-order sections from volts to the seat's acceleration, m/s^2. Pure."""
    equations = Equations(p, linear_energies(p), source_impedance_ohm, seat)
    rate, drive = np.zeros((equations.states,) * 2), np.zeros(equations.states)
    for (row, column), entry in equations.matrix.items():
        rate[row, column] = entry
    drive[FLUX] = 1.0
    shown = rate[FRAME_SPEED]
    # Coordinates whose squares are energies: else the numbers differ by a factor of millions.
    scale = np.sqrt(
        [
            equations.stiffness, p.moving_mass_kg, 1.0 / p.inductance_h,
            seat.stiffness_n_per_m, seat.mass_kg,
        ]
    )  # fmt: skip
    rate = rate * scale[:, None] / scale
    step, from_last, from_new = first_order_hold(rate, drive * scale, 1.0 / samplerate)
    shown = shown / scale
    # As a system whose state takes the last volt only, and whose output takes the new one.
    entered = (step @ from_new + from_last)[:, None]
    zeros, poles, gain = ss2zpk(step, entered, shown[None], np.array([[shown @ from_new]]))
    return np.asarray(zpk2sos(zeros, poles, gain))
