"""Calibration: plays a sweep at a quarter, half and all of its level, and identifies the rig."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from device.identification import mechanics, transfer
from device.identification.acceleration import Mode, identify_mode
from device.identification.impedance import Drive, Impedance, identify_drive, identify_impedance
from device.identification.output_error import Estimate
from device.identification.recording import PLAYED, IdentificationError, Recording, Sweep
from device.identification.simulated_laboratory import LARGEST_SHARE
from device.rig.parameters import DriveMode
from device.rig.rig import MIN_CURRENT_DRIVE_RATIO, Rig, Source

STEPS = (0.25, 0.5, 1.0)  # successive levels, relative to the wanted level
_UNEXPECTED = 1.3  # largest factor, either way, between a response's growth and the level's


class Laboratory(Protocol):
    """Plays a sweep and records the response."""

    def measure(self, sweep: Sweep, pairs: Sequence[tuple[str, str]]) -> list[Recording]:
        """Play once; return one recording for each pair (reference, response)."""


def play_steps(
    laboratory: Laboratory,
    rig: Rig,
    sweep: Sweep,
    pairs: Sequence[tuple[str, str]],
    on_level: Callable[[float], None],
    *,
    scaled: bool,
) -> list[Recording]:
    """Play the sweep at each of STEPS; return the recordings of the last step.

    scaled: as for `calibrate`. IdentificationError: a recording is invalid, a response does not
    grow in proportion to the level, or (if scaled) the next step would move the actuator too far.
    """
    recordings: list[Recording] = []
    for step, after in zip(STEPS, (*STEPS[1:], STEPS[-1]), strict=True):
        louder = replace(sweep, level=step * sweep.level)
        on_level(louder.level)
        before, recordings = recordings, laboratory.measure(louder, pairs)
        for recording in recordings:
            transfer.check_recording(recording)
        for quiet, loud in zip(before, recordings, strict=False):
            ratio = loud.sweep.level / quiet.sweep.level
            grown = float(np.std(loud.response) / np.std(quiet.response))
            if not ratio / _UNEXPECTED <= grown <= ratio * _UNEXPECTED:
                raise IdentificationError(
                    f"{loud.names[1]} grew by {grown:.3g}, but the level by {ratio:.3g}: something "
                    "rattles or limits, or the rig's file describes another rig; find the reason, "
                    f"or stay below level {quiet.sweep.level:.3g}"
                )
        for recording in recordings:
            if scaled and recording.names[1] == "acceleration":
                moved_m = recording.excursion_m(transfer.estimate_transfer(recording).response)
                share = after / step * moved_m / rig.actuator.x_max_m
                if share > 1.1 * LARGEST_SHARE:
                    raise IdentificationError(
                        f"a sweep of that level moves {share:.2f} Xmax, at most {LARGEST_SHARE} is "
                        f"allowed: rig {rig.name!r} moves more than it says; lower the level"
                    )
    return recordings


ALL_PAIRS = (
    ("current", "acceleration"),
    ("voltage", "current"),
    ("voltage", "acceleration"),
    (PLAYED, "voltage"),
)

# parameters that are needed to compute f0 and Qms from the damped resonance
COIL = ("force_factor_n_per_a", "resistance_ohm", "inductance_h", "moving_mass_kg")


@dataclass(frozen=True)
class Calibration:
    """The result of `calibrate`; a field is None if the measurement does not determine it."""

    rig: Rig | None  # with the identified values; None if no rig can be written
    values: mechanics.Values
    mode: Mode | None  # from acceleration per current
    driven: Mode | None  # from acceleration per voltage, or per "drive" (see `live.laboratory`)
    impedance: Impedance | None
    sweep: Sweep  # the loudest sweep
    level_of_x_max: float | None = None  # largest excursion relative to Xmax; None if unknown
    matched: bool = False  # f0 and Qms rely on the rig's assumed coil, so they are not in `values`
    why_not: str = ""  # why there is no rig
    qualities: tuple[transfer.Quality, ...] = ()  # of every recording
    drive: Drive | None = None  # from samples to volts at the coil

    @property
    def on_seat(self) -> bool:
        """Whether the actuator's frame moves, from `mode`, else `impedance`, else `driven`."""
        shown = self.mode or self.impedance or self.driven
        return shown is not None and shown.on_seat


def calibrate(
    laboratory: Laboratory,
    rig: Rig,
    sweep: Sweep,
    on_level: Callable[[float], None] = lambda level: None,
    *,
    pairs: Sequence[tuple[str, str]] = ALL_PAIRS,
    scaled: bool = True,
    weighed: Estimate | None = None,
) -> Calibration:
    """Play the sweep at a quarter, half and all of its level, and identify the rig.

    on_level: called with each level before it is played. pairs: pairs to measure, of ALL_PAIRS and
    ("drive", "acceleration"). scaled: whether accelerations are in m/s^2. weighed: moving mass, kg;
    None if not weighed. IdentificationError: a check fails; no higher level is then played.
    """
    recordings = play_steps(laboratory, rig, sweep, pairs, on_level, scaled=scaled)
    there = {recording.names: recording for recording in recordings}
    mode = driven = impedance = level = drive = None
    x_max_m = rig.actuator.x_max_m if scaled else float("inf")
    if recording := there.get(("current", "acceleration")):
        mode = identify_mode(recording, x_max_m)
        level = mode.level_of_x_max if scaled else None
    if recording := there.get(("voltage", "acceleration")) or there.get(("drive", "acceleration")):
        driven = identify_mode(recording, x_max_m, on_seat=mode.on_seat if mode else None)
        level = driven.level_of_x_max if scaled and level is None else level
    if recording := there.get(("voltage", "current")):
        impedance = identify_impedance(recording, level_of_x_max=level or 0.0, mode=mode)
    if recording := there.get((PLAYED, "voltage")):
        drive = identify_drive(recording, rig, impedance)
    found = Calibration(None, {}, mode, driven, impedance, sweep, level, drive=drive)
    found = replace(found, qualities=tuple(map(transfer.assess_quality, recordings)))
    if impedance is None and mode is None:
        found = _add_by_coil(found, rig, there)
    else:
        found = _add_direct(found, rig, scaled, weighed)
    return _add_drive(found)


def _add_direct(
    found: Calibration, rig: Rig, scaled: bool, weighed: Estimate | None
) -> Calibration:
    """Add the values that need a recording of the current, but no parameters of the rig's file."""
    mode, impedance = found.mode, found.impedance
    values: mechanics.Values = {}
    if impedance is not None:
        inductances = impedance.inductances(found.sweep.low_hz, found.sweep.high_hz)
        values = {
            "actuator.resonance_hz": impedance.f0_hz,
            "actuator.q_mechanical": impedance.q_mechanical,
            "actuator.resistance_ohm": impedance.resistance_ohm,
            **{f"actuator.{name}": value for name, value in inductances.items()},
        }
    if mode is not None:
        values |= {"actuator.resonance_hz": mode.f0_hz, "actuator.q_mechanical": mode.q}
    if impedance is not None:
        plain = replace(rig.actuator, inductance_eddy_h=0.0, resistance_eddy_ohm=0.0)
        sources = tuple(s for s in rig.sources if not s.parameter.endswith(("eddy_h", "eddy_ohm")))
        rig = replace(rig, actuator=plain, sources=sources)
        if weighed is not None and not found.on_seat:
            values |= mechanics.by_known_mass(impedance, weighed)
        elif mode is not None and scaled and not found.on_seat:
            values |= mechanics.by_acceleration(impedance, mode)
    return replace(found, rig=mechanics.add_values(rig, values, _describe(found)), values=values)


def _add_by_coil(
    found: Calibration, rig: Rig, there: dict[tuple[str, str], Recording]
) -> Calibration:
    """Add f0 and Qms from the acceleration, computed with the coil values of the rig's file."""
    assert found.driven is not None
    driving = rig
    if ("drive", "acceleration") in there:  # the amplifier's impedance reduces the damping
        ohms = rig.actuator.resistance_ohm + rig.amplifier.source_impedance_ohm
        driving = replace(rig, actuator=replace(rig.actuator, resistance_ohm=ohms))
    try:
        values = mechanics.solve_mechanics(found.driven, driving)
    except IdentificationError as error:
        return replace(found, why_not=str(error))
    if not (assumed := [name for name in COIL if f"actuator.{name}" in rig.assumed()]):
        return replace(
            found, rig=mechanics.add_values(rig, values, _describe(found)), values=values
        )
    shown = f"{found.driven.f0_hz.value:.2f} Hz with Q {found.driven.q.value:.2f}"
    words = f"with the assumed {', '.join(assumed)} it gives the mode that was identified, {shown}"
    rig = mechanics.add_values(rig, values, f"{words}: {_describe(found)}", assumed=True)
    return replace(found, rig=rig, matched=True)


def _add_drive(found: Calibration) -> Calibration:
    """Add the amplifier's values; without a measured voltage, at most the high-pass corner."""
    drive, rig, values = found.drive, found.rig, {}
    corner = next((c.high_pass_hz for c in (drive, found.driven) if c and c.high_pass_hz), None)
    if corner:
        values["amplifier.low_cut_hz"] = corner
    if rig is None or (drive is None and corner is None):
        return found
    amplifier = rig.amplifier
    if drive is not None:
        values["amplifier.gain"] = drive.volts.scaled(1.0 / rig.dac.full_scale_v)
        volts = drive.volts.value
        words = f"only gain times this counts, {volts:.4g} V: {_describe(found)}"
        sources = tuple(
            replace(source, kind="identified", words=words)
            if source.parameter == "dac.full_scale_v" and source.kind == "assumed"
            else source
            for source in rig.sources
        )
        if amplifier.output_limit_v < volts:
            # The sweep did not clip, so the limit of the rig's file is too low.
            amplifier = replace(amplifier, output_limit_v=volts)
            words = "full scale without clipping: the sweep was too quiet to show a limit"
            sources = (
                *(s for s in sources if s.parameter != "amplifier.output_limit_v"),
                Source("amplifier.output_limit_v", "assumed", words),
            )
        if source_ohm := drive.source_ohm:
            values["amplifier.source_impedance_ohm"] = source_ohm
            ratio = source_ohm.value / rig.actuator.resistance_ohm
            mode: DriveMode = "current" if ratio >= MIN_CURRENT_DRIVE_RATIO else "voltage"
            amplifier = replace(amplifier, drive_mode=mode, source_impedance_ohm=source_ohm.value)
        rig = replace(rig, amplifier=amplifier, sources=sources)
    rig = mechanics.add_values(rig, values, _describe(found))
    return replace(found, rig=rig, values=found.values | values)


def _describe(found: Calibration) -> str:
    level = found.level_of_x_max
    how_far = f"{found.sweep.level:.3g} of full scale" if level is None else f"{level:.3f} Xmax"
    where = "on a seat that gives way" if found.on_seat else "on solid ground"
    return f"sweep of {found.sweep.duration_s:g} s at {how_far}, {where}"
