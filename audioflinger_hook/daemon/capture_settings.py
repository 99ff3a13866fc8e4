"""Settings as facts of a capture and back, so that a replay needs no other file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

from audioflinger_hook.capture.format import Facts
from audioflinger_hook.config.schema import RENAMED_PARAMETERS
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.transform import TransformParameters
from device.drive import ActuatorSettings
from device.errors import UsageError
from device.rig.rig_file import SHIPPED

NESTED = "parameters"
"""Field of `Settings` whose own fields are stored beside the others."""

SAID = "said"
"""Field stored as names separated by commas, omitted if there are none."""

ACTUATORS = "actuators"
"""Field stored as JSON, a list of tables as in a config file."""


def facts_of(settings: Settings) -> Facts:
    """Return every setting by its name; paths become absolute, unset ones are omitted."""
    chosen = {field.name: getattr(settings, field.name) for field in fields(settings)}
    parameters = chosen.pop(NESTED)
    chosen[ACTUATORS] = _as_text(chosen[ACTUATORS])
    chosen[SAID] = ",".join(chosen[SAID]) or None
    chosen |= {field.name: getattr(parameters, field.name) for field in fields(parameters)}
    facts: dict[str, str | int | float | bool] = {}
    for name, value in chosen.items():
        if isinstance(value, Path):
            value = str(value.absolute())
        if name == "rig":
            value = _absolute(value)
        if value is not None:
            facts[name] = value
    return facts


def settings_from(facts: Facts) -> Settings | None:
    """Return the settings that a run's capture names, None where it names none.

    UsageError: this version cannot use them.
    """
    if "form" not in facts:
        return None
    facts = {RENAMED_PARAMETERS.get(name, name): value for name, value in facts.items()}
    try:
        parameters = TransformParameters(**_named(TransformParameters, facts))
        chosen = _named(Settings, facts)
        chosen.pop(NESTED, None)
        if "effects_file" in chosen:
            chosen["effects_file"] = Path(chosen["effects_file"])
        if SAID in chosen:
            said = chosen[SAID].split(",")
            chosen[SAID] = tuple(RENAMED_PARAMETERS.get(name, name) for name in said)
        if ACTUATORS in chosen:
            tables = json.loads(chosen[ACTUATORS])
            chosen[ACTUATORS] = tuple(ActuatorSettings.from_values(table) for table in tables)
        return Settings(**chosen, parameters=parameters)
    except (UsageError, TypeError, ValueError, KeyError) as error:
        raise UsageError(
            f"the settings in the capture cannot be used ({error}); give others with --config"
        ) from None


def _as_text(actuators: tuple[ActuatorSettings, ...]) -> str | None:
    if not actuators:
        return None
    tables = [
        asdict(replace(one, rig=None if one.rig is None else _absolute(one.rig)))
        for one in actuators
    ]
    said = [{key: value for key, value in one.items() if value is not None} for one in tables]
    return json.dumps(said)


def _absolute(rig: str) -> str:
    """Return a rig's name, or the absolute path of its file."""
    return rig if rig in SHIPPED else str(Path(rig).absolute())


def _named(kind: type[Any], facts: Mapping[str, Any]) -> dict[str, Any]:
    names = {field.name for field in fields(kind)}
    return {name: value for name, value in facts.items() if name in names}
