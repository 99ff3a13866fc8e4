"""All mistakes of a config file, and of the effects file that it names."""

from pathlib import Path

from audioflinger_hook.config.file import Config, check
from audioflinger_hook.config.profiles import LIVE_DEFAULT
from audioflinger_hook.config.toml_text import Mistake
from audioflinger_hook.pipeline.framework import Framework
from device.errors import UsageError

SAMPLERATE = 48_000  # sample rate in Hz for checking an effects file


def find_mistakes(path: Path) -> tuple[Config | None, list[str], list[Mistake]]:
    """Return the settings of a config file, warnings, and all mistakes in it.

    The settings are None if there are mistakes, except those of the effects file.
    UsageError: the file cannot be read or is not text.
    """
    found, mistakes = check(path, LIVE_DEFAULT)
    warnings: list[str] = []
    if found and (effects := found.settings.effects_file):
        try:
            warnings = Framework(SAMPLERATE, 2, found.settings).warnings
        except UsageError as error:
            why = f"cannot be used: {error}"
            allowed = "an audio_effects.xml that applies the haptic effect"
            mistakes = [Mistake("effects_file", 0, f'"{effects}"', why, allowed)]
    return found, warnings, mistakes
