"""Runs the benchmarks, and prints a report as Markdown, or as JSON with --json.

Usage: python -m tools.bench [--quick] [--json] [--out FILE]. The command writes files only with
    --out, --tables or --plots. Exit codes: 0 success; 2 wrong usage or a failed measurement; 5 a
    file could not be written; 130 interrupted.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from audioflinger_hook.cli.terminal import progress_bar
from device.atomic_file import AtomicFile, write_bytes_atomically
from device.errors import CushionError, UsageError
from device.values import counted
from tools.bench.figures.pictures import draw_all, need_matplotlib, shown_in
from tools.bench.run import run_bench
from tools.bench.tables import write_tables

EXIT_INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmarks and return the exit code. Errors are printed on stderr."""
    options = _parser().parse_args(arguments)
    try:
        return _run(options)
    except CushionError as error:
        print(f"bench: error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("bench: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m tools.bench",
        description="Measure speed and error on this machine.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "--quick", action="store_true", help="measure the same rows with less material, in a minute"
    )
    parser.add_argument("--json", action="store_true", help="print JSON; writes no files")
    parser.add_argument(
        "--plots", type=Path, metavar="DIR", help="draw the pictures into this folder"
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the report into this file")
    parser.add_argument(
        "--tables", type=Path, metavar="STEM", help="write the tables into STEM.json and STEM.csv"
    )
    return parser


def _run(options: argparse.Namespace) -> int:
    if options.json and (options.out or options.plots or options.tables):
        raise UsageError("--json writes no files; leave out --out, --plots and --tables")
    target: Path | None = _writable(options.out) if options.out else None
    if options.tables:
        _writable(options.tables.with_suffix(".csv"))
    if options.plots:
        need_matplotlib()
        _make_folder(options.plots)
    with progress_bar("bench") as advance:
        report = run_bench(options.quick, lambda _label, share: advance(share, 1.0))
    drawn = draw_all(report, options.plots) if options.plots else []
    page = report.to_markdown(shown_in(target, drawn) if target and drawn else None)
    print(json.dumps(report.to_json(), indent=2) if options.json else page)
    if report.missing:
        for row in report.missing:
            print(f"bench: not measured: {row}", file=sys.stderr)
        raise UsageError(
            f"{counted(len(report.missing), 'rows')} could not be measured, so no report was "
            "written; see the reasons above"
        )
    written = write_tables(report, options.tables) if options.tables else []
    if target:
        write_bytes_atomically(target, page.encode())
        written.append(target)
    for path in written:
        print(f"written to {path}", file=sys.stderr)
    return 0


def _writable(target: Path) -> Path:
    """Return the target file after checking that it can be written."""
    if not target.parent.is_dir():
        raise UsageError(f"the folder {target.parent} does not exist; name another one")
    AtomicFile(target).abort()
    return target


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise UsageError(
            f"the folder {folder} cannot be made ({error.strerror}); name another with --plots"
        ) from None


if __name__ == "__main__":
    sys.exit(main())
