"""The paper's Figures 6, 7 and 8 from the simulated rig: tools/figures.py --out DIR

Writes figure6, figure7, figure8 and figure8_damped, each as a picture (.png) and its numbers
(.csv), into a folder, which is made if it does not exist.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from device.errors import CushionError, UsageError


def main(arguments: list[str] | None = None) -> int:
    """Write and name the files; return the exit code."""
    parser = argparse.ArgumentParser(
        description="Draw the paper's Figures 6, 7 and 8 from the simulated rig.",
        allow_abbrev=False,
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="made if need be")
    out: Path = parser.parse_args(arguments).out
    try:
        _refuse_without_matplotlib()
        _make_folder(out)
        from tools.paper.everything import write_figures

        for path in write_figures(out):
            print(path, flush=True)
    except CushionError as error:
        print(f"figures: error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def _refuse_without_matplotlib() -> None:
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise UsageError(
            "matplotlib is not installed, so no figures can be drawn; "
            "install it: .venv/bin/python -m pip install matplotlib"
        ) from None


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
