"""An amplifier's band and one actuator behind it as one step from sample to sample.

What the governor predicts is what the actuator does with the drive; but between the two stands an
amplifier, whose high-pass turns the phase of low vibration, bends what begins suddenly and swings
back for a tenth of a second when it ends. So its state belongs to the model, as the filter that
the twin's amplifier is (rig/band.py).
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.signal import sosfilt

from device.rig import ActuatorParameters
from device.rig.actuator import first_order_hold, state_space
from device.rig.electronics import Band
from device.rig.parameters import AmplifierParameters
from device.units import FloatArray

ACTUATOR_STATES = 3
LAST = ACTUATOR_STATES
"""Of a chain's state: x sqrt(k), x' sqrt(m), i sqrt(L), then the amplifier's last output, as a
share of full scale, then two of each of its sections."""

_FAR_ABOVE = 20.0
"""A low-pass so many times above the resonance changes the vibration's size there by 3e-6; it
comes later, and that makes no excursion larger."""


def amplifier_sections(
    amplifier: AmplifierParameters, models: Sequence[ActuatorParameters], samplerate: float
) -> FloatArray:
    """(n, 6): the sections of the amplifier's band that matter to these actuators, n 0 to 2."""
    highest_hz = max(model.resonance_hz for model in models)
    far = amplifier.high_cut_hz > _FAR_ABOVE * highest_hz
    high_cut_hz = np.inf if far else amplifier.high_cut_hz
    return Band(amplifier.low_cut_hz, high_cut_hz, samplerate).sections


class Chain:
    """One model behind the amplifier; immutable. Any thread may use it.

    sections: of the amplifier, (n, 6); volts: at the actuator for full scale.

    step: (states, states) and drive: (states,), S[n] = step S[n-1] + drive u[n] for a drive u of
    full scale 1; exact for a voltage that is straight between samples. x_row, i_row: (states,),
    excursion in m and current in A of a state.
    """

    def __init__(
        self,
        model: ActuatorParameters,
        samplerate: float,
        source_impedance_ohm: float,
        sections: FloatArray,
        volts: float,
    ) -> None:
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
        """Norm of the actuator's state that a last output of 1 leaves: root of twice its energy."""


def rings(sections: FloatArray, frames: int) -> FloatArray:
    """(2 n, frames): what the amplifier gives out, with no drive, from each state of 1."""
    shapes = [_section(section)[4] for section in sections]
    given = []
    for at, shape in enumerate(shapes):
        for column in shape.T:
            state = np.zeros((len(sections), 2))
            state[at] = column
            given.append(sosfilt(sections, np.zeros(frames), zi=state)[0])
    return np.array(given)


@lru_cache(maxsize=64)  # as in rig/actuator.py
def _held(
    p: ActuatorParameters, samplerate: float, source_impedance_ohm: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """The actuator's own step, by its last and its new volt, and what x and i are of its state."""
    rate, drive, rows = state_space(p, source_impedance_ohm)
    held = first_order_hold(rate, drive, 1.0 / samplerate)
    return *held, rows["displacement_m"], rows["current_a"]


def _cascade(sections: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """(turn, enter, leave, through): q' = turn q + enter u, y = leave q + through u."""
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
    """A section as turn, enter, leave and through, and its own two states by those of `turn`.

    States in which it turns and shrinks, whose length is at least what it gives out: as it comes,
    with poles close to 1, its two states nearly cancel, and no bound by them would be good.
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
