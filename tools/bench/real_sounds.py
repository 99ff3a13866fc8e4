"""Measure profiles on real sounds: python -m tools.bench.real_sounds [--half HALF] [PROFILE ...]

Prints the section "On real sounds" as Markdown. Loudness is read from .cache/loudness.json; the
first run computes it in a few minutes, any other run takes about one.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from audioflinger_hook.config.profiles import PROFILES
from device.atomic_file import write_bytes_atomically
from device.errors import CushionError
from tools.bench.figures.pictures import png_of
from tools.bench.report import section_markdown
from tools.bench.sections.real_sounds import PARTS, chosen
from tools.bench.sounds.real_sounds import HALVES, SOUNDS_COMMAND, sounds_folder


def main(arguments: Sequence[str] | None = None) -> int:
    """Return the exit code: 0, or 2 where there are no sounds or a parameter is wrong."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench.real_sounds", description=__doc__)
    parser.add_argument("profiles", nargs="*", metavar="PROFILE", help=", ".join(PROFILES))
    parser.add_argument("--half", choices=HALVES, default="choose", help="which of the sounds")
    parser.add_argument("--peers", action="store_true", help="the other methods as well")
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="a parameter of all"
    )
    parser.add_argument("--part", choices=PARTS, action="append", help="only this; may be repeated")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the PNG, too")
    options = parser.parse_args(arguments)
    if sounds_folder() is None:
        print(f"real_sounds: error: there are no sounds; run {SOUNDS_COMMAND}", file=sys.stderr)
        return 2
    said = dict(_value(each) for each in options.set)
    try:
        section = chosen(
            options.half, options.profiles or tuple(PROFILES), said, options.peers,
            options.part or PARTS,
            lambda text: print(text, file=sys.stderr),
        )  # fmt: skip
    except CushionError as error:
        print(f"real_sounds: error: {error}", file=sys.stderr)
        return 2
    print(section_markdown(section))
    if options.picture:
        write_bytes_atomically(options.picture, png_of(section))
    return 0


def _value(said: str) -> tuple[str, Any]:
    """Return name and value of NAME=VALUE, a number where it is one."""
    name, _, value = said.partition("=")
    try:
        number = float(value)
    except ValueError:
        return name, value
    return name, int(number) if value.isdigit() else number


if __name__ == "__main__":
    sys.exit(main())
