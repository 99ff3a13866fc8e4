"""`cushion check`: every mistake of a config file at once."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from pathlib import Path

from audioflinger_hook.config import file as config
from device.errors import UsageError


def run(options: argparse.Namespace) -> int:
    """Check a config file; exit 2 where it has mistakes."""
    path: Path | None = options.config
    as_json: bool = options.json
    if path is None:
        path = config.default_path()
        if not path.exists():
            print("[]" if as_json else f"{path} does not exist: the defaults apply")
            return 0
    found, problems = config.check(path)
    if as_json:
        print(json.dumps([dataclasses.asdict(problem) for problem in problems], indent=2))
    elif found is not None:
        print(f"{path}: no mistakes")
    for problem in problems:
        print(f"cushion: error: {path}: {problem}", file=sys.stderr)
    return UsageError.exit_code if problems else 0
