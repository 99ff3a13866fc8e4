"""`cushion bench`: speed against error on this machine."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from audioflinger_hook.cli.terminal import progress_bar
from device.atomic_file import AtomicFile, write_bytes_atomically
from device.errors import UsageError
from tools.bench import pictures_in, plots, run_bench
from tools.bench.drawing import need_matplotlib

REPORT = Path("docs/benchmarks.md")
HOME = Path("tools/bench")
"""Only in the project's own folder is there a report to replace without being asked."""


def run(options: argparse.Namespace) -> int:
    """Measure, print, and write docs/benchmarks.md if this is the project's own folder.

    The page shows the pictures that are drawn under its own folder.
    """
    target = options.out or (REPORT if HOME.is_dir() and REPORT.parent.is_dir() else None)
    if target and not target.parent.is_dir():
        raise UsageError(f"the folder {target.parent} does not exist; name another with --out")
    if target:
        AtomicFile(target).abort()  # what cannot be written is said now, not after minutes
    if options.plots:
        need_matplotlib()
        _make_folder(options.plots)
    with progress_bar("bench") as advance:
        report = run_bench(options.quick, lambda _label, share: advance(share, 1.0))
    drawn = plots(report, options.plots) if options.plots else []
    page = report.to_markdown(pictures_in(target, drawn) if target and drawn else None)
    print(json.dumps(report.to_json(), indent=2) if options.json else page)
    if report.missing:
        rows = "; ".join(str(row) for row in report.missing)
        raise UsageError(f"not everything could be measured, no report was written: {rows}")
    if target:
        write_bytes_atomically(target, page.encode())
        print(f"written to {target}", file=sys.stderr)
    return 0


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise UsageError(
            f"the folder {folder} cannot be made ({error.strerror}); name another with --plots"
        ) from None
