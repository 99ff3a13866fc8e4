"""Tables that predict how a block of vibration moves several linear models of one actuator.

A model consists of the amplifier's filters and one actuator, with one linear step per sample. Half
the squared norm of the first three states is the stored energy of the actuator.
"""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import scipy

from device.rig import ActuatorParameters
from device.rig.actuator import LinearActuator, Quantity, first_order_hold, state_space
from device.rig.electronics import Band
from device.rig.parameters import AmplifierParameters
from device.units import FloatArray, Records

ACTUATOR_STATES = 3
LAST = ACTUATOR_STATES
"""Index in a state. Order: x sqrt(k), x' sqrt(m), i sqrt(L), the amplifier's previous output as a
share of full scale, then two values for each amplifier section."""

_FAR_ABOVE = 20.0  # a low-pass this far above the resonance is omitted: its effect is 3e-6
_DECAYED = 25.0
_HORIZON_FRAMES = 1 << 20
LANES = 8  # the core processes groups of this many frames
_WATCHED_HZ = 6_000.0  # least rate at which excursion is computed; see `_slacks_m`
_TAIL_POINTS = 32
_TAIL_PERIODS = 1.25
_UNREACHABLE = 1e30  # in place of infinity, for an excursion bound that is not computed


def amplifier_sections(
    amplifier: AmplifierParameters, models: Sequence[ActuatorParameters], samplerate: float
) -> FloatArray:
    """Return the amplifier's filters, except a low-pass far above all resonances, (n, 6)."""
    far = amplifier.high_cut_hz > _FAR_ABOVE * max(model.resonance_hz for model in models)
    return Band(amplifier.low_cut_hz, np.inf if far else amplifier.high_cut_hz, samplerate).sections


class DriveModel:
    """One actuator model behind the amplifier: S[n] = step S[n-1] + drive u[n]. Immutable.

    The model is exact if the voltage is linear between samples. Any thread may use it.
    sections: from `amplifier_sections`. volts: voltage at the actuator for full scale.
    step, drive: (states, states) and (states,). u: vibration, full scale 1.
    x_row, i_row: (states,): rows that give excursion in m and current in A from a state.
    last_kick: norm of the actuator's state that an amplifier output of 1 in the last frame causes.
    """

    def __init__(
        self,
        model: ActuatorParameters,
        samplerate: float,
        source_impedance_ohm: float,
        sections: FloatArray,
        volts: float,
    ) -> None:
        self.model, self.samplerate, self.volts = model, samplerate, volts
        self.source_impedance_ohm, self._sections = source_impedance_ohm, sections
        hold, from_last, from_new, x_row, i_row = _held(model, samplerate, source_impedance_ohm)
        turn, enter, leave, through = _cascade(sections)
        self.states = LAST + 1 + len(turn)
        n = ACTUATOR_STATES
        self.step: FloatArray = np.zeros((self.states, self.states))
        self.step[:n, :n] = hold
        self.step[:n, LAST] = volts * from_last
        self.step[:n, LAST + 1 :] = volts * np.outer(from_new, leave)
        self.step[LAST, LAST + 1 :] = leave
        self.step[LAST + 1 :, LAST + 1 :] = turn
        self.drive: FloatArray = np.concatenate([volts * through * from_new, [through], enter])
        self.x_row: FloatArray = np.pad(x_row, (0, self.states - n))
        self.i_row: FloatArray = np.pad(i_row, (0, self.states - n))
        self.last_kick = float(np.linalg.norm(self.step[:n, LAST]))

    def reach(self, quantity: Quantity) -> float:
        """Return the largest |quantity| per volt of peak voltage: the sum of |impulse response|.

        Infinity if the response decays too slowly; the core then predicts every block's motion.
        """
        if not (frames := self._horizon()):
            return math.inf
        impulse = np.zeros(frames)
        impulse[0] = 1.0
        if len(self._sections):
            impulse = scipy.signal.sosfilt(self._sections, impulse)
        # the factor covers the omitted rest of e^-25
        return float(np.abs(self._moved(impulse, quantity)).sum()) * (1.0 + 1e-9)

    def ring(self) -> float:
        """Return the largest |x|, m per volt, after an amplifier state of norm 1 without input."""
        if not len(self._sections):
            return 0.0
        if not (frames := self._horizon()):
            return math.inf
        squares = np.zeros(frames)
        for at, section in enumerate(self._sections):
            for column in _section(section)[4].T:
                state = np.zeros((len(self._sections), 2))
                state[at] = column
                volts, _ = scipy.signal.sosfilt(self._sections, np.zeros(frames), zi=state)
                squares += self._moved(volts, "displacement_m") ** 2
        return math.sqrt(float(squares.max()))

    def _moved(self, volts: FloatArray, quantity: Quantity) -> FloatArray:
        actuator = LinearActuator(self.model, self.samplerate, self.source_impedance_ohm)
        return np.asarray(getattr(actuator.move(volts, (quantity,)), quantity))

    def _horizon(self) -> int:
        """Return the number of frames until all oscillation has decayed to e^-25; 0 if too many."""
        decay = math.pi * self.model.resonance_hz / self.model.q_total(self.source_impedance_ohm)
        # The amplifier's slowest pair of poles decays by e^-slow per second.
        radii = [math.sqrt(float(a2)) for a2 in self._sections[:, 5]]
        slow = min((-math.log(radius) * self.samplerate for radius in radii), default=math.inf)
        # The actuator decays after the amplifier, so both times add.
        frames = math.ceil(_DECAYED * self.samplerate * (1.0 / decay + 1.0 / slow))
        return frames if frames <= _HORIZON_FRAMES else 0


@lru_cache(maxsize=64)
def _held(
    p: ActuatorParameters, samplerate: float, source_impedance_ohm: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the state matrix, input vectors of previous and new voltage, and rows of x and i."""
    rate, drive, rows = state_space(p, source_impedance_ohm)
    held = first_order_hold(rate, drive, 1.0 / samplerate)
    return *held, rows["displacement_m"], rows["current_a"]


def _cascade(sections: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return the cascade of sections as q' = turn q + enter u, y = leave q + through u."""
    turn, enter, leave, through = np.zeros((0, 0)), np.zeros(0), np.zeros(0), 1.0
    for section in sections:
        own, entered, left, direct, _ = _section(section)
        turn = np.block([[turn, np.zeros((len(turn), 2))], [np.outer(entered, leave), own]])
        enter = np.concatenate([enter, entered * through])
        leave = np.concatenate([leave * direct, left])
        through *= direct
    return turn, enter, leave, through


def _section(section: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, float, FloatArray]:
    """Return one section's matrices, in a basis where |state| bounds |output|, and the basis."""
    b0, b1, b2, _, a1, a2 = section.tolist()
    own = np.array([[-a1, 1.0], [-a2, 0.0]])
    entered = np.array([b1 - a1 * b0, b2 - a2 * b0])
    values, vectors = np.linalg.eig(own)
    first = vectors[:, 0]
    shape = np.column_stack([first.real, first.imag]) if values[0].imag else vectors.real
    shape = shape / np.linalg.norm(shape[0])
    back = np.linalg.inv(shape)
    return back @ own @ shape, back @ entered, shape[0], b0, shape


def prediction_records(
    drives: Sequence[DriveModel], block_frames: int, excursion_m: float, current_models: int
) -> Records:
    """Return the models' response to a block, named as in `ProtectionDesign` of the core.

    The unit of excursion is the limit minus the largest rises between computed frames; current is
    in A. Impulse responses are stored last frame first, and matrices by their columns.
    drives: models of the possible actuators, the identified model first. current_models: number of
    models whose current is limited.
    states: number of states of one model. stride: frames between two computed excursions. watched:
        number of computed excursions in a block; the last is that of the last frame. tail_points:
        number of computed excursions of the free oscillation after a block.
    excursion_by_drive: (models, block_frames). excursion_by_state: (models, states, watched).
    state_by_drive: (models, states, block_frames). state_by_state: (models, states, states).
    current_by_drive: (currents, block_frames), currents = 1 + current_models. The first current
        assumes a coil with resistance only, for an upper bound on the coil's temperature.
    current_by_state: (currents, states, block_frames).
    tail_by_state: (models, states, tail_points): excursion after a state, if the input is 0.
    reach: (models,): largest excursion from rest for any input within ±1.
    swing: (models,): amplitude of a free oscillation, as a share of the limit less a margin, for a
        state of norm 1. swing_m: the same for the identified model, with the amplitude in m.
    last_kick: (models,): see `DriveModel`.
    ring: (models,): largest excursion after an amplifier state of norm 1, if the input is 0.
    """
    believed, states, volts = drives[0].model, drives[0].states, drives[0].volts
    stride = max(1, int(drives[0].samplerate // _WATCHED_HZ))
    slack_m, tail_slack_m = _slacks_m(drives, excursion_m, stride)
    share = 1.0 / (excursion_m - slack_m)
    tail_share = 1.0 / (excursion_m - slack_m - tail_slack_m)
    # counted back from the last frame of the block
    watched = np.arange(block_frames - 1, -1, -stride)[::-1]
    steps = []  # states after an impulse, last frame first; powers 1 to block_frames of `step`
    for drive in drives:
        powers = [np.eye(drive.states)]
        for _ in range(block_frames):
            powers.append(drive.step @ powers[-1])
        impulse = np.array([power @ drive.drive for power in powers[:-1]])[::-1]
        steps.append((impulse, np.array(powers[1:])))
    unmoved_ohm = believed.resistance_ohm + drives[0].source_impedance_ohm
    rows = [volts / unmoved_ohm * np.eye(states)[LAST]]
    rows += [drive.i_row for drive in drives[:current_models]]
    currents = [(*step, row) for step, row in zip([steps[0], *steps], rows, strict=False)]
    tails = [_tail(drive, block_frames).T * tail_share for drive in drives]
    # zeros for models with fewer points
    tail_points = max(tail.shape[1] for tail in tails)
    pairs = list(zip(drives, steps, strict=True))
    return {
        "models": len(drives),
        "states": states,
        "frames": block_frames,
        "watched": len(watched),
        "stride": stride,
        "tail_points": tail_points,
        "currents": len(currents),
        "excursion_by_drive": _padded([i @ drive.x_row * share for drive, (i, _) in pairs], LANES),
        "excursion_by_state": _padded(
            [(drive.x_row @ after[watched] * share).T for drive, (_, after) in pairs]
        ),
        "state_by_drive": _padded([impulse.T for impulse, _ in steps], LANES),
        "state_by_state": _padded([after[-1].T for _, after in steps]),
        "current_by_drive": _padded([impulse @ row for impulse, _, row in currents], LANES),
        "current_by_state": _padded([(row @ after).T for _, after, row in currents]),
        "tail_by_state": _padded(
            [np.pad(tail, ((0, 0), (0, tail_points - tail.shape[1]))) for tail in tails]
        ),
        "reach": _reachable(share * volts, [drive.reach("displacement_m") for drive in drives]),
        "swing": share / np.sqrt([drive.model.stiffness_n_per_m for drive in drives]),
        "swing_m": 1.0 / math.sqrt(believed.stiffness_n_per_m),
        "last_kick": np.array([drive.last_kick for drive in drives]),
        "ring": _reachable(share * volts, [drive.ring() for drive in drives]),
    }


def _padded(rows: Sequence[FloatArray], least: int = 0) -> FloatArray:
    """Append `least` or more zeros to each row, so that its length is a multiple of `LANES`."""
    table = np.array(rows)
    numbers = table.shape[-1]
    zeros = -(-(numbers + least) // LANES) * LANES - numbers
    return np.pad(table, [(0, 0)] * (table.ndim - 1) + [(0, zeros)])


def _reachable(factor: float, reaches: Sequence[float]) -> FloatArray:
    return np.minimum(factor * np.array(reaches), _UNREACHABLE)


def _slacks_m(drives: Sequence[DriveModel], limit_m: float, stride: int) -> tuple[float, float]:
    """Return the largest rises of excursion, m, between computed frames: in a block, in the tail.

    Between a peak and the nearest computed frame, the excursion changes by at most half the
    acceleration times the squared time. In the tail (the free oscillation), friction has no effect,
    as the speed is 0 at a peak. The limit of the tail is reduced by both rises.
    """
    worst_m, tail_m = 0.0, 0.0
    for drive in drives:
        model, rate = drive.model, drive.samplerate
        spring = model.resonance_rad_s**2 * limit_m
        coil = model.force_factor_n_per_a * drive.volts / model.resistance_ohm
        coil /= model.moving_mass_kg
        within_s = stride / rate / 2.0
        tail_s = max(1.0 / rate, 1.0 / model.resonance_hz / _TAIL_POINTS) / 2.0
        braked = spring * (1.0 + 1.0 / model.q_total())
        worst_m = max(worst_m, (braked + coil) * within_s**2 / 2.0)
        tail_m = max(tail_m, (spring + coil) * tail_s**2 / 2.0)
    # Only the lowest sample rates need this upper bound; half of the limit then remains.
    return min(worst_m, limit_m / 4.0), min(tail_m, limit_m / 4.0)


def _tail(drive: DriveModel, block_frames: int) -> FloatArray:
    """Return rows that give x in m over 1.25 periods of free oscillation, (points, states).

    The points' interval divides the length of a block, so the next block computes the same points.
    """
    rate, hz = drive.samplerate, drive.model.resonance_hz
    wanted = max(1.0, rate / hz / _TAIL_POINTS)
    gap = max(d for d in range(1, block_frames + 1) if block_frames % d == 0 and d <= wanted)
    stride = np.linalg.matrix_power(drive.step, gap)
    rows = [drive.x_row]
    for _ in range(math.ceil(_TAIL_PERIODS * rate / hz / gap)):
        rows.append(rows[-1] @ stride)
    return np.array(rows)
