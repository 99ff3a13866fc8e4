"""Renders several files at once, each separately, on several cores."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Future, wait
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.offline.pool import DIED, LocalWorkers
from audioflinger_hook.offline.pool import report_share as report_to_pool
from audioflinger_hook.offline.render import RenderReport, render_file
from audioflinger_hook.sources.tap import named
from device.errors import CushionError, InternalError, UsageError

ReportShare = Callable[[float], None]  # the share of the work that is done, 0 to 1
SHARE_S = 0.1  # between reports of the share
AHEAD = 4  # files under way for each process, so that none waits for `SHARE_S`


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

    workers: processes at once; 1 for this process alone.
    report_share: called with the share of all files that is done.
    """
    count = len(sources)
    if min(workers, count) <= 1:
        for item in range(count):
            share = partial(_report_one, report_share, item, count) if report_share else None
            yield _try_file(sources[item], targets[item], settings, share)
        return
    with LocalWorkers(min(workers, count), __name__, count) as pool:

        def submit(item: int) -> Future[Rendered]:
            share = partial(report_to_pool, item)
            return pool.submit(_try_file, sources[item], targets[item], settings, share)

        futures: dict[int, Future[Rendered]] = {}
        left = iter(range(count))

        def submit_more() -> None:
            """Keep all processes busy; not while files wait for their second try, alone."""
            done = [each for each in futures.values() if each.done()]
            if not any(isinstance(each.exception(), BrokenExecutor) for each in done):
                under_way = len(futures) - len(done)
                for item in islice(left, AHEAD * workers - under_way):
                    futures[item] = submit(item)

        def result(future: Future[Rendered], *, alone: bool) -> Rendered:
            while not wait([future], SHARE_S).done:
                if not alone:
                    submit_more()
                if report_share:
                    report_share(sum(pool.shares) / count)
            return future.result()

        for item in range(count):
            submit_more()
            try:
                try:
                    came = result(futures.pop(item), alone=False)
                except BrokenExecutor:
                    # Whose process died is not known, so each file under way is tried alone.
                    came = result(submit(item), alone=True)
            except BrokenExecutor:
                died = InternalError(f"{sources[item]}: its process died twice, {DIED}")
                came = _failed(sources[item], targets[item], died)
            yield came


def _try_file(
    source: Path, target: Path, settings: Settings, report_share: ReportShare | None
) -> Rendered:
    def progress(frames: int, expected: int | None) -> None:
        if expected and report_share:
            report_share(min(1.0, frames / expected))

    try:
        return Rendered(source, target, render_file(source, target, settings, progress=progress))
    except CushionError as error:
        return _failed(source, target, named(error, source))
    except Exception as error:
        said = f"{type(error).__name__}: {error}; this is a fault of cushion, please report it"
        return _failed(source, target, InternalError(f"{source}: {said}"))


def _failed(source: Path, target: Path, error: CushionError) -> Rendered:
    return Rendered(source, target, error=str(error), exit_code=error.exit_code)


def _report_one(report_share: ReportShare, item: int, items: int, share: float) -> None:
    report_share((item + share) / items)
