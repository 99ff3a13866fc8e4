"""Section on damping with recordings: how far the seat's acceleration is from the intended one.

Intended is the acceleration of a rig that does not ring: linear, at the same resonance, damped
critically (Q 0.5). The error is the r.m.s. difference from it, over its r.m.s., after the gain of
least squares; a recording that is weaker or stronger as a whole is not wrong.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from audioflinger_hook.transform import FloatArray
from device.drive.damping import Damper, FlatInverse
from device.drive.damping.design import inverse_damping
from device.rig import PAPER
from device.rig.actuator import LinearActuator
from device.rig.adaptive_actuator import AdaptiveActuator
from device.rig.model_levels import ModelLevel
from device.rig.parameters import detune
from device.units import amplitude_to_db
from tools.bench.measures.large_bursts import driven_by, intended
from tools.bench.report import Row, Section
from tools.bench.sections.damping import Drive, large_drives
from tools.bench.workbench import LIVE, Workbench

TITLE = "Damping on recordings"
LEVELS = (0.1, 0.5, 1.0)
"""Largest intended excursion of a recording, in Xmax."""
DETUNINGS = (0.0, -0.1, 0.1)
WANTED_Q = 0.5
LONGEST_S = 1.0
SHARE = 0.25
"""Of `Effort.rig_s`: every recording is played three dozen times."""
FAINTEST = 1e-3
"""Recordings whose vibration has a smaller peak, of full scale, are left out."""


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
        f"Vibration of the recordings (each up to {LONGEST_S:g} s) on the non-linear `paper` rig, "
        "scaled so that the linear model would reach the given share of Xmax. The error is the "
        "r.m.s. difference from the intended acceleration over its r.m.s.: that of the same "
        "actuator, linear and critically damped, with the gain of least squares. Above 0 dB most "
        "of the acceleration is ringing. The last column counts recordings with a smaller error "
        "than with voltage drive."
    )
    if not bench.recordings:
        return Section(TITLE, explanation, (), (bench.missing_recordings("damping"),))
    felt = list(_felt(bench))
    rows, series = [], {}
    for level in LEVELS:
        errors = {drive.name: _errors_db(drive, level, felt) for drive in large_drives()}
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
    """Yield recordings that can be felt, of each kind in turn, up to a total duration."""
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
    """Return the acceleration of the rig that does not ring."""
    damping = inverse_damping(PAPER.actuator, WANTED_Q)
    drive = Damper(damping, samplerate, 1).process(vibration[:, None].copy())[:, 0]
    actuator = LinearActuator(PAPER.actuator, samplerate)
    return actuator.move(drive.astype(np.float64), ("acceleration_m_s2",)).acceleration_m_s2


def _errors_db(drive: Drive, level: float, felt: list[Felt]) -> FloatArray:
    """Return the errors in dB, (recordings, detunings)."""
    return np.array([[_error_db(drive, level, f, share) for share in DETUNINGS] for f in felt])


def _error_db(drive: Drive, level: float, felt: Felt, detuning: float) -> float:
    excursion_m = level * PAPER.actuator.x_max_m
    believed = driven_by(PAPER, drive.damping.source_impedance_ohm)
    true = replace(believed, actuator=detune(PAPER.actuator, detuning))
    rate = felt.samplerate
    volts = intended(believed, drive.damping, felt.vibration, excursion_m, rate)
    if drive.flat:
        volts = FlatInverse(believed, rate).process(volts)
    ladder = AdaptiveActuator(true, rate, level=ModelLevel.NONLINEAR)
    got = ladder.move(volts, ("acceleration_m_s2",)).acceleration_m_s2
    return error_db(got, felt.wanted_m_s2)


def error_db(got: FloatArray, wanted: FloatArray) -> float:
    """Return the r.m.s. of got - g wanted over that of g wanted, g by least squares.

    It is the tangent of the angle between the two.
    """
    share = float(got @ wanted) ** 2 / (float(got @ got) * float(wanted @ wanted))
    return amplitude_to_db(float(np.sqrt(max(1.0 / share - 1.0, 1e-30))))
