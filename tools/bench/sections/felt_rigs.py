"""Rows for the report: films that are played on the simulated rigs of this project."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import soundfile

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.offline.render import render_file
from audioflinger_hook.transform import FloatArray, TransformParameters
from device.drive.settings import DAMPING
from device.rig.electronics import ACCELERATION_FULL_SCALE_M_S2
from device.rig.rig import SHIPPED
from tools.bench.measures.contrasts import (
    STEPS_A_SECOND,
    felt_levels_db,
    loud_db,
    steps,
    strokes_db,
)
from tools.bench.methods import Method
from tools.bench.report import Row
from tools.bench.sounds.films import Film
from tools.bench.sounds.signals import SAMPLERATE

OVER_DB = 4.0


def rig_rows(profiles: Sequence[Method], films: Sequence[Film]) -> Iterator[Row]:
    """Yield the level of explosions relative to dialogue, for each rig and each kind of damping.

    Profiles with the parameter `strength = "felt"` are measured with `strength = "rig"`.
    """
    for rig in SHIPPED:
        for damping in DAMPING:
            for profile in profiles:
                assert profile.parameters
                over = [over_dialogue(each, rig, damping, profile.parameters) for each in films]
                title = f"on the seat of rig {rig}, damping {damping}: explosions over dialogue"
                must = profile.must_of_whole(">=", OVER_DB)
                yield Row(
                    title, float(np.mean(over)), "dB", profile.name, must, min(over), max(over)
                )


def over_dialogue(film: Film, rig: str, damping: str, parameters: TransformParameters) -> float:
    """Return the perceived level of explosions on the seat, relative to dialogue, in dB."""
    moved = acceleration(film.sound[: film.action.stop], rig, damping, parameters)
    levels = felt_levels_db(moved, SAMPLERATE)
    strokes = np.array(film.strokes) * (STEPS_A_SECOND / SAMPLERATE)
    dialogue = loud_db(levels[steps(film.dialogue, SAMPLERATE)])
    return float(strokes_db(levels, strokes).mean()) - dialogue


def acceleration(
    sound: FloatArray, rig: str, damping: str, parameters: TransformParameters
) -> FloatArray:
    """Return the acceleration of the seat in m/s^2, (frames,), as `cushion render` predicts it."""
    if parameters.strength == "felt":
        parameters = replace(parameters, strength="rig")
    settings = Settings(rig=rig, damping=damping, parameters=parameters)
    with tempfile.TemporaryDirectory() as folder:
        source, target, moved = (Path(folder) / f"{name}.wav" for name in ("in", "out", "moved"))
        soundfile.write(source, sound.astype(np.float32), SAMPLERATE, "FLOAT", format="WAVEX")
        render_file(source, target, settings, acceleration=moved)
        found, _ = soundfile.read(moved, dtype="float64", always_2d=True)
    return np.asarray(ACCELERATION_FULL_SCALE_M_S2 * found[:, 0])
