"""The variants (plugins) in the compiled file, and Turtle files that describe them for LV2."""

import ctypes
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from audioflinger_hook.core import FILE_NAME
from device.errors import NotFoundError

INPUT, OUTPUT, CONTROL, AUDIO = 1, 2, 4, 8
TOGGLED = 0x4

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


class _Range(ctypes.Structure):
    _fields_ = (("hint", ctypes.c_int), ("lower", ctypes.c_float), ("upper", ctypes.c_float))


class VariantDescriptor(ctypes.Structure):
    """The first fields of LADSPA_Descriptor, which describes a variant and its ports."""

    _fields_: ClassVar[Sequence[tuple[str, Any]]] = (
        ("unique_id", ctypes.c_ulong),
        ("label", ctypes.c_char_p),
        ("properties", ctypes.c_int),
        ("name", ctypes.c_char_p),
        ("maker", ctypes.c_char_p),
        ("copyright", ctypes.c_char_p),
        ("port_count", ctypes.c_ulong),
        ("port_descriptors", ctypes.POINTER(ctypes.c_int)),
        ("port_names", ctypes.POINTER(ctypes.c_char_p)),
        ("port_ranges", ctypes.POINTER(_Range)),
    )


@dataclass(frozen=True)
class Port:
    """One port, with default value 0. kind: INPUT or OUTPUT, plus CONTROL or AUDIO."""

    name: str
    kind: int
    toggled: bool
    lower: float
    upper: float


@dataclass(frozen=True)
class PluginVariant:
    """One plugin in the file. label: identifier. name: text for users."""

    label: str
    name: str
    ports: tuple[Port, ...]

    @property
    def profile(self) -> str:
        """Last part of the label: a profile, or "mono"."""
        return self.label.rpartition("_")[2]


def public_variants(plugin: Path) -> tuple[PluginVariant, ...]:
    """Return all variants except the daemon's. NotFoundError: the plugin cannot be loaded."""
    try:
        describe = ctypes.CDLL(str(plugin)).ladspa_descriptor
    except (OSError, AttributeError) as error:
        raise NotFoundError(f"the plugin cannot be loaded: {error}; run `make run`") from None
    describe.argtypes, describe.restype = [ctypes.c_ulong], ctypes.POINTER(VariantDescriptor)
    variants: list[PluginVariant] = []
    while found := describe(len(variants)):
        shown, ports = found.contents, []
        for port in range(shown.port_count):
            name, kind = shown.port_names[port].decode(), shown.port_descriptors[port]
            limits = shown.port_ranges[port]
            ports.append(Port(name, kind, bool(limits.hint & TOGGLED), limits.lower, limits.upper))
        variants.append(PluginVariant(shown.label.decode(), shown.name.decode(), tuple(ports)))
    return tuple(variant for variant in variants if variant.label != "haptic_cushion_daemon")


def manifest(variants: Sequence[PluginVariant], marker: str) -> str:
    """Return the text of manifest.ttl, the list of plugins. marker: text of the first comment."""
    entries = [
        f"<{PREFIX}{variant.profile}>\n    a lv2:Plugin ;\n    lv2:binary <{FILE_NAME}> ;\n"
        f"    rdfs:seeAlso <{DESCRIPTION}> .\n"
        for variant in variants
    ]
    return "\n".join((f"# {marker}\n{_PREFIXES}", *entries))


def description(variants: Sequence[PluginVariant], marker: str) -> str:
    """Return the text that describes plugins and ports. marker: text of the first comment."""
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
    symbol = re.sub(r"\W+", "_", port.name.partition(" (")[0].lower())  # gain for "Gain (dB)"
    lines = [
        f"a {direction} , {kind}",
        f"lv2:index {index}",
        f'lv2:symbol "{symbol}"',
        f'lv2:name "{port.name}"',
    ]
    if port.kind & CONTROL and port.kind & INPUT:
        lines += ["lv2:default 0.0", f"lv2:minimum {port.lower:.1f}"]
        lines.append(f"lv2:maximum {port.upper:.1f}")
    if port.toggled:
        lines.append("lv2:portProperty lv2:toggled")
    if port.name == LATENCY:
        lines += ["lv2:portProperty lv2:reportsLatency", "lv2:designation lv2:latency"]
        lines.append("units:unit units:frame")
    unit = re.search(r"\((\w+)\)", port.name)
    if unit:
        lines.append(f"units:unit {_UNITS[unit[1]]}")
    return "[\n        " + " ;\n        ".join(lines) + "\n    ]"
