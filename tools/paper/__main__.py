"""Draw the paper's Figures 6, 7 and 8 from the simulated rig: `python -m tools.paper --out DIR`.

The command writes figure6, figure7, figure8 and figure8_damped, as pictures (.png) and numbers
(.csv), to a folder. A missing folder is created.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from device.errors import CushionError, UsageError
from tools.bench.figures.pictures import need_matplotlib


def main(arguments: list[str] | None = None) -> int:
    """Write the files and print their names; return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.paper",
        description="Draw the paper's Figures 6, 7 and 8 from the simulated rig.",
        allow_abbrev=False,
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write to")
    out: Path = parser.parse_args(arguments).out
    try:
        need_matplotlib()
        _make_folder(out)
        from tools.paper.everything import write_figures

        for path in write_figures(out):
            print(path, flush=True)
    except CushionError as error:
        print(f"figures: error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def _make_folder(out: Path) -> None:
    try:
        out.mkdir(exist_ok=True)
    except FileExistsError:
        raise UsageError(f"{out} is not a folder; name another with --out") from None
    except OSError as error:
        raise UsageError(
            f"the folder {out} cannot be made ({error.strerror}); name another with --out"
        ) from None


if __name__ == "__main__":
    sys.exit(main())
