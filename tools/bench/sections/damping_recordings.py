"""Bench on damping with real sound: how far the seat's acceleration is from the intended one.

Intended is the acceleration of the same rig if it did not ring: the linear actuator as believed,
its resonance replaced by one at the same frequency that is damped critically (Q 0.5), driven by
the vibration that the transform made of the recording. Above the resonance that is in proportion
to the vibration itself; below it falls as that of every actuator on a voltage does. The error is
what the rig's acceleration differs by, r.m.s. over that of the intended one, when the intended one
has the gain of least squares: a recording that is felt weaker or stronger as a whole is not wrong.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from audioflinger_hook.transform import FloatArray
from device.drive.damping import Damper, FlatInverse, inverse_damping
from device.drive.damping.large_bursts import driven_by, intended
from device.rig import PAPER
from device.rig.actuator import LinearActuator
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.model_levels import ModelLevel
from device.rig.perturbed_rigs import detune
from device.units import amplitude_to_db
from tools.bench.report import Row, Section
from tools.bench.sections.damping_levels import Way, ways
from tools.bench.workbench import LIVE, Workbench

TITLE = "Damping on recordings"
LEVELS = (0.1, 0.5, 1.0)
"""Largest intended excursion of a recording, in Xmax."""
DETUNINGS = (0.0, -0.1, 0.1)
WANTED_Q = 0.5
LONGEST_S = 1.0
SHARE = 0.25
"""Of the seconds of signal that rigs are tried with: every one is played three dozen times."""
FAINTEST = 1e-3
"""Peak of a vibration, of full scale, under which there is nothing to be felt."""


@dataclass(frozen=True)
class Felt:
    """One recording: its name, vibration and intended acceleration, (frames,) each, and Hz."""

    name: str
    vibration: FloatArray
    wanted_m_s2: FloatArray
    samplerate: int

    @property
    def duration_s(self) -> float:
        """How long it is."""
        return len(self.vibration) / self.samplerate


def damping_on_recordings(bench: Workbench) -> Section:
    """Acceleration error of each way of driving, at each level: median and worst recording."""
    explanation = (
        "Vibration that the live transform made of the recordings (each up to "
        f"{LONGEST_S:g} s), played on the `paper` rig's non-linear rung, scaled so that the linear "
        "rung would reach the given share of Xmax. The error is the r.m.s. of what the "
        "acceleration differs from the intended one by, over the r.m.s. of that: the same "
        "actuator, linear and damped critically, with the gain of least squares. Above 0 dB "
        "most of the acceleration is ringing. Better than voltage drive: recordings whose error "
        "is smaller than with voltage drive alone."
    )
    if not bench.recordings:
        return Section(TITLE, explanation, (), (bench.missing_recordings("damping"),))
    felt = list(_felt(bench))
    rows, series = [], {}
    for level in LEVELS:
        errors = {way.name: _errors_db(way, level, felt) for way in ways()}
        plain = errors["voltage drive"]
        for name, db in errors.items():
            row = f"{level:g} Xmax, {name}"
            exact, worst_f0 = db[:, 0], db.max(axis=1)
            better = int(np.count_nonzero(exact < plain[:, 0]))
            worst = int(exact.argmax())
            rows += [
                Row(row, float(np.median(exact)), "dB", "median", note=felt[worst].name),
                Row(row, float(exact.max()), "dB", "worst recording, see the note"),
                Row(row, float(np.median(worst_f0)), "dB", "median, f0 ±10 %"),
                Row(row, float(worst_f0.max()), "dB", "worst recording, f0 ±10 %"),
                Row(row, better, f"of {len(felt)}", "better than voltage drive"),
            ]
            series[row] = tuple(exact.tolist())
    names = ", ".join(item.name for item in felt)
    return Section(TITLE, explanation, tuple(rows), series=series, footnote=f"Recordings: {names}.")


def _felt(bench: Workbench) -> Iterator[Felt]:
    """Yield recordings, of each kind in turn, until there is enough; of silent ones none."""
    left_s = SHARE * bench.effort.rig_s
    kinds: dict[str, int] = {}
    turns = []
    for recording in bench.recordings:
        kinds[recording.kind] = kinds.get(recording.kind, 0) + 1
        turns.append((kinds[recording.kind], recording.kind, recording))
    for _, _, recording in sorted(turns, key=itemgetter(0, 1)):
        if left_s <= 0.0:
            return
        rate = recording.samplerate
        frames = recording.frames[: round(LONGEST_S * rate)]
        vibration = np.asarray(bench.subject(LIVE).vibration(frames, rate), np.float64)
        if np.abs(vibration).max() >= FAINTEST:
            felt = Felt(recording.name, vibration, _wanted(vibration, rate), rate)
            left_s -= felt.duration_s
            yield felt


def _wanted(vibration: FloatArray, samplerate: int) -> FloatArray:
    """The acceleration of the rig that does not ring."""
    damping = inverse_damping(PAPER.actuator, WANTED_Q)
    drive = Damper(damping, samplerate, 1).process(vibration[:, None].copy())[:, 0]
    actuator = LinearActuator(PAPER.actuator, samplerate)
    return actuator.move(drive.astype(np.float64), ("acceleration_m_s2",)).acceleration_m_s2


def _errors_db(way: Way, level: float, felt: list[Felt]) -> FloatArray:
    """(recordings, detunings)."""
    return np.array([[_error_db(way, level, f, share) for share in DETUNINGS] for f in felt])


def _error_db(way: Way, level: float, felt: Felt, detuning: float) -> float:
    excursion_m = level * PAPER.actuator.x_max_m
    believed = driven_by(PAPER, way.damping.source_impedance_ohm)
    true = replace(believed, actuator=detune(PAPER.actuator, detuning))
    rate = felt.samplerate
    drive = intended(believed, way.damping, felt.vibration, excursion_m, rate)
    if way.flat:
        drive = FlatInverse(believed, rate).process(drive)
    ladder = AdaptiveActuator(true, rate, level=ModelLevel.NONLINEAR)
    got = ladder.move(drive, ("acceleration_m_s2",)).acceleration_m_s2
    return error_db(got, felt.wanted_m_s2)


def error_db(got: FloatArray, wanted: FloatArray) -> float:
    """Return the r.m.s. of got - g wanted over that of g wanted, g by least squares.

    Both (frames,). It is the tangent of the angle between the two: above 0 dB most of what is got
    is not what was wanted.
    """
    share = float(got @ wanted) ** 2 / (float(got @ got) * float(wanted @ wanted))
    return amplitude_to_db(float(np.sqrt(max(1.0 / share - 1.0, 1e-30))))
