"""Sweeps from a quarter of the wanted level on: what is wrong there never becomes loud."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
from scipy.fft import irfft

from device.identification.bench import LARGEST_SHARE
from device.identification.recording import IdentificationError, Recording
from device.identification.sweep import Sweep
from device.identification.transfer import transfer
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
