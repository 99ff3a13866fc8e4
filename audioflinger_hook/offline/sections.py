"""Renders one long file in the reference form on several cores, in sections of whole units.

A section's rendering starts some seconds early. In this time the band-pass forgets its start,
usually to the last bit. If the state then differs from the state at the end of the previous
section, the section is rendered again.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.offline.workers import ReportShare, WorkerLost, Workers
from audioflinger_hook.sources import FileTap
from audioflinger_hook.transform import HapticTransform
from device.errors import CushionError, InternalError

SECTION_SAMPLES = 1_500_000
"""Samples of vibration in a section, in all channels: 6 MB."""

EARLY_S = 5.0
"""Time by which a section starts early. Measured: the band-pass forgets within 3 s."""

WORTH_EARLY = 3.0
"""Least ratio of a section's length to its early start; below this, sections gain nothing."""

UNRELATED = (
    "channels", "parameters", "rig", "damping", "protection", "exposure_cap", "model",
    "tolerance", "said",
)  # fmt: skip
"""Settings that also apply to sections, or only after the transform."""


@dataclass(frozen=True)
class Plan:
    """How a file is cut: every `frames` frames; each section starts `early_frames` early."""

    source: Path
    settings: Settings
    samplerate: int
    channels: int
    frames: int
    early_frames: int
    sections: int


@dataclass(frozen=True)
class Section:
    """A section's vibration, (frames, channels), aligned with its sound.

    vibration: (frames, channels).
    before, after: state of the transform at both ends.
    replaced_samples: unusable samples of the sound.
    ended: whether the sound ended in this section.
    warnings: what is known to be wrong with the file.
    """

    vibration: NDArray[np.float32]
    before: tuple[bytes, ...]
    after: tuple[bytes, ...]
    replaced_samples: int
    ended: bool
    warnings: tuple[str, ...]


def plan_for(source: Path, settings: Settings) -> Plan | None:
    """Return how to cut a file; None if cutting gains no time or would change the result.

    The form must be "reference", with nothing but the transform between sound and vibration, and
    the file must be readable from any frame on. Raises UsageError as `FileTap` does.
    """
    plain = Settings(form="reference")
    for field in fields(Settings):
        ours, default = getattr(settings, field.name), getattr(plain, field.name)
        if field.name not in UNRELATED and ours != default:
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
    plan: Plan, workers: int, report_share: ReportShare | None = None
) -> Generator[Section, None, None]:
    """Yield every section in order, equal to the parts of one uncut rendering.

    workers: processes at once, 2 or more; report_share: takes the share of the file that is done.

    CushionError: a worker raised it.
    InternalError: a worker died.
    """
    past: tuple[bytes, ...] | None = None
    with Workers(partial(_try_section, plan), plan.sections, workers) as pool:
        for index, came in enumerate(pool.results(report_share)):
            if isinstance(came, WorkerLost):
                raise InternalError(f"the process that rendered a section was {came}; try again")
            if isinstance(came, CushionError):
                raise came
            if past is not None and came.before != past:
                came = render_section(plan, index, past)
            past = came.after
            yield came
            if came.ended:
                return


def _try_section(plan: Plan, index: int, _share: ReportShare) -> Section | CushionError:
    try:
        return render_section(plan, index)
    except CushionError as error:
        return error
    except Exception as error:
        said = f"{type(error).__name__}: {error}"
        return InternalError(f"{said}; this is a fault of cushion, please report it")


def render_section(plan: Plan, index: int, past: tuple[bytes, ...] | None = None) -> Section:
    """Return one section. past: the transform's state at its start, if known."""
    first = index * plan.frames
    begin = first if past is not None else max(0, first - plan.early_frames)
    end = None if index == plan.sections - 1 else first + plan.frames
    with closing(FileTap(plan.source, first=begin)) as tap:
        return _render_section(plan, tap, begin, first, end, past)


def _render_section(
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
    position, before, replaced = begin, transform.past, 0
    parts: list[NDArray[np.float32]] = []
    while (end is None or position < end) and (buffer := tap.read()) is not None:
        if position < first:
            early = buffer[: first - position]
            transform.process(early)
            position += len(early)
            if position < first:
                continue
            before, replaced = transform.past, transform.replaced_samples
            buffer = buffer[len(early) :]
        taken = buffer if end is None else buffer[: end - position]
        parts.append(transform.process(taken).astype(np.float32))
        position += len(taken)
    ended = end is None or position < end
    replaced = transform.replaced_samples - replaced
    after = () if ended else transform.past
    parts.append(transform.finish().astype(np.float32))
    # The first unit that comes out belongs to the section before.
    vibration = np.concatenate(parts)[transform.latency_frames :]
    return Section(vibration, before, after, replaced, ended, tuple(tap.warnings))
