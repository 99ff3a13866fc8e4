"""The principal frequencies (main spectral peaks) of a sound in each unit (analysis window)."""

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from audioflinger_hook.sources import FileTap, Tap
from audioflinger_hook.transform import FloatArray
from audioflinger_hook.transform.downmix import MonoMix
from audioflinger_hook.transform.input_stage import channel_rows, replace_unusable
from audioflinger_hook.transform.mapping import vibration_hz
from audioflinger_hook.transform.parameters import TransformParameters
from audioflinger_hook.transform.reference import ReferenceTransform
from device.errors import UsageError
from device.layouts import downmix

LONGEST_S = 1e9  # longer than any sound; frame numbers up to this time are exact as float64
PRINTED_S = 0.6e-6  # more than the rounding error of a time that is printed with six decimals


@dataclass(frozen=True)
class PrincipalFrequency:
    """A principal frequency. amplitude: 1 is full scale. r: amplitude times bandwidth, in Hz."""

    audio_hz: float
    amplitude: float
    bandwidth_hz: float
    r: float
    vibration_hz: float


@dataclass(frozen=True)
class Unit:
    """One unit (analysis window). unit: number from 0. start_s: seconds from the sound's start."""

    unit: int
    start_s: float
    principal: list[PrincipalFrequency]


def inspect_file(
    path: Path,
    parameters: TransformParameters | None = None,
    *,
    at_s: float | None = None,
    warn: Callable[[str], None] | None = None,
) -> Iterator[Unit]:
    """Yield all units of a sound file in order, or only the unit that contains the time `at_s`.

    The channels are mixed to mono. At the end, `warn` is called with each warning about the file.
    UsageError: the file cannot be used, or `at_s` is not within the sound.
    """
    if at_s is not None and not 0.0 <= at_s < np.inf:
        raise UsageError(f"time {at_s:g} s is not in the sound; allowed: 0 s up to its end")
    with closing(FileTap(path)) as tap:
        yield from inspect_tap(tap, parameters or TransformParameters(), at_s=at_s)
        if warn:
            for warning in tap.warnings:
                warn(warning)


def inspect_tap(
    tap: Tap, parameters: TransformParameters, *, at_s: float | None = None
) -> Iterator[Unit]:
    """Yield the units of the sound that a tap reads, as `inspect_file` does."""
    transform = ReferenceTransform(parameters, tap.samplerate)
    mix = MonoMix(downmix(tap.channels), tap.samplerate)
    window = transform.latency_frames
    exact = None if at_s is None else min(at_s, LONGEST_S) * tap.samplerate
    # A unit's printed start has six decimals. Given as `at_s`, it must select the same unit.
    wanted = None if exact is None else int(exact + PRINTED_S * tap.samplerate) // window

    def unit_of(number: int, frames: FloatArray) -> Unit:
        found = transform.analyse(frames[None])
        at_hz = vibration_hz(found.audio_hz, parameters)
        columns = (found.audio_hz, found.amplitude, found.bandwidth_hz, found.r, at_hz)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        principal = [PrincipalFrequency(*row) for row in rows]
        return Unit(number, number * (window / tap.samplerate), principal)

    frames = done = 0
    ended = False
    while not ended:
        buffer = tap.read()
        if buffer is None:
            units, ended = transform.cut_last(), True
        else:
            frames += len(buffer)
            units = transform.cut(mix.process(channel_rows(replace_unusable(buffer)[0])))
        if exact is None or wanted is None:
            yield from (unit_of(number, unit) for number, unit in enumerate(units, start=done))
        elif wanted < done + len(units) and exact < frames:
            yield unit_of(wanted, units[wanted - done])
            return
        done += len(units)
    if wanted is not None:
        raise UsageError(
            f"time {at_s:g} s is after the end of the sound; "
            f"allowed: 0 to {frames / tap.samplerate:.3f} s, the end itself excluded"
        )
