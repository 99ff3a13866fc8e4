"""Several files at once: each rendered by itself, on as many cores as there are workers."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.offline.render import RenderReport, render_file
from audioflinger_hook.offline.workers import Tell, WorkerLost, Workers
from device.errors import CushionError, InternalError, UsageError


@dataclass(frozen=True)
class Rendered:
    """What came of one file: its report, or the error, one line, and the exit code for it."""

    source: Path
    target: Path
    report: RenderReport | None = None
    error: str = ""
    exit_code: int = 0


def targets_in(folder: Path, sources: Sequence[Path]) -> list[Path]:
    """Return where the vibration of each file goes: its name in that folder, ending in .wav.

    Raises
    ------
    UsageError
        There is no such folder, two of them would be one file, or one would replace a source.
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
    tell: Tell | None = None,
) -> Iterator[Rendered]:
    """Yield what came of each file, in their order; of each the same bytes as `render_file` gives.

    An error of one leaves the others alone. workers: processes at once, 1 for this one alone. tell:
    told the share of all files that is done. Where this is left half-way, what is under way is
    discarded. Memory grows with the workers, not with the files.
    """

    def work(item: int, tell: Tell) -> Rendered:
        return _rendered(sources[item], targets[item], settings, tell)

    if min(workers, len(sources)) <= 1:
        for item in range(len(sources)):
            yield work(item, _share_of(item, len(sources), tell))
        return
    with Workers(work, len(sources), workers) as pool:
        for item, came in enumerate(pool.results(tell)):
            if isinstance(came, WorkerLost):
                error = f"{sources[item]}: the process that rendered it was {came}; render it again"
                yield Rendered(
                    sources[item], targets[item], error=error, exit_code=InternalError.exit_code
                )
            else:
                yield came


def _rendered(source: Path, target: Path, settings: Settings, tell: Tell) -> Rendered:
    def progress(frames: int, expected: int | None) -> None:
        if expected:
            tell(min(1.0, frames / expected))

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
    """Return an error's text, with the file's name where it has not got it."""
    text = str(error)
    return text if str(source) in text else str(type(error)(f"{source}: {text}"))


def _share_of(item: int, items: int, tell: Tell | None) -> Callable[[float], None]:
    """Return what is told the share of one item, and tells that of all."""

    def one(share: float) -> None:
        if tell:
            tell((item + share) / items)

    return one
