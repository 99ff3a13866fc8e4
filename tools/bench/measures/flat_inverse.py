"""The flat inverse: a drive voltage that makes a non-linear actuator move like a linear one.

The excursion x is a flat output of the actuator (Fliess et al., "Flatness and defect of non-linear
systems", 1995). This means that x and its first three derivatives determine force F, current i and
voltage v, without integration:

    F = m x'' + c x' + V'(x),    dW'/dx (x, i) = F,    v = R i + d/dt dW'/di (x, i)

Here m is the moving mass, c the damping, R the resistance, V'(x) the force of the spring, and W'
the magnetic co-energy (device/rig/co_energy.py). W' is quadratic in i, so the current has a closed
form. The wanted motion is the motion of the linear model, whose state gives exact derivatives of x.
"""

import numpy as np

from device.errors import UsageError
from device.rig import Rig
from device.rig.actuator import LinearActuator
from device.rig.co_energy import energies
from device.units import FloatArray, finite_or_zero

_ABSURD_V = 1e6
_WEAKEST = 0.25  # smallest square root in the equation of the current, relative to Bl


class FlatInverse:
    """Converts a drive voltage so that the rig's non-linear actuator moves like a linear one.

    Drive voltages are open-circuit voltages of the amplifier. Voltage limits and end stops are
    ignored; `beyond_samples` counts samples with an excursion beyond the end stops.

    UsageError: the file of the rig has no table [large_signal].
    """

    def __init__(self, rig: Rig, samplerate: float) -> None:
        if rig.large_signal is None:
            raise UsageError(
                f"rig {rig.name!r} describes no [large_signal], so nothing is known to invert; "
                "add it to its file"
            )
        p, source = rig.actuator, rig.amplifier.source_impedance_ohm
        self._linear = LinearActuator(p, samplerate, source)
        self._p = p
        self._ohm = p.resistance_ohm + source
        self._stop_m = rig.large_signal.stop_m
        self._energies = energies(p, rig.large_signal)
        self.reset()

    def reset(self) -> None:
        """Reset the actuator to rest, and `beyond_samples` to 0."""
        self._linear.reset()
        self.beyond_samples = 0

    def process(self, volts: FloatArray) -> FloatArray:
        """Return voltages that move the rig as `volts` would move a linear rig, both (frames,).

        Non-finite samples and samples beyond ±1e6 V count as 0.
        """
        p = self._p
        drive, _ = finite_or_zero(np.asarray(volts, dtype=np.float64), _ABSURD_V)
        motion = self._linear.move(drive)
        x, v, a = motion.displacement_m, motion.velocity_m_s, motion.acceleration_m_s2
        bl, friction = p.force_factor_n_per_a, p.damping_n_s_per_m
        slope = (drive - self._ohm * motion.current_a - bl * v) / p.inductance_h
        jerk = (bl * slope - friction * a - p.stiffness_n_per_m * v) / p.moving_mass_kg
        self.beyond_samples += int(np.count_nonzero(np.abs(x) > self._stop_m))

        # The end stops are left out, since no drive can compensate them.
        _, spring_n, spring_n_m = self._energies.spring(x)
        force_n = p.moving_mass_kg * a + friction * v + spring_n
        force_slope = p.moving_mass_kg * jerk + friction * a + spring_n_m * v
        _, force_factor, force_factor_slope = self._energies.magnet(x)
        inductance, gradient, curvature = self._energies.inductance(x)
        # For constant inductance, the current is F / Bl. This form loses no digits by cancellation.
        least = (_WEAKEST * force_factor) ** 2
        root = np.sqrt(np.maximum(force_factor**2 + 2.0 * gradient * force_n, least))
        current_a = 2.0 * force_n / (force_factor + root)
        moved = (force_factor_slope + 0.5 * curvature * current_a) * current_a * v
        current_slope = (force_slope - moved) / root
        found: FloatArray = self._ohm * current_a + root * v + inductance * current_slope
        return found
