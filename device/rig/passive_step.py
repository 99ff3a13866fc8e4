"""The model that never fails: one sample at a time, passive at any step size.

The energy H(y, u, lambda) = V(y) + m u^2 / 2 + (lambda - Phi(y))^2 / 2 L(y) is differenced instead
of differentiated (discrete gradient, Itoh and Abe 1988, averaged over both orders). A step changes
H exactly by the energy supplied less the heat, up to rounding. One scalar equation remains. Its
left side is unbounded in both directions, so bisection always finds a solution.
"""

import math
from typing import NamedTuple

import numpy as np

from device.rig.equations import Equations
from device.units import FloatArray

_SECANT_STEPS = 25
_BISECTIONS = 200
_EPSILON = float(np.finfo(np.float64).eps)


class _Tried(NamedTuple):
    """The consequences of a change of the excursion over one step."""

    left_n: float  # the residual force; 0 solves the step
    force_n: float  # the inertial force
    flux_wb: float  # at the end


class PassiveStepper:
    """An actuator that is solved sample by sample. One thread calls it."""

    def __init__(self, equations: Equations, step_s: float) -> None:
        self.equations = equations
        self.step_s = step_s
        seat, h = equations.seat, step_s
        self._frame_mass = seat.mass_kg if seat else 1.0
        self._frame_spring = seat.stiffness_n_per_m if seat else 0.0
        self._frame_damping = seat.damping_n_s_per_m if seat else 0.0
        self._frame_drag = (
            2.0 * self._frame_mass / h + self._frame_spring * h / 2.0 + self._frame_damping
        )
        give = h * h / (2.0 * equations.mass) + (h / self._frame_drag if seat else 0.0)
        self._inertia = 1.0 / give
        # y, u, lambda = Phi + q, z, z' (equations.py); the last two stay 0 without a seat.
        self.state = [0.0, 0.0, 0.0, 0.0, 0.0]

    def move(self, volts: FloatArray, before_v: float) -> FloatArray:
        """Return y, u, lambda, z, z', current and u' after each of (frames,) volts, (7, frames).

        Between samples the voltage is a straight line, which begins at before_v.
        """
        result = np.empty((7, len(volts)))
        for frame, volt in enumerate(volts.tolist()):
            self._step(0.5 * (before_v + volt))
            before_v = volt
            result[:5, frame] = self.state
            result[5:, frame] = self._current_and_acceleration()
        return result

    def _step(self, volt: float) -> None:
        y0, u0, _, z0, zs0 = self.state
        h, seat = self.step_s, self.equations.seat
        # The frame's mean speed if no force acted on it.
        coast = 0.0
        if seat:
            coast = (2.0 * self._frame_mass * zs0 / h - self._frame_spring * z0) / self._frame_drag
        free = h * (u0 - coast)
        move, (_, force, flux1) = self._solve(volt, free)
        u1 = u0 + h * force / self.equations.mass
        z1, zs1 = 0.0, 0.0
        if seat:
            mean = coast - force / self._frame_drag
            z1, zs1 = z0 + h * mean, 2.0 * mean - zs0
        self.state = [y0 + move, u1, flux1, z1, zs1]

    def _solve(self, volt: float, free: float) -> tuple[float, "_Tried"]:
        """Return the excursion's change over the step and its consequences."""
        equations = self.equations
        # At constant flux the coil's back-EMF through its inductance is a spring.
        spring = equations.stiffness + equations.force_factor**2 / equations.inductance
        stiff = spring + equations.damping / self.step_s + self._inertia
        older, tried = free, self._try(free, volt, free)
        newer = free - tried.left_n / stiff
        # A smaller change than the rounding of the excursion gains nothing.
        enough = 2.0 * _EPSILON * (abs(self.state[0]) * 1e-3 + abs(free))
        for _ in range(_SECANT_STEPS):
            before, tried = tried, self._try(newer, volt, free)
            if tried.left_n == 0.0 or abs(newer - older) <= enough:
                return newer, tried
            slope = (tried.left_n - before.left_n) / (newer - older)
            if not (math.isfinite(slope) and slope > 0.0):
                break
            older, newer = newer, newer - tried.left_n / slope
        return self._bisect(volt, free)

    def _bisect(self, volt: float, free: float) -> tuple[float, "_Tried"]:
        reach = abs(free) + abs(self.state[0]) + 1e-9
        while (
            self._try(reach, volt, free).left_n < 0.0 or self._try(-reach, volt, free).left_n > 0.0
        ):
            reach *= 4.0
        low, high = -reach, reach
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            if middle in (low, high):
                break
            if self._try(middle, volt, free).left_n < 0.0:
                low = middle
            else:
                high = middle
        return high, self._try(high, volt, free)

    def _try(self, move: float, volt: float, free: float) -> "_Tried":
        """Return the consequences of a change of the excursion."""
        equations, h = self.equations, self.step_s
        e = equations.energies
        y0, _, flux0, _, _ = self.state
        y1 = y0 + move
        magnet, inductance = e.co_energy.magnet, e.co_energy.inductance
        phi0, phi1, phi_d = magnet.value(y0), magnet.value(y1), magnet.divided(y0, y1)
        # 1 / L at both ends and its divided difference
        l0, l1 = inductance.value(y0), inductance.value(y1)
        g0, g1, g_d = 1.0 / l0, 1.0 / l1, -inductance.divided(y0, y1) / (l0 * l1)
        g = 0.5 * (g0 + g1)
        offset = 0.5 * (g0 * phi0 + g1 * phi1)
        share = 0.5 * h * equations.resistance_ohm * g
        driven = h * (volt + equations.resistance_ohm * offset)
        flux1 = (flux0 * (1.0 - share) + driven) / (1.0 + share)
        field = 0.0
        for flux in (flux0, flux1):
            at0, at1 = flux - phi0, flux - phi1
            field += 0.25 * (g_d * 0.5 * (at0 * at0 + at1 * at1) - g * phi_d * (at0 + at1))
        drag = equations.damping + self._stop_drag(y0 + 0.5 * move)
        force = -e.potential.divided(y0, y1) - field - drag * move / h
        inertial = self._inertia * (move - free)
        # The inertial force keeps the state consistent; rounding goes into the other one.
        return _Tried(inertial - force, inertial, flux1)

    def _stop_drag(self, y: float) -> float:
        e = self.equations.energies
        depth = abs(y) - e.stops.start
        if depth <= 0.0:
            return 0.0
        return e.stop_loss_s_per_m * e.stops.hardness * depth * depth

    def _current_and_acceleration(self) -> tuple[float, float]:
        y, u, flux, _, zs = self.state
        e, w = self.equations.energies, u - zs
        magnet, inductance = e.co_energy.magnet, e.co_energy.inductance
        current = (flux - magnet.value(y)) / inductance.value(y)
        force = magnet.divided(y, y) * current + inductance.divided(y, y) * current * current / 2.0
        force -= e.potential.divided(y, y)
        force -= (self.equations.damping + self._stop_drag(y)) * w
        return current, force / self.equations.mass
