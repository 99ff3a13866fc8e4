"""One long file in the reference form on several cores: sections of whole units, put together.

Units are independent but for the band-pass ahead of them, which remembers. A section therefore
begins some seconds early. In that time two band-passes that have heard different things come to the
same state, to the last bit, as rounding lets them forget; whether they have is not believed but
compared with the state in which the section before ended, and a section that began in another
state is rendered again from the right one.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.offline.workers import Tell, WorkerLost, Workers
from audioflinger_hook.sources import FileTap
from audioflinger_hook.transform import HapticTransform
from device.errors import CushionError, InternalError

SECTION_SAMPLES = 1_500_000
"""Of vibration, in all channels: 6 MB."""

EARLY_S = 5.0
"""So much earlier a section begins. What was tried took up to 3 s to forget another past."""

WORTH_EARLY = 3.0
"""Sections are at least so many times longer than they begin early, or it is not worth it."""


@dataclass(frozen=True)
class Plan:
    """Where a file is cut: every `frames`, each begun `early_frames` before; whole units both."""

    source: Path
    settings: Settings
    samplerate: int
    channels: int
    frames: int
    early_frames: int
    sections: int


@dataclass(frozen=True)
class Section:
    """Vibration of a section, (frames, channels), aligned with its sound; the pasts at its ends.

    ended: the sound ended in it. warnings: what is wrong with the file, once that is known.
    """

    vibration: NDArray[np.float32]
    before: tuple[bytes, ...]
    after: tuple[bytes, ...]
    replaced_samples: int
    ended: bool
    warnings: tuple[str, ...]


def plan_for(source: Path, settings: Settings) -> Plan | None:
    """Return how to cut a file, or None where that gains nothing or would change anything.

    Only the reference form, with nothing but the transform between sound and vibration, and files
    that can be read from any frame on. Raises UsageError as `FileTap` does.
    """
    plain = Settings(form="reference", channels=settings.channels, parameters=settings.parameters)
    if (settings.form, settings.profile, settings.gain_db) != (
        "reference",
        plain.profile,
        plain.gain_db,
    ) or (settings.effects_file, settings.actuators) != (None, ()):
        return None
    tap = FileTap(source)
    tap.close()
    if not tap.divisible:
        return None
    expected = tap.frames_expected or 0
    rate, each = tap.samplerate, settings.channels == "each"
    unit = settings.parameters.window_frames(rate)
    early = -(-round(EARLY_S * rate) // unit) * unit
    frames = SECTION_SAMPLES // (tap.channels if each else 1) // unit * unit
    if frames < WORTH_EARLY * early or expected < 2 * frames:
        return None
    return Plan(source, settings, rate, tap.channels, frames, early, -(-expected // frames))


def sections_of(
    plan: Plan, workers: int, tell: Tell | None = None
) -> Generator[Section, None, None]:
    """Yield every section in order, as one stream from the beginning gives them.

    workers: processes at once, 2 or more; tell: told the share of the file that is done.

    Raises
    ------
    CushionError
        What a worker raised.
    InternalError
        A worker was lost.
    """
    past: tuple[bytes, ...] | None = None
    with Workers(partial(_tried, plan), plan.sections, workers) as pool:
        for index, came in enumerate(pool.results(tell)):
            if isinstance(came, WorkerLost):
                raise InternalError(f"the process that rendered a part of it was {came}; try again")
            if isinstance(came, CushionError):
                raise came
            if past is not None and came.before != past:
                came = rendered(plan, index, past)
            past = came.after
            yield came
            if came.ended:
                return


def _tried(plan: Plan, index: int, _tell: Tell) -> Section | CushionError:
    try:
        return rendered(plan, index)
    except CushionError as error:
        return error
    except Exception as error:
        said = f"{type(error).__name__}: {error}"
        return InternalError(f"{said}; this is a fault of cushion, please report it")


def rendered(plan: Plan, index: int, past: tuple[bytes, ...] | None = None) -> Section:
    """Return one section; past: of what came before it, where that is known to the bit."""
    first = index * plan.frames
    begin = first if past is not None else max(0, first - plan.early_frames)
    end = None if index == plan.sections - 1 else first + plan.frames
    tap = FileTap(plan.source, first=begin)
    try:
        return _rendered(plan, tap, begin, first, end, past)
    finally:
        tap.close()


def _rendered(
    plan: Plan,
    tap: FileTap,
    begin: int,
    first: int,
    end: int | None,
    past: tuple[bytes, ...] | None,
) -> Section:
    settings = plan.settings
    transform = HapticTransform(
        plan.samplerate,
        plan.channels,
        settings.parameters,
        form="reference",
        per_channel=settings.channels == "each",
        single=True,
    )
    if past is not None:
        transform.past = past
    place, before, replaced = begin, transform.past, 0
    parts: list[NDArray[np.float32]] = []
    while (end is None or place < end) and (buffer := tap.read()) is not None:
        if place < first:
            early = buffer[: first - place]
            transform.process(early)
            place += len(early)
            if place < first:
                continue
            before, replaced = transform.past, transform.replaced_samples
            buffer = buffer[len(early) :]
        taken = buffer if end is None else buffer[: end - place]
        parts.append(transform.process(taken).astype(np.float32))
        place += len(taken)
    ended = end is None or place < end
    replaced = transform.replaced_samples - replaced
    after = () if ended else transform.past
    parts.append(transform.finish().astype(np.float32))
    # The first unit that comes out is of what was before.
    vibration = np.concatenate(parts)[transform.latency_frames :]
    return Section(vibration, before, after, replaced, ended, tuple(tap.warnings))
