"""The voice-coil actuator as a linear electro-mechanical model: volts in, motion out.

The equations are (8)-(10) of the paper, for a force proportional to the current, and the electrical
equation that follows from the same co-energy:

    m x'' + c x' + k x = Bl i            v = (R + Rs) i + L di/dt + Bl x'

The solution is exact if the voltage is linear between samples, and 0 before the first sample.
All quantities have the same three poles, so that one all-pole filter of the voltage suffices. Each
quantity is a weighted sum of the last four filtered values. The order of all sums is fixed, so the
result is bit-identical for all block lengths, and for compiled code and NumPy.
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
    """Return rate and drive of s' = rate s + drive v, and rows: each quantity is its row times s.

    s = (x sqrt(k), x' sqrt(m), i sqrt(L)), which keeps the matrix exponential well conditioned.
    """
    m, c, inductance = p.moving_mass_kg, p.damping_n_s_per_m, p.inductance_h
    resistance = p.resistance_ohm + source_impedance_ohm
    w0 = p.resonance_rad_s
    coupling = p.force_factor_n_per_a / np.sqrt(m * inductance)
    rate = np.array(
        [[0.0, w0, 0.0], [-w0, -c / m, coupling], [0.0, -coupling, -resistance / inductance]]
    )
    x, v, i = np.diag(1.0 / np.sqrt([p.stiffness_n_per_m, m, inductance]))
    return rate, i, dict(zip(QUANTITIES, (x, v, i, rate[1] / np.sqrt(m)), strict=True))


def first_order_hold(
    rate: FloatArray, drive: FloatArray, period_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return P, A, B of s[n] = P s[n-1] + A v[n-1] + B v[n], exact for v linear between samples."""
    # all from one matrix exponential (Van Loan 1978)
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
_ABSURD_V, _SILENT_V = 1e100, 1e-30
_PART_FRAMES = 32_768  # decayed states become 0 only at multiples of this frame count


class Motion(NamedTuple):
    """Motion at each sample, float64, (frames,); quantities that were not requested are empty.

    Displacement and velocity are relative to the actuator's frame. A positive current causes a
    force towards positive displacement. The seat's acceleration is that of the frame.
    """

    displacement_m: FloatArray = np.empty(0)
    velocity_m_s: FloatArray = np.empty(0)
    current_a: FloatArray = np.empty(0)
    acceleration_m_s2: FloatArray = np.empty(0)
    seat_acceleration_m_s2: FloatArray = np.empty(0)


class LinearActuator:
    """The linear actuator at one sample rate. One thread calls `move`."""

    def __init__(
        self, parameters: ActuatorParameters, samplerate: float, source_impedance_ohm: float = 0.0
    ) -> None:
        if not (np.isfinite(samplerate) and samplerate > 0):
            raise UsageError(f"samplerate={samplerate!r} Hz must be above 0; choose another rate")
        if not (np.isfinite(source_impedance_ohm) and source_impedance_ohm >= 0):
            raise UsageError(
                f"source_impedance_ohm={source_impedance_ohm!r} must be 0 or more; correct the rig"
            )
        self.parameters, self.samplerate = parameters, samplerate
        self.source_impedance_ohm = source_impedance_ohm
        self._poles, self._taps = motion_filters(parameters, samplerate, source_impedance_ohm)
        self._state = np.zeros(2 * len(self._poles) + _TAPS)
        self._sections = self._state[: 2 * len(self._poles)].reshape(-1, 2)
        self._last = self._state[2 * len(self._poles) :]
        self.reset()

    def reset(self) -> None:
        """Set motion, current, voltage and `replaced_samples` to 0."""
        self.replaced_samples = 0
        self._state[:] = 0.0
        self._frames_to_check = _PART_FRAMES

    def move(self, volts: FloatArray, outputs: Sequence[Quantity] = QUANTITIES) -> Motion:
        """Return the motion for the amplifier's next open-circuit volts, (frames,).

        NaN, infinity and magnitudes above 1e100 become 0, so that the motion is always finite.
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
        """Compute the same sums as the compiled `linear_motion`, in the same order."""
        drive, replaced = finite_or_zero(volts, _ABSURD_V)
        self.replaced_samples += replaced
        filtered, self._sections[:] = scipy.signal.sosfilt(self._poles, drive, zi=self._sections)
        recent = np.concatenate([self._last, filtered])
        self._last[:] = recent[-_TAPS:]
        # np.convolve may vary its order of summation within the array
        moved[:] = taps[:, -1:] * recent[1 : 1 - _TAPS]
        for delay in reversed(range(_TAPS - 1)):
            moved += taps[:, delay, None] * recent[_TAPS - delay : len(recent) - delay]


# Cached, since the same actuators are created repeatedly, and a matrix exponential is slow on a
# busy machine: the library that computes it waits for all of its threads.
@lru_cache(maxsize=256)
def motion_filters(
    p: ActuatorParameters, samplerate: float, source_impedance_ohm: float
) -> tuple[FloatArray, dict[Quantity, FloatArray]]:
    """Return sections for the volts, (2, 6), and each quantity's FIR taps, (4,), newest first.

    The sections have gain 1 at 0 Hz. The cached arrays must not be changed.
    """
    rate, drive, rows = state_space(p, source_impedance_ohm)
    step, from_last, from_new = first_order_hold(rate, drive, 1.0 / samplerate)
    # First the real pole, then the pair, which is complex or overdamped. A single third-order
    # section with all poles close to 1 would lose precision.
    rates = np.linalg.eigvals(rate)
    single, *pair = np.exp(rates[np.lexsort((rates.real, np.abs(rates.imag)))] / samplerate)
    poles = np.array([_section(single, 0j), _section(*pair)])

    # The first states of the impulse response, which poles and taps together reproduce.
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
