"""`cushion bench`: speed against error on this machine."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from audioflinger_hook.bench import plots, run_bench
from audioflinger_hook.cli.terminal import progress_bar
from device.atomic_file import write_bytes_atomically
from device.errors import UsageError

REPORT = Path("docs/benchmarks.md")


def run(options: argparse.Namespace) -> int:
    """Measure, print, and write docs/benchmarks.md where there is a docs folder."""
    target = options.out or (REPORT if REPORT.parent.is_dir() else None)
    with progress_bar("bench") as advance:
        report = run_bench(options.quick, lambda _label, share: advance(share, 1.0))
    if options.plots:
        options.plots.mkdir(exist_ok=True)
        plots(report, options.plots)
    print(json.dumps(report.to_json(), indent=2) if options.json else report.to_markdown())
    if report.missing:
        rows = "; ".join(str(row) for row in report.missing)
        raise UsageError(f"not everything could be measured, nothing was written: {rows}")
    if target:
        write_bytes_atomically(target, report.to_markdown().encode())
        print(f"written to {target}", file=sys.stderr)
    return 0
