"""An actuator that selects for each block the fastest model with a sufficiently small error.

First, the linear model computes a block. This model neglects non-linear parts of force and voltage.
The error is estimated from the linear response to these parts. If the estimate exceeds the
tolerance, the non-linear model computes this block and 7 more, or fewer if excursion decreases.
Each block starts from the last excursion, speed and current (native/rig_model.c).

The linear model is exact for a voltage that is linear between samples. The non-linear model is
solved by ETDRK4 of Cox and Matthews, Exponential time differencing for stiff systems (2002). This
method makes at least one fourth-order Runge-Kutta step per sample. The flux may decay within less
than a sample, so each step contains the exact solution of this decay.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np

from device import blocks
from device.errors import UsageError
from device.rig.actuator import QUANTITIES, SEAT_ACCELERATION, Motion, first_order_hold
from device.rig.co_energy import energies, table_of
from device.rig.equations import Equations
from device.rig.parameters import MODELS, Model
from device.rig.rig import Rig
from device.units import FloatArray, finite_or_zero

BLOCK_S = 0.1
_ABSURD_V = 1e6
_NAMES = (*QUANTITIES, SEAT_ACCELERATION)
FLOOR = 0.01  # errors are relative to a peak, or to this share of Xmax if the peak is less
MARGIN = 2.5  # assumed ratio of the error to the first-order correction
LONGEST_STEP_S = 1.0 / 40_000.0
_SHORTEST_STEP_S = 0.25e-6  # `unresolved_frames` counts end stops that need shorter steps
_TURN, _CONTACT_TURN = 0.35, 0.125  # largest phase per step in rad, without and with end stops
_COARSE_HZ = 6_000.0  # rate at which the first-order correction is computed
_STATES = 5
STATE_NUMBERS = 2 * _STATES + 8  # length of a rig's state, which is 0 at rest


@dataclass(frozen=True)
class BlockReport:
    """The model used for one block, or for the part of a block in one call of `move`."""

    frame: int  # index of the first frame, 0 at the start
    frames: int
    model: Model  # "linear" or "nonlinear"
    estimate: float  # error of a selected linear model relative to the peak, else 0


class AdaptiveActuator:
    """One actuator with both models; it keeps its state between blocks. One thread calls it.

    The voltage is linear between samples, and was 0 before the first sample. A fixed model gives
    bit-identical results however the signal is divided into calls. "auto" selects a model for each
    block of 0.1 s since the start, or for the part of the block in one call. tolerance: allowed
    error of excursion and acceleration relative to a block's peak, 0 to 1. model: "auto", or a
    fixed model; a rig without [large_signal] is always linear. seat: whether the actuator is on the
    rig's seat instead of solid ground. refine: number of halvings of the non-linear step.
    UsageError: the rig lacks the wanted seat, a number is out of range, or the library is missing.
    """

    def __init__(
        self,
        rig: Rig,
        samplerate: float,
        tolerance: float = 1e-3,
        *,
        model: Model = "auto",
        seat: bool = False,
        refine: int = 0,
    ) -> None:
        if not 0.0 < tolerance <= 1.0:
            raise UsageError(
                f"tolerance={tolerance!r} must be above 0 and at most 1; 0.01 allows 1 % of the "
                "peak"
            )
        if not (np.isfinite(samplerate) and samplerate > 0):
            raise UsageError(f"samplerate={samplerate!r} Hz must be above 0; choose another rate")
        if seat and rig.seat is None:
            raise UsageError(f"rig {rig.name!r} describes no [seat]; add it to its file")
        if blocks.compiled is None:
            raise UsageError(
                "the simulated rig needs device/blocks_library.so, which is missing or damaged; "
                "install a C compiler and then this package again"
            )
        if rig.large_signal is None:
            model = "linear"  # the rig has no non-linear parameters
        self.rig, self.samplerate, self.tolerance, self.model = rig, samplerate, tolerance, model
        self._move = blocks.compiled.move_rig
        source_ohm, frame = rig.amplifier.source_impedance_ohm, rig.seat if seat else None
        stored = energies(rig.actuator, rig.large_signal)
        equations = Equations(rig.actuator, stored, source_ohm, frame)
        self._design = ModelDesign(equations, samplerate, tolerance, refine)
        self._rows = 5 if seat else 4
        coarse = self._design.coarse
        self.block_frames = coarse * max(1, round(BLOCK_S * samplerate / coarse))
        self.reset()

    def reset(self) -> None:
        """Reset to rest, and clear reports and counts."""
        self._state = np.zeros(STATE_NUMBERS)
        self._frames = 0
        self.replaced_samples = 0  # volts that were NaN or above 1e6 in magnitude, and became 0
        self.reports: deque[BlockReport] = deque(maxlen=4_096)
        self.frames_by_model: dict[Model, int] = {"linear": 0, "nonlinear": 0}

    @property
    def unresolved_frames(self) -> int:
        """Number of frames with an end stop too hard for the shortest step, or a diverged state."""
        return int(self._state[-1])

    def move(self, volts: FloatArray, outputs: Sequence[str] = QUANTITIES) -> Motion:
        """Return the motion, always finite, for the amplifier's open-circuit volts, (frames,)."""
        finite, replaced = finite_or_zero(np.ascontiguousarray(volts, dtype=np.float64), _ABSURD_V)
        self.replaced_samples += replaced
        whole, block = len(finite), self.block_frames
        moved = np.empty((self._rows, whole))
        first = min(block - self._frames % block, whole)
        lengths = [first, *(min(block, whole - start) for start in range(first, whole, block))]
        lengths = lengths if whole else []
        found = np.zeros((len(lengths), 2))
        numbers = 0, whole, first, block, MODELS.index(self.model)
        if whole:
            self._move(finite, moved, self._design.arrays, self._state, found, numbers)
        for frames, (nonlinear, estimate) in zip(lengths, found.tolist(), strict=True):
            model: Model = "nonlinear" if nonlinear else "linear"
            self.reports.append(BlockReport(self._frames, frames, model, estimate))
            self.frames_by_model[model] += frames
            self._frames += frames
        rows = dict(zip(_NAMES, moved, strict=False))
        return Motion(**{name: rows[name] for name in outputs})


class ModelDesign:
    """Both models of one rig at one sample rate.

    arrays: numbers, the table of the energies, the coefficients for each step length, and the
    linear model's matrices over one sample and over several. refine: as for `AdaptiveActuator`.
    """

    def __init__(
        self, equations: Equations, samplerate: float, tolerance: float, refine: int = 0
    ) -> None:
        e, p, seat = equations, equations.actuator, equations.seat
        period_s = 1.0 / samplerate
        self.coarse = max(1, round(samplerate / _COARSE_HZ))
        longest_s = min(LONGEST_STEP_S, _TURN / _fastest_rad_s(e))
        first = max(0, math.ceil(math.log2(period_s / longest_s) - 1e-9)) + refine
        levels = 1 + max(first, math.ceil(math.log2(period_s / _SHORTEST_STEP_S)) + refine)
        table, stops = table_of(e.energies, p.x_max_m), e.energies.stops
        least_m = FLOOR * p.x_max_m
        frame = astuple(seat) if seat else (0, 0, 0)
        contact_kg = e.mass * seat.mass_kg / (e.mass + seat.mass_kg) if seat else e.mass
        numbers = np.array(
            [
                e.mass, e.damping, e.stiffness, e.force_factor, e.inductance,
                e.resistance_ohm, e.resistance_ohm,  # of a warm coil and of a cold coil
                stops.start, stops.hardness, e.energies.stop_loss_s_per_m,
                contact_kg, _CONTACT_TURN / 2**refine,
                table.lowest_m, table.intervals_per_m, len(table.rows), *frame,
                least_m, least_m * p.resonance_rad_s**2, tolerance, MARGIN,
                period_s, levels, first, self.coarse,
            ],
            dtype=np.float64,
        )  # fmt: skip
        decay_per_s, scale, maps = e.resistance_ohm / e.inductance, e.scale, []
        steps = [_step(decay_per_s, period_s / 2**level) for level in range(levels)]
        for width, entry in ((1, e.entry[:, 1:]), (self.coarse, e.entry)):
            # Squared coordinates are energies, so that entries have similar magnitudes.
            rate, scaled = scale[:, None] * e.rate / scale, scale[:, None] * entry
            holds = [first_order_hold(rate, one, width * period_s) for one in scaled.T]
            inputs = [np.column_stack([hold[k] for hold in holds]) for k in (1, 2)]
            parts = holds[0][0] * scale, *inputs
            maps.append(np.concatenate([(part / scale[:, None]).ravel() for part in parts]))
        self.arrays = (numbers, table.rows, np.array(steps), *maps)


def _fastest_rad_s(e: Equations) -> float:
    """Return an estimate of the equations' fastest rate in rad/s, without the end stops."""
    reach = np.linspace(-1.0, 1.0, 41) * e.actuator.x_max_m
    stiffness = np.abs(e.energies.spring(reach)[2]).max()
    # The coil's back-EMF acts like a spring, or like a damper if the current settles faster.
    spring = e.force_factor / math.sqrt(e.inductance * e.mass)
    damper = e.force_factor**2 / (e.resistance_ohm * e.mass)
    fastest = math.sqrt(stiffness / e.mass) + e.damping / e.mass + min(spring, damper)
    if e.seat:
        big = e.seat.mass_kg
        fastest *= 1.0 + e.mass / big
        fastest += math.sqrt(e.seat.stiffness_n_per_m / big) + e.seat.damping_n_s_per_m / big
    return fastest


def _step(decay_per_s: float, width_s: float) -> tuple[float, ...]:
    """Return the width of a step and its flux coefficients, in the order of `Step` in C."""
    whole, half_s = decay_per_s * width_s, 0.5 * width_s
    two, three = _phi(2, -whole), _phi(3, -whole)
    return (
        *(width_s, decay_per_s, 0.0, 0.0),
        math.exp(-0.5 * whole),
        half_s * _phi(1, -0.5 * whole),
        half_s * half_s * _phi(2, -0.5 * whole),
        math.exp(-whole),
        width_s * _phi(1, -whole),
        width_s * width_s * two,
        width_s * (2.0 * two - 4.0 * three),
        width_s * (4.0 * three - two),
    )


def _phi(order: int, z: float) -> float:
    """Return (exp(z) - the first `order` terms of its power series) / z^order. z: 0 or less."""
    if abs(z) < 1.0:
        return math.fsum(z**k / math.factorial(k + order) for k in range(20))
    found = math.exp(z)
    for k in range(order):
        found = (found - 1.0 / math.factorial(k)) / z
    return found
