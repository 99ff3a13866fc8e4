"""The voice-coil actuator as a linear electro-mechanical model: volts in, motion out.

Equations (8)-(10) of the paper for a force linear in the current, with the electrical side that
follows from the same co-energy:

    m x'' + c x' + k x = Bl i            v = (R + Rs) i + L di/dt + Bl x'

The solution is exact for a voltage that is a straight line between samples, and 0 before the first.
All quantities share three poles: the voltage passes through them once, and each quantity is a sum
of the last four results. The order of all sums is fixed, so the bytes do not depend on how the
signal is split into blocks, nor on whether compiled code or NumPy computes them.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Literal, NamedTuple, get_args

import numpy as np
import scipy

from device import blocks
from device.errors import UsageError
from device.rig.parameters import ActuatorParameters
from device.units import FloatArray, finite_or_zero

Quantity = Literal["displacement_m", "velocity_m_s", "current_a", "acceleration_m_s2"]
QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)


def state_space(
    p: ActuatorParameters, source_impedance_ohm: float
) -> tuple[FloatArray, FloatArray, dict[Quantity, FloatArray]]:
    """Return rate and drive of s' = rate s + drive v, and the row of each quantity.

    s = (x sqrt(k), x' sqrt(m), i sqrt(L)), which keeps the exponential well conditioned.
    """
    m, c, inductance = p.moving_mass_kg, p.damping_n_s_per_m, p.inductance_h
    resistance = p.resistance_ohm + source_impedance_ohm
    w0 = p.resonance_rad_s
    coupling = p.force_factor_n_per_a / np.sqrt(m * inductance)
    rate = np.array(
        [[0.0, w0, 0.0], [-w0, -c / m, coupling], [0.0, -coupling, -resistance / inductance]]
    )
    x, v, i = np.diag(1.0 / np.sqrt([p.stiffness_n_per_m, m, inductance]))
    rows = x, v, i, rate[1] / np.sqrt(m)
    return rate, i, dict(zip(QUANTITIES, rows, strict=True))


def first_order_hold(
    rate: FloatArray, drive: FloatArray, period_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return P, A, B of s[n] = P s[n-1] + A v[n-1] + B v[n], exact for v linear between samples.

    All come from one exponential (Van Loan 1978).
    """
    n = len(rate)
    whole = np.zeros((n + 2, n + 2))
    whole[:n, :n] = rate * period_s
    whole[:n, n] = drive * period_s
    whole[n, n + 1] = 1.0
    exponential = scipy.linalg.expm(whole)
    level, slope = exponential[:n, n], exponential[:n, n + 1]
    return exponential[:n, :n], level - slope, slope


SEAT_ACCELERATION = "seat_acceleration_m_s2"

_TAPS = 4
_ABSURD_V = 1e100
_SILENT_V = 1e-30
_PART_FRAMES = 32_768
"""A decayed state is set to 0 at multiples of this, so that results do not depend on the blocks."""


class Motion(NamedTuple):
    """Motion at each sample, float64, (frames,); quantities that were not asked for have length 0.

    Displacement and velocity are relative to the frame; a positive current pushes to positive
    displacement. The seat's acceleration is that of the frame.
    """

    displacement_m: FloatArray = np.empty(0)
    velocity_m_s: FloatArray = np.empty(0)
    current_a: FloatArray = np.empty(0)
    acceleration_m_s2: FloatArray = np.empty(0)
    seat_acceleration_m_s2: FloatArray = np.empty(0)


class LinearActuator:
    """The linear actuator at one sample rate. One thread calls `move`.

    replaced_samples counts the volts so far that were not finite and became 0.
    """

    def __init__(
        self, parameters: ActuatorParameters, samplerate: float, source_impedance_ohm: float = 0.0
    ) -> None:
        if not (np.isfinite(samplerate) and samplerate > 0):
            raise UsageError(f"samplerate={samplerate!r} Hz must be above 0; choose another rate")
        if not (np.isfinite(source_impedance_ohm) and source_impedance_ohm >= 0):
            raise UsageError(
                f"source_impedance_ohm={source_impedance_ohm!r} must be 0 or more; correct the rig"
            )
        self.parameters = parameters
        self.samplerate = samplerate
        self.source_impedance_ohm = source_impedance_ohm
        self._poles, self._taps = motion_filters(parameters, samplerate, source_impedance_ohm)
        self._state = np.zeros(2 * len(self._poles) + _TAPS)
        self._sections = self._state[: 2 * len(self._poles)].reshape(-1, 2)
        self._last = self._state[2 * len(self._poles) :]
        self.reset()

    def reset(self) -> None:
        """Come to rest: no motion, no current, no voltage; the count is 0."""
        self.replaced_samples = 0
        self._state[:] = 0.0
        self._frames_to_check = _PART_FRAMES

    def move(self, volts: FloatArray, outputs: Sequence[Quantity] = QUANTITIES) -> Motion:
        """Return the motion under the next volts, (frames,); it is always finite.

        NaN, infinity and magnitudes above 1e100 count as 0. Each quantity in outputs adds a third
        to the cost of the poles.
        """
        volts = np.ascontiguousarray(volts, dtype=np.float64)
        moved = np.empty((len(outputs), len(volts)))
        taps = np.array([self._taps[name] for name in outputs]).reshape(-1, _TAPS)
        start, frames = 0, len(volts)
        while start < frames:
            stop = min(start + self._frames_to_check, frames)
            if blocks.compiled is not None:
                self.replaced_samples += blocks.compiled.linear_motion(
                    volts, self._poles, self._state, taps, moved, start, stop, _ABSURD_V
                )
            else:
                self._move_part(volts[start:stop], taps, moved[:, start:stop])
            self._frames_to_check -= stop - start
            if self._frames_to_check == 0:
                self._frames_to_check = _PART_FRAMES
                if np.abs(self._sections).max() < _SILENT_V:
                    self._sections[:] = 0.0
            start = stop
        return Motion(**dict(zip(outputs, moved, strict=True)))

    def _move_part(self, volts: FloatArray, taps: FloatArray, moved: FloatArray) -> None:
        """Do what `linear_motion` does, in the same order."""
        drive, replaced = finite_or_zero(volts, _ABSURD_V)
        self.replaced_samples += replaced
        filtered, self._sections[:] = scipy.signal.sosfilt(self._poles, drive, zi=self._sections)
        recent = np.concatenate([self._last, filtered])
        self._last[:] = recent[-_TAPS:]
        # np.convolve may vary its order of summation within the array.
        moved[:] = taps[:, -1:] * recent[1 : 1 - _TAPS]
        for delay in reversed(range(_TAPS - 1)):
            moved += taps[:, delay, None] * recent[_TAPS - delay : len(recent) - delay]


# The same few actuators are created repeatedly, and a matrix exponential waits for all threads of
# its library.
@lru_cache(maxsize=256)
def motion_filters(
    p: ActuatorParameters, samplerate: float, source_impedance_ohm: float
) -> tuple[FloatArray, dict[Quantity, FloatArray]]:
    """Return sections, (2, 6), gain 1 at 0 Hz, and taps, (4,), newest first, of each quantity.

    They lead from volts to the quantity. The cached arrays must not be changed.
    """
    rate, drive, rows = state_space(p, source_impedance_ohm)
    step, from_last, from_new = first_order_hold(rate, drive, 1.0 / samplerate)
    # The real pole, then the pair: complex, or the two slower real ones if it is overdamped. One
    # section of third order with all its poles close to 1 would lose digits.
    rates = np.linalg.eigvals(rate)
    order = np.lexsort((rates.real, np.abs(rates.imag)))
    single, *pair = np.exp(rates[order] / samplerate)
    poles = np.array([_section(single, 0j), _section(*pair)])

    # The state after the first samples of an impulse; the taps make the poles reproduce it.
    states = [from_new, step @ from_new + from_last]
    while len(states) < _TAPS:
        states.append(step @ states[-1])
    denominator = np.convolve(poles[0, 3:], poles[1, 3:])[:_TAPS]
    gain = poles[0, 0] * poles[1, 0]
    impulses = {name: np.array([row @ state for state in states]) for name, row in rows.items()}
    return poles, {
        name: np.convolve(denominator, impulse)[:_TAPS] / gain for name, impulse in impulses.items()
    }


def _section(first: complex, second: complex) -> list[float]:
    """Return (b0, b1, b2, a0, a1, a2) for two real or conjugate poles, gain 1 at 0 Hz."""
    first, second = complex(first), complex(second)
    gain = ((1 - first) * (1 - second)).real
    return [gain, 0.0, 0.0, 1.0, -(first + second).real, (first * second).real]
