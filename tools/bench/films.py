"""Measure films and single sounds: python -m tools.bench.films [--profile NAME] [--films 6]

The program prints the measured values, and the limits that apply to them. --render MODULE:FUNCTION
measures a function that converts sound, (frames,) at 48 kHz, to vibration, (frames,), which must
not be delayed. Loudness is cached in .cache/loudness.json, so the first run takes longer.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from audioflinger_hook.config.profiles import PROFILES
from device.errors import CushionError
from tools.bench.methods import function_method, other_methods, profile_methods
from tools.bench.report import NOT_MET, Row
from tools.bench.sections.real_sounds import PARTS, material, parts
from tools.bench.sounds.films import LAYOUTS
from tools.bench.sounds.real_sounds import HALVES, SOUNDS_COMMAND, sounds_folder


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the measured rows; return exit code 0, or 2 for missing sounds or a wrong option."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench.films", description=__doc__)
    parser.add_argument("--profile", action="append", choices=PROFILES, help="may be repeated")
    parser.add_argument("--render", action="append", default=[], metavar="MODULE:FUNCTION")
    parser.add_argument("--others", action="store_true", help="also other methods and null models")
    parser.add_argument("--films", type=int, default=6, help="number of films of each kind")
    parser.add_argument("--kind", action="append", choices=LAYOUTS, help="kind of films")
    parser.add_argument("--half", choices=HALVES, default="choose", help="half of the sounds")
    parser.add_argument("--sounds", type=int, help="most of each class; all by default")
    parser.add_argument("--part", choices=PARTS, action="append", help="only this part")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE")
    options = parser.parse_args(arguments)
    if sounds_folder() is None:
        print(f"films: error: there are no sounds; run {SOUNDS_COMMAND}", file=sys.stderr)
        return 2
    try:
        methods = [function_method(each) for each in options.render]
        names = options.profile or ([] if methods else ["cinema"])
        methods += profile_methods(names, dict(_value(each) for each in options.set))
        methods += other_methods() if options.others else []
    except CushionError as error:
        print(f"films: error: {error}", file=sys.stderr)
        return 2
    of = replace(
        material(options.half, options.sounds, options.films), kinds=options.kind or tuple(LAYOUTS)
    )
    measured = parts(methods, of, {})
    for part in options.part or PARTS:
        started = time.monotonic()
        show(list(measured[part]()))
        print(f"-- {part}: {time.monotonic() - started:.1f} s", flush=True)
    return 0


def _value(said: str) -> tuple[str, Any]:
    name, _, value = said.partition("=")
    try:
        number = float(value)
    except ValueError:
        return name, value
    return name, int(number) if value.isdigit() else number


def show(rows: Sequence[Row]) -> None:
    """Print one line for each row name, with the values of all columns, and the notes below it."""
    for name in dict.fromkeys(row.name for row in rows):
        mine = [row for row in rows if row.name == name]
        cells = []
        for row in mine:
            limit = f" ({row.must.shown(row.unit)})" if row.must else ""
            wrong = f" {NOT_MET}" if row.met is False else ""
            cells.append(f"{row.column} {row.shown()}{limit}{wrong}")
        print(f"{name}: {'; '.join(cells)}")
        notes = [row.note for row in mine if row.note and row.value is not None]
        if notes:
            print(f"    {'; '.join(notes)}")


if __name__ == "__main__":
    sys.exit(main())
