"""Packs the numbers of transform, mixes and actuators into a design, the input of the core."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from audioflinger_hook.core import blob
from audioflinger_hook.core.rounding import round_number, round_table
from device.units import FloatArray, Record, Records

if TYPE_CHECKING:
    from device.drive.design import DriveDesign

EXACT_BITS = 44  # significant bits of each entry of a table whose name ends with one of EXACT
EXACT = ("sections", "_fir", "decimation")  # these tables contain filter coefficients


def core_design(
    samplerate: int,
    inputs: int,
    *,
    transform: Records | None = None,
    each: bool = False,
    mixes: Sequence[FloatArray] = (),
    drives: "Sequence[DriveDesign | None]" = (),
    delay_frames_max: int = 0,
) -> bytes:
    """Return the bytes of a design.

    samplerate: Hz. inputs: channels of the sound, or of the vibration if there is no transform.
    transform: from `LiveDesign.records`. each: whether each channel has its own vibration.
    mixes: weights (2, inputs) of each source, from `source_mixes`. drives: processing of each
    actuator, None for none. delay_frames_max: longest delay of an actuator.
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
    if isinstance(value, int):
        return value
    if isinstance(value, float):
        return round_number(value)
    if not name.endswith(EXACT):
        return round_table(value).ravel()
    return np.array([round_number(entry, EXACT_BITS) for entry in value.ravel().tolist()])
