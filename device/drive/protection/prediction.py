"""What a block of drive does to several linear models of one actuator, as tables.

Each model is the amplifier's band and one actuator behind it, as one step from sample to sample.
Half the square of the first three states is the actuator's stored energy.
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
"""Index in a state: x sqrt(k), x' sqrt(m), i sqrt(L), then the amplifier's last output as a share
of full scale, then two values for each of its sections."""

_FAR_ABOVE = 20.0
"""A low-pass this many times above the resonance is left out: it changes the level by 3e-6."""

_DECAYED = 25.0
_HORIZON_FRAMES = 1 << 20
LANES = 8  # the core reads groups of this many frames

_WATCHED_HZ = 6_000.0  # excursion is computed at least this often; `_slacks_m` bounds it in between
_TAIL_POINTS = 32
_TAIL_PERIODS = 1.25
_UNREACHABLE = 1e30  # in place of infinity, for a reach that is not computed


def amplifier_sections(
    amplifier: AmplifierParameters, models: Sequence[ActuatorParameters], samplerate: float
) -> FloatArray:
    """Return the sections of the amplifier's band that matter here: (n, 6), n 0 to 2."""
    highest_hz = max(model.resonance_hz for model in models)
    far = amplifier.high_cut_hz > _FAR_ABOVE * highest_hz
    high_cut_hz = np.inf if far else amplifier.high_cut_hz
    return Band(amplifier.low_cut_hz, high_cut_hz, samplerate).sections


class DriveModel:
    """One actuator model behind the amplifier: S[n] = step S[n-1] + drive u[n]. Immutable.

    Exact for a voltage that is straight between samples. Any thread may use it.

    sections: of the amplifier's band, (n, 6). volts: at the actuator for full scale.
    step, drive: (states, states) and (states,), for a drive of full scale 1.
    x_row, i_row: (states,): excursion in m and current in A of a state.
    last_kick: norm of the actuator's state after a last output of 1: the root of twice its energy.
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
        """Return the largest |quantity| per volt of peak drive: the sum of |impulse response|.

        Infinity if it decays too slowly; then every block is computed.
        """
        frames = self._horizon()
        if not frames:
            return math.inf
        impulse = np.zeros(frames)
        impulse[0] = 1.0
        if len(self._sections):
            impulse = scipy.signal.sosfilt(self._sections, impulse)
        # The remaining e^-25 is not in the sum.
        return float(np.abs(self._moved(impulse, quantity)).sum()) * (1.0 + 1e-9)

    def ring(self) -> float:
        """Return the largest |x|, m per volt, after an amplifier's state of length 1, undriven."""
        if not len(self._sections):
            return 0.0
        frames = self._horizon()
        if not frames:
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
        moved: FloatArray = getattr(actuator.move(volts, (quantity,)), quantity)
        return moved

    def _horizon(self) -> int:
        """Return the frames until all ringing has fallen to e^-25; 0 if too long to compute."""
        decay = math.pi * self.model.resonance_hz / self.model.q_total(self.source_impedance_ohm)
        # The amplifier's slowest pair of poles shrinks by e^-slow a second.
        radii = [math.sqrt(float(a2)) for a2 in self._sections[:, 5]]
        slow = min((-math.log(radius) * self.samplerate for radius in radii), default=math.inf)
        # The actuator rings after the amplifier.
        frames = math.ceil(_DECAYED * self.samplerate * (1.0 / decay + 1.0 / slow))
        return frames if frames <= _HORIZON_FRAMES else 0


@lru_cache(maxsize=64)
def _held(
    p: ActuatorParameters, samplerate: float, source_impedance_ohm: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the actuator's step, its input from the last and new volt, and the rows of x and i."""
    rate, drive, rows = state_space(p, source_impedance_ohm)
    held = first_order_hold(rate, drive, 1.0 / samplerate)
    return *held, rows["displacement_m"], rows["current_a"]


def _cascade(sections: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return (turn, enter, leave, through): q' = turn q + enter u, y = leave q + through u."""
    turn, enter, leave, through = np.zeros((0, 0)), np.zeros(0), np.zeros(0), 1.0
    for section in sections:
        own, entered, left, direct, _ = _section(section)
        corner = np.outer(entered, leave)
        turn = np.block([[turn, np.zeros((len(turn), 2))], [corner, own]])
        enter = np.concatenate([enter, entered * through])
        leave = np.concatenate([leave * direct, left])
        through *= direct
    return turn, enter, leave, through


def _section(
    section: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, float, FloatArray]:
    """Return a section as turn, enter, leave, through, and the base of its two states.

    In this base the state rotates and shrinks, and its length bounds the output.
    """
    b0, b1, b2, _, a1, a2 = section.tolist()
    own = np.array([[-a1, 1.0], [-a2, 0.0]])
    entered = np.array([b1 - a1 * b0, b2 - a2 * b0])
    values, vectors = np.linalg.eig(own)
    if abs(values[0].imag) > 0.0:
        shape = np.column_stack([vectors[:, 0].real, vectors[:, 0].imag])
    else:
        shape = vectors.real
    shape = shape / np.linalg.norm(shape[0])
    back = np.linalg.inv(shape)
    return back @ own @ shape, back @ entered, shape[0], b0, shape


def prediction_records(
    drives: Sequence[DriveModel], block_frames: int, excursion_m: float, current_models: int
) -> Records:
    """Return what a block of drive does to the models, by name; see `ProtectionDesign` of the core.

    Excursion is a share of the limit, less what it may rise between two frames; current is in A.
    Impulse responses are stored last frame first, and matrices by their columns.

    drives: rigs that the actuator may be; the believed one first. current_models: number whose
    current is limited.

    states: of one model. stride: frames between two whose excursion is computed, the last of a
        block among them; watched: their number. tail_points: of the free swing after a block.
    excursion_by_drive: (models, block_frames). excursion_by_state: (models, states, watched).
    state_by_drive: (models, states, block_frames). state_by_state: (models, states, states).
    current_by_drive: (currents, block_frames), currents = 1 + current_models; the first is of a
        coil that nothing but its resistance holds back: no actuator's coil gets warmer.
    current_by_state: (currents, states, block_frames).
    tail_by_state: (models, states, tail_points): excursion after a state without drive.
    reach: (models,): largest excursion from rest that a drive within ±1 can cause.
    swing: (models,), swing_m: amplitude of a swing over the root of twice its energy, as a share of
        the limit, and of the believed model in m.
    last_kick: (models,): such a root for a last output of 1.
    ring: (models,): largest excursion that a state of length 1 of the amplifier can cause.
    """
    believed, states, volts = drives[0].model, drives[0].states, drives[0].volts
    stride = max(1, int(drives[0].samplerate // _WATCHED_HZ))
    slack_m, tail_slack_m = _slacks_m(drives, excursion_m, stride)
    share = 1.0 / (excursion_m - slack_m)
    tail_share = 1.0 / (excursion_m - slack_m - tail_slack_m)
    # Counted back from the last frame of the block.
    watched = np.arange(block_frames - 1, -1, -stride)[::-1]
    steps = [_responses(drive, block_frames) for drive in drives]
    unmoved_ohm = believed.resistance_ohm + drives[0].source_impedance_ohm
    rows = [volts / unmoved_ohm * np.eye(states)[LAST]]
    rows += [drive.i_row for drive in drives[:current_models]]
    currents = [(*step, row) for step, row in zip([steps[0], *steps], rows, strict=False)]
    tails = [_tail(drive, block_frames).T * tail_share for drive in drives]
    # Zeros where one model has fewer points than another.
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
    """Return a table whose rows end in `least` zeros, and more until they fill whole groups."""
    table = np.array(rows)
    numbers = table.shape[-1]
    zeros = -(-(numbers + least) // LANES) * LANES - numbers
    return np.pad(table, [(0, 0)] * (table.ndim - 1) + [(0, zeros)])


def _reachable(factor: float, reaches: Sequence[float]) -> FloatArray:
    return np.minimum(factor * np.array(reaches), _UNREACHABLE)


def _responses(drive: DriveModel, count: int) -> tuple[FloatArray, FloatArray]:
    """Return the state after an impulse, last frame first, and the step's powers 1 to `count`."""
    powers = [np.eye(drive.states)]
    for _ in range(count):
        powers.append(drive.step @ powers[-1])
    impulse = np.array([power @ drive.drive for power in powers[:-1]])[::-1]
    return impulse, np.array(powers[1:])


def _slacks_m(drives: Sequence[DriveModel], limit_m: float, stride: int) -> tuple[float, float]:
    """Return by how much excursion may rise between computed frames of a block, and of the tail, m.

    Half a step from a computed frame that is at most half the acceleration times the time squared.
    In the tail friction gives none, since the speed is 0 at the largest excursion. Later blocks
    compute the tail again at smaller steps, so that it needs both margins.
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
    # This only happens at the lowest rates; half of the limit is left then.
    return min(worst_m, limit_m / 4.0), min(tail_m, limit_m / 4.0)


def _tail(drive: DriveModel, block_frames: int) -> FloatArray:
    """Return x over one period of a free swing in m, (points, states); later it is smaller.

    An amplifier swings back for longer, but with a fifth of the effect. The distance of two points
    divides the length of a block, so that the next block computes the same points.
    """
    rate, hz = drive.samplerate, drive.model.resonance_hz
    wanted = max(1.0, rate / hz / _TAIL_POINTS)
    gap = max(d for d in range(1, block_frames + 1) if block_frames % d == 0 and d <= wanted)
    stride = np.linalg.matrix_power(drive.step, gap)
    rows = [drive.x_row]
    for _ in range(math.ceil(_TAIL_PERIODS * rate / hz / gap)):
        rows.append(rows[-1] @ stride)
    return np.array(rows)
