"""`cushion check`: prints all mistakes of a config file, or the JSON Schema of its keys."""

import argparse
import dataclasses
import json
from pathlib import Path

from audioflinger_hook.cli.terminal import complain, warn
from audioflinger_hook.config import file as config
from audioflinger_hook.config.profiles import LIVE_DEFAULT
from audioflinger_hook.config.schema import json_schema
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.config.toml_text import Mistake
from audioflinger_hook.pipeline.framework import Framework
from device.errors import UsageError

SAMPLERATE = 48_000  # sample rate in Hz for checking an effects file


def run(options: argparse.Namespace) -> int:
    """Check a config file and the effects file that it names. Exit code 2: there are mistakes."""
    path: Path | None = options.config
    as_json: bool = options.json
    if options.schema:
        print(json.dumps(json_schema(), indent=2))
        return 0
    if path is None:
        path = config.default_path()
        if not path.exists():
            print("[]" if as_json else f"{path} does not exist: the defaults apply")
            return 0
    _, warnings, mistakes = find_mistakes(path)
    if as_json:
        print(json.dumps([dataclasses.asdict(mistake) for mistake in mistakes], indent=2))
    elif not (mistakes or warnings):
        print(f"{path}: no mistakes")
    for warning in warnings:
        warn(warning)
    for mistake in mistakes:
        complain(f"{path}: {mistake}")
    return UsageError.exit_code if mistakes else 0


def find_mistakes(path: Path) -> tuple[config.Config | None, list[str], list[Mistake]]:
    """Return the settings of a config file, warnings, and all mistakes in it.

    The settings are None if there are mistakes, except those of the effects file.
    UsageError: the file cannot be read or is not text.
    """
    found, mistakes = config.check(path, LIVE_DEFAULT)
    warnings, wrong = _problems_of_effects(found.settings) if found else ([], [])
    return found, warnings, mistakes + wrong


def _problems_of_effects(settings: Settings) -> tuple[list[str], list[Mistake]]:
    path = settings.effects_file
    if path is None:
        return [], []
    try:
        return Framework(SAMPLERATE, 2, settings).warnings, []
    except UsageError as error:
        allowed = "an audio_effects.xml that applies the haptic effect"
        return [], [Mistake("effects_file", 0, f'"{path}"', f"cannot be used: {error}", allowed)]
