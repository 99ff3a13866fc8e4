"""The Turtle files of the LV2 bundle, which describe the plugin's variants to hosts."""

from __future__ import annotations

import re
from collections.abc import Sequence

from audioflinger_hook.plugin.variants import AUDIO, CONTROL, INPUT, PluginVariant, Port

BINARY = "haptic_cushion.so"
DESCRIPTION = "haptic_cushion.ttl"
PREFIX = "urn:haptic-cushion:"
LATENCY = "latency"

_PREFIXES = """\
@prefix doap:  <http://usefulinc.com/ns/doap#> .
@prefix lv2:   <http://lv2plug.in/ns/lv2core#> .
@prefix rdfs:  <http://www.w3.org/2000/01/rdf-schema#> .
@prefix units: <http://lv2plug.in/ns/extensions/units#> .
"""

_UNITS = {"dB": "units:db", "ms": "units:ms", "dBFS": "units:db"}


def manifest(variants: Sequence[PluginVariant], marker: str) -> str:
    """Return manifest.ttl: which plugins there are, and where. marker: a comment's text."""
    entries = [
        f"<{PREFIX}{variant.profile}>\n    a lv2:Plugin ;\n    lv2:binary <{BINARY}> ;\n"
        f"    rdfs:seeAlso <{DESCRIPTION}> .\n"
        for variant in variants
    ]
    return "\n".join((f"# {marker}\n{_PREFIXES}", *entries))


def description(variants: Sequence[PluginVariant], marker: str) -> str:
    """Return the file that describes the plugins and their ports. marker: a comment's text."""
    return "\n".join((f"# {marker}\n{_PREFIXES}", *map(_plugin, variants)))


def _plugin(variant: PluginVariant) -> str:
    ports = " , ".join(_port(index, port) for index, port in enumerate(variant.ports))
    return (
        f"<{PREFIX}{variant.profile}>\n"
        "    a lv2:Plugin , lv2:ConverterPlugin ;\n"
        f'    doap:name "{variant.name}" ;\n'
        "    doap:license <https://www.apache.org/licenses/LICENSE-2.0> ;\n"
        '    rdfs:comment "Turns sound into vibration for a cushion or seat." ;\n'
        "    lv2:minorVersion 2 ;\n"
        "    lv2:microVersion 0 ;\n"
        "    lv2:optionalFeature lv2:hardRTCapable ;\n"
        f"    lv2:port {ports} .\n"
    )


def _port(index: int, port: Port) -> str:
    direction = "lv2:InputPort" if port.kind & INPUT else "lv2:OutputPort"
    kind = "lv2:AudioPort" if port.kind & AUDIO else "lv2:ControlPort"
    lines = [
        f"a {direction} , {kind}",
        f"lv2:index {index}",
        f'lv2:symbol "{symbol(port.name)}"',
        f'lv2:name "{port.name}"',
    ]
    if port.kind & CONTROL and port.kind & INPUT:
        lines += [
            "lv2:default 0.0",
            f"lv2:minimum {port.lower:.1f}",
            f"lv2:maximum {port.upper:.1f}",
        ]
    if port.toggled:
        lines.append("lv2:portProperty lv2:toggled")
    if port.name == LATENCY:
        lines += ["lv2:portProperty lv2:reportsLatency", "lv2:designation lv2:latency"]
        lines.append("units:unit units:frame")
    unit = re.search(r"\((\w+)\)", port.name)
    if unit:
        lines.append(f"units:unit {_UNITS[unit[1]]}")
    body = " ;\n        ".join(lines)
    return f"[\n        {body}\n    ]"


def symbol(name: str) -> str:
    """Return a port's name as a symbol, such as "gain" for "Gain (dB)"."""
    return re.sub(r"\W+", "_", name.partition(" (")[0].lower())
