"""Identified values in a rig and its file, each with its interval."""

import json
from dataclasses import fields, replace
from pathlib import Path

from device.atomic_file import write_bytes_atomically
from device.identification.output_error import Estimate
from device.rig.rig import Rig, Source

Values = dict[str, Estimate]
"""By parameter of the actuator, such as "actuator.resonance_hz"."""


def add_values(rig: Rig, values: Values, words: str, *, assumed: bool = False) -> Rig:
    """Return the rig with identified values; the words name the sweep and its level.

    Values that rely on assumed ones stay "assumed" and have no interval.
    """
    known = tuple(
        Source(name, "assumed", words)
        if assumed
        else Source(name, "identified", words, estimate.interval)
        for name, estimate in values.items()
    )
    others = tuple(source for source in rig.sources if source.parameter not in values)
    found = {name.removeprefix("actuator."): estimate.value for name, estimate in values.items()}
    return replace(rig, actuator=replace(rig.actuator, **found), sources=others + known)


def format_rig(rig: Rig) -> str:
    """Return the rig as TOML for `read_rig`, with every source."""
    sources = {source.parameter: source for source in rig.sources}
    lines = [f"name = {json.dumps(rig.name)}"]
    for stage, parameters in rig.stages().items():
        lines += ["", f"[{stage}]"]
        for field in fields(parameters):
            value = _toml(getattr(parameters, field.name))
            if source := sources.get(f"{stage}.{field.name}"):
                interval = ""
                if source.interval:
                    low, high = source.interval
                    interval = f", interval = [{_toml(low)}, {_toml(high)}]"
                value = (
                    f"{{ value = {value}, {source.kind} = {json.dumps(source.words)}{interval} }}"
                )
            lines.append(f"{field.name} = {value}")
    return "\n".join(lines) + "\n"


def write_rig(rig: Rig, path: str | Path) -> None:
    """Write the rig's file atomically; see `write_bytes_atomically` for errors."""
    write_bytes_atomically(path, format_rig(rig).encode())


def _toml(value: object) -> str:
    if isinstance(value, str):
        return json.dumps(value)
    return repr(float(value)) if isinstance(value, float) else str(value)
