"""The drive from samples to the coil: volts per full scale, high-pass, source impedance."""

import math
from dataclasses import dataclass

import numpy as np

from device.identification import responses
from device.identification.acceleration import corner_of, find_delay_s, high_pass_extra
from device.identification.impedance import Impedance
from device.identification.output_error import (
    Estimate,
    Extra,
    check_converged,
    check_misfit,
    fit_with_extras,
    require,
)
from device.identification.recording import Recording
from device.identification.responses import DELAY, GAIN, load
from device.rig.rig import Rig
from device.units import FloatArray

WIDEST_VOLTS = 0.05
"""Half the widest accepted 95 % interval, as a share."""

LEAST_SOURCE = 1e-3
"""A source impedance below this share of the coil's resistance is negligible."""


@dataclass(frozen=True)
class Drive:
    """The amplifier, as the coil's voltage for the played signal shows it."""

    volts: Estimate  # without a load, for a sample of 1.0
    high_pass_hz: Estimate | None  # None: that of the rig
    source_ohm: Estimate | None  # None: that of the rig


def identify_drive(recording: Recording, rig: Rig, impedance: Impedance | None) -> Drive:
    """Return the drive from a recording of the coil's voltage for the played signal.

    The response must be divided by the band of the rig's amplifier. impedance: that of the coil,
    which reveals the source impedance; None if the current was not measured.
    """
    f = recording.frequencies_hz[recording.band][recording.usable]
    factors = [GAIN, *([DELAY] if recording.delayed else [])]
    extras = [high_pass_extra(recording)]
    if impedance:
        r = impedance.resistance_ohm.value
        starts = tuple(np.log([share * r]) for share in (0.03, 0.3, 3.0, 30.0))
        ends = np.log([1e-3 * r]), np.log([1e4 * r])
        extras.append(Extra("source", load(impedance.admittance(f)), starts, *ends))
    found, chosen, _ = fit_with_extras(recording, factors, [_start(recording)], extras)
    check_converged(recording, found)
    check_misfit(
        recording,
        found,
        "this is not an amplifier with one high-pass; switch off equalisers, and check the inputs",
    )
    volts, source = found.estimate({0: 1.0}), None
    first = len(factors)
    for extra in chosen:
        if extra.name == "source" and impedance:
            source = found.estimate({first: 1.0})
            if source.value < LEAST_SOURCE * impedance.resistance_ohm.value:
                source = None
        first += extra.factor.parameters
    if source is None:
        volts = volts.scaled(1.0 + rig.amplifier.source_impedance_ohm / rig.actuator.resistance_ohm)
    require("volts per full scale", volts, WIDEST_VOLTS, "raise the level a little")
    corner = corner_of(found, chosen, len(factors), recording.high_pass_hz or 0.0)
    return Drive(volts, corner, source)


def _start(recording: Recording) -> FloatArray:
    """Return the logarithm of the gain and, if there is one, the delay."""
    f = recording.frequencies_hz[recording.band]
    played = recording.reference_spectrum[recording.band]
    measured = recording.response_spectrum[recording.band]
    gain = math.log(float(np.linalg.norm(measured) / np.linalg.norm(played)))
    if not recording.delayed:
        return np.array([gain])
    return np.array([gain, find_delay_s(f, played.conj() * measured) / responses.DELAY_S])
