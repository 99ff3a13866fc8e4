"""Designs of the core as bytes: the transform, the mix of its sources, and the drives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from audioflinger_hook.core import blob
from audioflinger_hook.core.rounding import round_number, round_table
from device.units import FloatArray, Record, Records

if TYPE_CHECKING:
    from device.drive.design import DriveDesign

EXACT_BITS = 44  # significant bits of a filter's coefficient: fewer would move its poles
EXACT = ("sections", "_fir", "decimation")  # names of tables that are rounded one by one


def core_design(
    samplerate: int,
    inputs: int,
    *,
    transform: Records | None = None,
    each: bool = False,
    mixes: Sequence[FloatArray] = (),
    drives: Sequence[DriveDesign | None] = (),
    delay_frames_max: int = 0,
) -> bytes:
    """Return the bytes of a design.

    samplerate: Hz. inputs: channels of the sound, or of the vibration without a transform.
    transform: of `LiveDesign.records`, None for none. each: one vibration for each channel, not one
    of their mono mix. mixes: for each source, the weights of the channels in the mean of its halves
    and in half their difference, (2, inputs); () without sources. drives: what is done for each
    actuator's rig; () for the vibration itself. delay_frames_max: longest delay of an actuator.
    """
    records: Records = {**(transform or {})}
    records |= {"samplerate": samplerate, "inputs": inputs, "per_channel": int(each)}
    if len(mixes):
        records |= {"sources": len(mixes), "source_weights": np.array(mixes).ravel()}
    if drives:
        different = list(dict.fromkeys(drive for drive in drives if drive is not None))
        numbers = [-1 if drive is None else different.index(drive) for drive in drives]
        records |= {
            "actuators": len(drives),
            "drives": len(different),
            "delay_frames_max": delay_frames_max,
            "drive_of_actuator": np.array(numbers, np.float64),
        }
        for number, drive in enumerate(different):
            for name, value in drive.records.items():
                records[f"{number}/{name}"] = _rounded(name, value)
    return blob.pack(records)


def _rounded(name: str, value: Record) -> Record:
    """Return a value of a drive with the same bits on every machine."""
    if isinstance(value, int):
        return value
    if isinstance(value, float):
        return round_number(value)
    if not name.endswith(EXACT):
        return round_table(value).ravel()
    return np.array([round_number(entry, EXACT_BITS) for entry in value.ravel().tolist()])
