"""The amplifier's band and one actuator behind it, as one step from sample to sample."""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import scipy

from device.rig import ActuatorParameters
from device.rig.actuator import LinearActuator, Quantity, first_order_hold, state_space
from device.rig.electronics import Band
from device.rig.parameters import AmplifierParameters
from device.units import FloatArray

ACTUATOR_STATES = 3
LAST = ACTUATOR_STATES
"""Index in a state: x sqrt(k), x' sqrt(m), i sqrt(L), then the amplifier's last output as a share
of full scale, then two values for each of its sections."""

_FAR_ABOVE = 20.0
"""A low-pass this many times above the resonance is left out: it changes the level there by 3e-6,
and the delay that it adds makes no excursion larger."""

_DECAYED = 25.0
_HORIZON_FRAMES = 1 << 20


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

    model: the actuator. samplerate: Hz. source_impedance_ohm: of the amplifier. sections: of its
    band, (n, 6). volts: at the actuator for full scale.
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


@lru_cache(maxsize=64)  # as in rig/actuator.py
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

    In this base the state rotates and shrinks, and its length bounds the output. In the usual one,
    with poles close to 1, the two states nearly cancel and bound nothing.
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
