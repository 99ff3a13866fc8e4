"""`cushion catalogue`: writes the vibration of all sounds in a library, or shows the progress."""

import argparse
import json
import re
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from itertools import islice

from audioflinger_hook.catalogue.addresses import parse_address, scrubbed
from audioflinger_hook.catalogue.cluster import LOCAL_CLUSTER, DaskCluster
from audioflinger_hook.catalogue.item import Item
from audioflinger_hook.catalogue.listing import is_same
from audioflinger_hook.catalogue.manifest import Manifest
from audioflinger_hook.catalogue.recipe import Recipe
from audioflinger_hook.catalogue.run import Run
from audioflinger_hook.catalogue.storage import storage_of
from audioflinger_hook.catalogue.summary import Failures, Page, Summary
from audioflinger_hook.catalogue.timing import Timing
from audioflinger_hook.catalogue.work import Outcome, do_batch, status_of
from audioflinger_hook.cli.render import chosen_settings, chosen_workers
from audioflinger_hook.cli.terminal import Advance, complain, progress_bar, warn
from audioflinger_hook.exports.options import ExportOptions
from audioflinger_hook.offline.batch import LocalWorkers, Place
from device.errors import CushionError, InternalError, UsageError
from device.values import counted

SEE_HELP = "see `cushion catalogue --help`"
PRINTED_MAX = 20  # largest number of printed failures, and of printed warnings
RETRIES_MAX = 20


@dataclass(frozen=True)
class _Job:
    manifest: Manifest
    recipe: Recipe
    timing: Timing
    shard: tuple[int, int]

    def items(self) -> Iterator[Item]:
        index, count = self.shard
        return islice(self.manifest.items(), index - 1, None, count)


def run(options: argparse.Namespace) -> int:
    """Render the sounds that a manifest lists, or print the number of sounds in each state."""
    words = list(options.words)
    only_status = len(words) > 1 and words[0] == "status"
    if only_status:
        del words[0]
    if len(words) != 1:
        given = f"{len(words)} are given" if words else "it is missing"
        raise UsageError(f"one MANIFEST is needed, {given}; {SEE_HELP}")
    job = _job(options, words[0])
    count, mistakes = job.manifest.check()
    if mistakes.count:
        for mistake in mistakes.shown:
            complain(mistake)
        if mistakes.count > len(mistakes.shown):
            complain(f"{mistakes.count - len(mistakes.shown)} more mistakes in the manifest")
        return UsageError.exit_code
    index, shards = job.shard
    total = len(range(index - 1, count, shards))
    return _status(job, total, options) if only_status else _work(job, total, options)


def _job(options: argparse.Namespace, manifest: str) -> _Job:
    if options.out is None:
        raise UsageError(f"the following arguments are required: --out; {SEE_HELP}")
    if options.shard and options.dask:
        raise UsageError("--shard and --dask cannot be used together; leave one out")
    if options.workers is not None and options.dask not in (None, LOCAL_CLUSTER):
        raise UsageError("--workers counts processes of this machine; leave it out with --dask")
    if not 0 <= options.retries <= RETRIES_MAX:
        raise UsageError(f"--retries={options.retries}: allowed are 0 to {RETRIES_MAX}")
    if options.max_failures is not None and options.max_failures < 0:
        raise UsageError(f"--max-failures={options.max_failures} is below 0; allowed: 0 or more")
    out = parse_address(options.out, "--out")
    wanted = ExportOptions(options.format, options.output_rate, options.device_band)
    sounds = {"track": options.track, "language": options.language}
    sounds |= {"verify": options.verify, "retry_died": options.retry_died}
    recipe = Recipe(out, chosen_settings(options), wanted, **sounds)
    timing = Timing(time.perf_counter, time.sleep, options.retries)
    whole = Manifest(manifest, out)
    share = "1/1" if options.shard is None else options.shard
    found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", share)
    index, count = (int(found[1]), int(found[2])) if found else (0, 0)
    if not 1 <= index <= count:
        raise UsageError(f"--shard={share!r} is not a share; allowed: I/N with I from 1 to N")
    return _Job(whole, recipe, timing, (index, count))


def _work(job: _Job, total: int, options: argparse.Namespace) -> int:
    storage = storage_of(job.recipe.out)
    storage.prepare()
    described = json.dumps(job.recipe.described(), indent=2) + "\n"
    job.timing.repeated(lambda: storage.write("catalogue.json", described.encode()))
    index, shards = job.shard
    name = "failed.jsonl" if shards == 1 else f"failed-{index}-of-{shards}.jsonl"
    # If the run's input is its own list of failures, an early end must keep the remaining entries.
    on_failures = is_same(job.manifest.address, f"{job.recipe.out}/{name}")
    summary = Summary()
    stopped = ""
    workers = chosen_workers(options.workers)
    place: Place
    if options.dask:
        place = DaskCluster(options.dask, workers)
    else:
        place = LocalWorkers(min(workers, max(1, total)), do_batch.__module__)
    with ExitStack() as stack:
        stack.enter_context(place)
        failures = stack.enter_context(Failures())
        page = stack.enter_context(Page()) if options.report else None
        console = _Console(total, stack.enter_context(progress_bar(counted(total, "items"))))
        try:
            for batch in Run(job.recipe, job.items(), place, job.timing).outcomes():
                for outcome in batch:
                    summary.add(outcome)
                    if page:
                        page.add(outcome)
                    if outcome.state == "failed":
                        failures.add(outcome)
                console.show(batch, summary)
                if stopped := _reason_to_stop(batch, summary, options.max_failures):
                    break
        except BaseException:
            if not on_failures:
                with suppress(CushionError):
                    failures.save(storage, name)
            raise
        if not (stopped and on_failures):
            job.timing.repeated(lambda: failures.save(storage, name))
        if page:
            page.write(options.report, summary)
    if stopped:
        complain(f"{stopped}; finished results are kept, run the same command again to go on")
    _print(summary, f"{job.recipe.out}/{name}", options)
    return summary.exit_code


def _reason_to_stop(batch: list[Outcome], summary: Summary, most: int | None) -> str:
    for outcome in batch:
        if outcome.stops:
            return f"stopped, because every item would fail like {outcome.item.id}"
    if most is not None and summary.failed > most:
        return f"stopped after {counted(summary.failed, 'failures')}, --max-failures={most}"
    return ""


class _Console:
    def __init__(self, total: int, progress: Advance) -> None:
        self._total, self._progress = total, progress
        self._begin_s = time.monotonic()
        self._printed = 0
        self._warned: set[str] = set()

    def show(self, batch: list[Outcome], summary: Summary) -> None:
        """Print errors and new warnings of a batch, and show the progress."""
        for outcome in batch:
            if outcome.error and self._printed < PRINTED_MAX:
                self._printed += 1
                complain(str(CushionError(outcome.error)))
            # Records of skipped items contain warnings that an earlier run printed.
            is_new = outcome.state == "rendered"
            for warning in outcome.record.get("warnings", ()) if is_new else ():
                if warning not in self._warned and len(self._warned) < PRINTED_MAX:
                    self._warned.add(warning)
                    warn(scrubbed(warning))
        elapsed_s = max(1e-3, time.monotonic() - self._begin_s)
        note = f"{summary.sound_s / elapsed_s:.0f} x real time, {summary.failed} failed"
        self._progress(summary.items, self._total, note)


def _print(summary: Summary, failed: str, options: argparse.Namespace) -> None:
    if options.json:
        document = {**summary.document(), "failed_manifest": failed if summary.failed else None}
        print(json.dumps(document, indent=2))
        return
    for line in summary.lines():
        print(line)
    if summary.failed:
        print(f"failed items are in {failed}, which is a manifest")


def _status(job: _Job, total: int, options: argparse.Namespace) -> int:
    counts = Counter({"done": 0, "outdated": 0, "missing": 0, "unreadable": 0})
    printed = 0
    with progress_bar(counted(total, "items")) as progress:
        for found in status_of(job.recipe, job.items(), job.timing):
            counts[found.state] += 1
            progress(counts.total(), total)
            if found.error and printed < PRINTED_MAX:
                printed += 1
                warn(scrubbed(found.error))
    if counts.total() != total:
        raise InternalError(f"{counts.total()} items instead of {total}: the manifest has changed")
    if options.json:
        print(json.dumps({"items": total, **counts}, indent=2))
    else:
        states = ", ".join(f"{count} {state}" for state, count in counts.items())
        print(f"{counted(total, 'items')}: {states}")
    return 0
