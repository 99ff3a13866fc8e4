"""`cushion check`: prints all mistakes of a config file, or the JSON Schema of its keys."""

import argparse
import dataclasses
import json
from pathlib import Path

from audioflinger_hook.cli.terminal import complain, warn
from audioflinger_hook.config import file as config
from audioflinger_hook.config.schema import json_schema
from audioflinger_hook.config.toml_text import Mistake, listed
from audioflinger_hook.pipeline.framework import find_mistakes
from device.errors import UsageError


def run(options: argparse.Namespace) -> int:
    """Check a config file and the effects file that it names. Exit code 2: there are mistakes."""
    path: Path | None = options.config
    if options.schema:
        print(json.dumps(json_schema(), indent=2))
        return 0
    if path is None:
        path = config.default_path()
        if not path.exists():
            print("[]" if options.json else f"{path} does not exist: the defaults apply")
            return 0
    warnings: list[str] = []
    try:
        _, warnings, mistakes = find_mistakes(path)
    except UsageError as error:
        if not options.json:
            raise
        mistakes = [Mistake(str(path), 0, "", str(error), "a config file in UTF-8")]
    mistakes = listed(mistakes)
    if options.json:
        print(json.dumps([dataclasses.asdict(mistake) for mistake in mistakes], indent=2))
    elif not (mistakes or warnings):
        print(f"{path}: no mistakes")
    warn(*warnings)
    for mistake in mistakes if not options.json else ():
        complain(f"{path}: {mistake}")
    return UsageError.exit_code if mistakes else 0
