"""A rig's calibration: sweeps from low to the wanted level, then everything that follows.

Nothing here knows whether a twin or a real rig answers: whoever measures is a `Laboratory`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from device.identification.acceleration import Mode, identify_mode
from device.identification.bench import LARGEST_SHARE
from device.identification.impedance import Impedance, identify_impedance
from device.identification.moving_mass import ForceFactor, by_acceleration
from device.identification.recording import IdentificationError, Recording
from device.identification.rig_values import Values, with_identified
from device.identification.sweep import Sweep
from device.rig.rig import Rig

STEPS = (0.25, 0.5, 1.0)
"""Of the wanted level: what is wrong at a quarter of it never becomes loud."""
_UNEXPECTED = 1.3
"""A response may grow by this factor more or less than the level does."""
_PAIRS = (("current", "acceleration"), ("voltage", "current"), ("voltage", "acceleration"))


class Laboratory(Protocol):
    """Whoever plays a sweep and reads what comes of it."""

    def measure(self, sweep: Sweep, pairs: Sequence[tuple[str, str]]) -> list[Recording]:
        """One recording a pair (reference, response), all of the same sweep."""
        ...


@dataclass(frozen=True)
class Calibration:
    """What came of it. rig: with the identified values; values: by parameter, with intervals.

    mode: against the current; driven: under the voltage; force_factor: None on a seat that gives
    way; sweep: the loudest.
    """

    rig: Rig
    values: Values
    mode: Mode
    driven: Mode
    impedance: Impedance
    force_factor: ForceFactor | None
    sweep: Sweep


def calibrate(
    laboratory: Laboratory,
    rig: Rig,
    sweep: Sweep,
    tell: Callable[[float], None] = lambda level: None,
) -> Calibration:
    """Play the sweep at a quarter, half and all of its level; tell: called with each before it.

    Raises
    ------
    IdentificationError
        Something clips or is not as expected, and nothing louder was played; or a value is not
        identified. Then there is no number at all.
    """
    recordings: list[Recording] = []
    for step in STEPS:
        louder = replace(sweep, level=step * sweep.level)
        tell(louder.level)
        before, recordings = recordings, laboratory.measure(louder, _PAIRS)
        for recording in recordings:
            recording.check()
        for quiet, loud in zip(before, recordings, strict=False):
            _compare(quiet, loud)
    x_max_m = rig.actuator.x_max_m
    mode = identify_mode(recordings[0], x_max_m, "current")
    if mode.level_of_x_max > 1.1 * LARGEST_SHARE:
        raise IdentificationError(
            f"the sweep moved {mode.level_of_x_max:.2f} Xmax, at most {LARGEST_SHARE} is allowed: "
            f"rig {rig.name!r} moves more than it says; lower the level"
        )
    driven = identify_mode(recordings[2], x_max_m, "voltage")
    impedance = identify_impedance(recordings[1], level_of_x_max=mode.level_of_x_max)
    values: Values = {
        "actuator.resonance_hz": mode.f0_hz,
        "actuator.q_mechanical": mode.q,
        "actuator.resistance_ohm": impedance.resistance_ohm,
        "actuator.inductance_h": impedance.inductance_h,
    }
    force_factor = None
    if not (mode.on_seat or driven.on_seat or impedance.on_seat):
        force_factor = by_acceleration(impedance, mode)
        values["actuator.force_factor_n_per_a"] = force_factor.force_factor_n_per_a
        values["actuator.moving_mass_kg"] = force_factor.moving_mass_kg
    where = "on a seat that gives way" if force_factor is None else "on solid ground"
    words = f"sweep of {sweep.duration_s:g} s at {mode.level_of_x_max:.3f} Xmax, {where}"
    identified = with_identified(rig, values, words)
    return Calibration(identified, values, mode, driven, impedance, force_factor, sweep)


def _compare(quiet: Recording, loud: Recording) -> None:
    """Refuse a response that does not grow as the level does."""
    ratio = loud.sweep.level / quiet.sweep.level
    grown = float(np.std(loud.response) / np.std(quiet.response))
    if not ratio / _UNEXPECTED <= grown <= ratio * _UNEXPECTED:
        raise IdentificationError(
            f"{loud.names[1]} grew by {grown:.3g} where the level grew by {ratio:.3g}: something "
            "rattles, limits, or is not the rig that is described; stay below level "
            f"{quiet.sweep.level:.3g}, and find out what it is"
        )
