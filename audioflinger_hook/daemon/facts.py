"""Settings as facts of a capture, and back: a replay needs no other file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from audioflinger_hook.capture.format import Facts
from audioflinger_hook.settings import Settings
from audioflinger_hook.transform import TransformParameters
from device.errors import UsageError
from device.rig.rig_file import SHIPPED

NESTED = "parameters"
"""The field of `Settings` whose own fields stand beside the others."""


def facts_of(settings: Settings) -> Facts:
    """Return every setting by its name; a path is absolute, what is not set is left out."""
    chosen = {field.name: getattr(settings, field.name) for field in fields(settings)}
    parameters = chosen.pop(NESTED)
    chosen |= {field.name: getattr(parameters, field.name) for field in fields(parameters)}
    facts: dict[str, str | int | float | bool] = {}
    for name, value in chosen.items():
        if isinstance(value, Path):
            value = str(value.absolute())
        if name == "rig" and value not in SHIPPED:  # a file
            value = str(Path(value).absolute())
        if value is not None:
            facts[name] = value
    return facts


def settings_from(facts: Facts) -> Settings | None:
    """Return the settings that a run's capture names, None where it names none.

    Raises
    ------
    UsageError
        They cannot be used, by this version at least.
    """
    if "form" not in facts:
        return None
    try:
        parameters = TransformParameters(**_named(TransformParameters, facts))
        chosen = _named(Settings, facts)
        chosen.pop(NESTED, None)
        if "effects_file" in chosen:
            chosen["effects_file"] = Path(chosen["effects_file"])
        return Settings(**chosen, parameters=parameters)
    except (UsageError, TypeError) as error:
        raise UsageError(
            f"the settings in the capture cannot be used ({error}); give others with --config"
        ) from None


def _named(kind: type[Any], facts: Mapping[str, Any]) -> dict[str, Any]:
    names = {field.name for field in fields(kind)}
    return {name: value for name, value in facts.items() if name in names}
