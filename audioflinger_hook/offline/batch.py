"""Renders several files at once, each separately, on several cores."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.offline.render import RenderReport, render_file
from audioflinger_hook.offline.workers import ReportShare, WorkerLost, Workers
from device.errors import CushionError, InternalError, UsageError


@dataclass(frozen=True)
class Rendered:
    """The outcome for one file: its report, or an error of one line and its exit code."""

    source: Path
    target: Path
    report: RenderReport | None = None
    error: str = ""
    exit_code: int = 0


def targets_in(folder: Path, sources: Sequence[Path]) -> list[Path]:
    """Return the target of each file: its name in that folder, ending in .wav.

    UsageError: there is no such folder, two targets are the same, or one would replace a source.
    """
    if not folder.is_dir():
        what = "is not a folder" if folder.exists() else "does not exist"
        raise UsageError(f"the output folder {folder} {what}; create it or name another")
    targets = [folder / f"{source.stem}.wav" for source in sources]
    heard = {os.path.realpath(source): source for source in sources}
    taken: dict[str, Path] = {}
    for source, target in zip(sources, targets, strict=True):
        resolved = os.path.realpath(target)
        if resolved in heard:
            raise UsageError(
                f"the vibration of {source} would replace the input {heard[resolved]}; "
                "name another folder"
            )
        if resolved in taken:
            raise UsageError(
                f"{taken[resolved]} and {source} would both become {target}; "
                "rename one, or render them into two folders"
            )
        taken[resolved] = source
    return targets


def render_files(
    sources: Sequence[Path],
    targets: Sequence[Path],
    settings: Settings,
    workers: int,
    report_share: ReportShare | None = None,
) -> Iterator[Rendered]:
    """Yield the outcome for each file, in their order, with the same bytes as `render_file`.

    An error in one file does not affect the others. Ending the iteration early discards unfinished
    files. Memory grows with the workers, not with the files.

    sources, targets: the sound files, and the file for the vibration of each.
    settings: used for all files.
    workers: processes at once; 1 for this process alone.
    report_share: called with the share of all files that is done.
    """

    def work(item: int, report_share: ReportShare) -> Rendered:
        return _try_file(sources[item], targets[item], settings, report_share)

    if min(workers, len(sources)) <= 1:
        for item in range(len(sources)):
            yield work(item, _share_of(item, len(sources), report_share))
        return
    with Workers(work, len(sources), workers) as pool:
        for item, came in enumerate(pool.results(report_share)):
            if isinstance(came, WorkerLost):
                error = f"{sources[item]}: the process that rendered it was {came}; render it again"
                yield Rendered(
                    sources[item], targets[item], error=error, exit_code=InternalError.exit_code
                )
            else:
                yield came


def _try_file(
    source: Path, target: Path, settings: Settings, report_share: ReportShare
) -> Rendered:
    def progress(frames: int, expected: int | None) -> None:
        if expected:
            report_share(min(1.0, frames / expected))

    try:
        report = render_file(source, target, settings, progress=progress)
    except CushionError as error:
        return Rendered(source, target, error=_named(error, source), exit_code=error.exit_code)
    except Exception as error:
        said = f"{type(error).__name__}: {error}; this is a fault of cushion, please report it"
        wrapped = InternalError(f"{source}: {said}")
        return Rendered(source, target, error=str(wrapped), exit_code=wrapped.exit_code)
    return Rendered(source, target, report)


def _named(error: CushionError, source: Path) -> str:
    """Return an error's text, with the file's name added if it is missing."""
    text = str(error)
    return text if str(source) in text else str(type(error)(f"{source}: {text}"))


def _share_of(item: int, items: int, report_share: ReportShare | None) -> ReportShare:
    """Return a function that takes the share of one item and reports the share of all items."""

    def one(share: float) -> None:
        if report_share:
            report_share((item + share) / items)

    return one
