"""A rig's calibration: sweeps from low to the wanted level, then everything that follows.

Nothing here knows whether a twin or a real rig answers: whoever measures is a `Laboratory`. What
can be identified depends on what it can measure; only that is given.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.fft import irfft

from device.identification.acceleration import Mode, identify_mode
from device.identification.impedance import Impedance, identify_impedance
from device.identification.mechanics import ForceFactor, by_acceleration, by_known_mass, mechanical
from device.identification.output_error import Estimate
from device.identification.recording import IdentificationError, Recording
from device.identification.rig_values import Values, with_identified, with_matched
from device.identification.simulated_laboratory import LARGEST_SHARE
from device.identification.sweep import Sweep
from device.identification.transfer import Quality, quality, transfer
from device.rig.rig import Rig

STEPS = (0.25, 0.5, 1.0)
"""Of the wanted level."""
TOO_FAR = 1.1 * LARGEST_SHARE
_UNEXPECTED = 1.3
"""A response may grow by this factor more or less than the level does."""


class Laboratory(Protocol):
    """Whoever plays a sweep and reads what comes of it."""

    def measure(self, sweep: Sweep, pairs: Sequence[tuple[str, str]]) -> list[Recording]:
        """One recording a pair (reference, response), all of the same sweep."""
        ...


def swept(
    laboratory: Laboratory,
    rig: Rig,
    sweep: Sweep,
    pairs: Sequence[tuple[str, str]],
    tell: Callable[[float], None],
    *,
    scaled: bool,
) -> list[Recording]:
    """The recordings of the last of STEPS; tell: called with each level before it is played.

    scaled: accelerations are in m/s^2, so that how far the next step would move is known.

    Raises
    ------
    IdentificationError
        Something clips or is not as expected; nothing louder was played.
    """
    recordings: list[Recording] = []
    for step, after in zip(STEPS, (*STEPS[1:], STEPS[-1]), strict=True):
        louder = replace(sweep, level=step * sweep.level)
        tell(louder.level)
        before, recordings = recordings, laboratory.measure(louder, pairs)
        for recording in recordings:
            recording.check()
        for quiet, loud in zip(before, recordings, strict=False):
            _compare(quiet, loud)
        for recording in recordings:
            if scaled and recording.names[1] == "acceleration":
                share = after / step * excursion_m(recording) / rig.actuator.x_max_m
                if share > TOO_FAR:
                    raise moves_too_far(rig, share)
    return recordings


def moves_too_far(rig: Rig, share: float) -> IdentificationError:
    """The error that a sweep moves, or the next would move, that share of Xmax."""
    return IdentificationError(
        f"a sweep of that level moves {share:.2f} Xmax, at most {LARGEST_SHARE} is allowed: "
        f"rig {rig.name!r} moves more than it says; lower the level"
    )


def excursion_m(recording: Recording) -> float:
    """Peak excursion that follows from a recorded acceleration, m, without any model.

    Twice integrated in the band, of what follows the reference linearly.
    """
    found, band = transfer(recording), recording.band
    spectrum = np.zeros(len(recording.frequencies_hz), complex)
    motion = found.response * recording.reference_spectrum[band]
    spectrum[band] = motion / -((2.0 * np.pi * found.frequencies_hz) ** 2)
    return float(np.abs(irfft(spectrum, recording.length)).max())


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


__all__ = ["ALL_PAIRS", "STEPS", "Calibration", "Laboratory", "calibrate"]

ALL_PAIRS = (("current", "acceleration"), ("voltage", "current"), ("voltage", "acceleration"))

COIL = ("force_factor_n_per_a", "resistance_ohm", "inductance_h", "moving_mass_kg")
"""What has to be known of an actuator for its mechanics to follow from its damped mode."""


@dataclass(frozen=True)
class Calibration:
    """What came of it; None where what was measured does not say it.

    values: by parameter, with intervals; rig: with them, None where none can be written, and
    why_not says why. mode: against the current; driven: under the voltage, or for what was played;
    force_factor: None on a seat that gives way, and without a scale or an impedance. sweep: the
    loudest. level_of_x_max: how far the mass moved at most, in Xmax; None where the acceleration
    has no scale, and then neither a sensitivity means anything. matched: f0 and Qms of `rig` are
    such that with its assumed coil the driven mode is the measured one; they are no `values`.
    qualities: of every recording.
    """

    rig: Rig | None
    values: Values
    mode: Mode | None
    driven: Mode | None
    impedance: Impedance | None
    force_factor: ForceFactor | None
    sweep: Sweep
    level_of_x_max: float | None = None
    matched: bool = False
    why_not: str = ""
    qualities: tuple[Quality, ...] = ()

    @property
    def on_seat(self) -> bool:
        """Whether a frame that gives way was needed to explain any response."""
        return any(found.on_seat for found in (self.mode, self.driven, self.impedance) if found)


def calibrate(
    laboratory: Laboratory,
    rig: Rig,
    sweep: Sweep,
    tell: Callable[[float], None] = lambda level: None,
    *,
    pairs: Sequence[tuple[str, str]] = ALL_PAIRS,
    scaled: bool = True,
    weighed: Estimate | None = None,
) -> Calibration:
    """Play the sweep at a quarter, half and all of its level; tell: called with each before it.

    pairs: what the laboratory can measure, of ALL_PAIRS and ("drive", "acceleration"). scaled: its
    accelerations are in m/s^2. weighed: the moving mass, kg, if it was.

    Raises
    ------
    IdentificationError
        Something clips or is not as expected, and nothing louder was played; or a value is not
        identified. Then there is no number at all.
    """
    recordings = swept(laboratory, rig, sweep, pairs, tell, scaled=scaled)
    there = {recording.names: recording for recording in recordings}
    mode = driven = impedance = level = None
    x_max_m = rig.actuator.x_max_m if scaled else float("inf")
    if recording := there.get(("current", "acceleration")):
        mode = identify_mode(recording, x_max_m, "current")
        level = mode.level_of_x_max if scaled else None
    if recording := there.get(("voltage", "acceleration")) or there.get(("drive", "acceleration")):
        driven = identify_mode(recording, x_max_m, "voltage")
        level = driven.level_of_x_max if scaled and level is None else level
    if level is not None and level > TOO_FAR:
        raise moves_too_far(rig, level)
    if recording := there.get(("voltage", "current")):
        impedance = identify_impedance(recording, level_of_x_max=level or 0.0)
    found = Calibration(
        None, {}, mode, driven, impedance, None, sweep, level,
        qualities=tuple(quality(recording) for recording in recordings),
    )  # fmt: skip
    if impedance is None and mode is None:
        return _by_the_coil(found, rig, there)
    return _directly(found, rig, scaled, weighed)


def _directly(found: Calibration, rig: Rig, scaled: bool, weighed: Estimate | None) -> Calibration:
    """With what the current says, which needs nothing that the rig's file says."""
    mode, impedance, force_factor = found.mode, found.impedance, None
    values: Values = {}
    if mode is not None:
        values |= {"actuator.resonance_hz": mode.f0_hz, "actuator.q_mechanical": mode.q}
    elif impedance is not None:
        values["actuator.resonance_hz"] = impedance.f0_hz
        values["actuator.q_mechanical"] = impedance.q_mechanical
    if impedance is not None:
        values["actuator.resistance_ohm"] = impedance.resistance_ohm
        values["actuator.inductance_h"] = impedance.inductance_h
        if weighed is not None and not found.on_seat:
            force_factor = by_known_mass(impedance, weighed)
        elif mode is not None and scaled and not found.on_seat:
            force_factor = by_acceleration(impedance, mode)
    if force_factor is not None:
        values["actuator.force_factor_n_per_a"] = force_factor.force_factor_n_per_a
        values["actuator.moving_mass_kg"] = force_factor.moving_mass_kg
    identified = with_identified(rig, values, _words(found))
    return replace(found, rig=identified, values=values, force_factor=force_factor)


def _by_the_coil(
    found: Calibration, rig: Rig, there: dict[tuple[str, str], Recording]
) -> Calibration:
    """With the acceleration alone: the mechanics follow as far as the rig's coil is known."""
    assert found.driven is not None
    driving = rig
    if ("drive", "acceleration") in there:  # the amplifier's output damps less than the terminals
        ohms = rig.actuator.resistance_ohm + rig.amplifier.source_impedance_ohm
        driving = replace(rig, actuator=replace(rig.actuator, resistance_ohm=ohms))
    try:
        mechanics = mechanical(found.driven, driving)
    except IdentificationError as error:
        return replace(found, why_not=str(error))
    values: Values = {
        "actuator.resonance_hz": mechanics.f0_hz,
        "actuator.q_mechanical": mechanics.q_mechanical,
    }
    assumed = [name for name in COIL if f"actuator.{name}" in rig.assumed()]
    if not assumed:
        return replace(found, rig=with_identified(rig, values, _words(found)), values=values)
    driven = found.driven
    words = (
        f"with the assumed {', '.join(assumed)} it gives the mode that was identified, "
        f"{driven.f0_hz.value:.2f} Hz with Q {driven.q.value:.2f}: {_words(found)}"
    )
    return replace(found, rig=with_matched(rig, values, words), matched=True)


def _words(found: Calibration) -> str:
    level = found.level_of_x_max
    how_far = f"{found.sweep.level:.3g} of full scale" if level is None else f"{level:.3f} Xmax"
    where = "on a seat that gives way" if found.on_seat else "on solid ground"
    return f"sweep of {found.sweep.duration_s:g} s at {how_far}, {where}"
