"""`cushion inspect`: lists the principal frequencies of each unit (analysis window) of a sound."""

import argparse
import dataclasses
import json
from itertools import chain

from audioflinger_hook.cli.terminal import warn
from audioflinger_hook.offline.inspection import Unit, inspect_file

HEADER = (
    f"{'unit':>6} {'start s':>12}   {'audio Hz':>9} {'amplitude':>9} "
    f"{'width Hz':>8} {'r':>8}   {'vibration Hz':>12}"
)


def run(options: argparse.Namespace) -> int:
    """Print the principal frequencies of a file's units, as a table or as a JSON list."""
    as_json: bool = options.json
    units = inspect_file(options.input, at_s=options.at, warn=warn)
    first = next(units, None)  # raises errors before anything is printed
    print("[" if as_json else HEADER)
    separator = ""
    for unit in chain([first] if first else [], units):
        if as_json:
            print(separator + json.dumps(dataclasses.asdict(unit)), end="")
            separator = ",\n"
        else:
            print(_rows(unit))
    if as_json:
        print("\n]")
    return 0


def _rows(unit: Unit) -> str:
    start = f"{unit.unit:>6} {unit.start_s:>12.6f}   "
    if not unit.principal:
        return f"{start}{'-':>9}"
    rows = [
        f"{p.audio_hz:>9.2f} {p.amplitude:>9.4f} {p.bandwidth_hz:>8.2f} {p.r:>8.3f}   "
        f"{p.vibration_hz:>12.2f}"
        for p in unit.principal
    ]
    return start + ("\n" + " " * len(start)).join(rows)
