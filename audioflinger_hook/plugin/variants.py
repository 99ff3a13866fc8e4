"""The plugin's variants as hosts see them: labels, ports and ranges, from the compiled file."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from device.errors import NotFoundError

INPUT, OUTPUT, CONTROL, AUDIO = 1, 2, 4, 8
TOGGLED = 0x4
OF_THE_DAEMON = ("haptic_cushion_daemon",)


class _Range(ctypes.Structure):
    _fields_ = (("hint", ctypes.c_int), ("lower", ctypes.c_float), ("upper", ctypes.c_float))


class VariantDescriptor(ctypes.Structure):
    """The beginning of LADSPA_Descriptor, which describes a variant and its ports."""

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
    """One port. kind: sum of INPUT or OUTPUT and CONTROL or AUDIO. The default is always 0."""

    name: str
    kind: int
    toggled: bool
    lower: float
    upper: float


@dataclass(frozen=True)
class PluginVariant:
    """One plugin of the file: its label, its name for people and its ports."""

    label: str
    name: str
    ports: tuple[Port, ...]

    @property
    def profile(self) -> str:
        """The last part of the label: the profile, or "mono"."""
        return self.label.rpartition("_")[2]


def public_variants(plugin: Path) -> tuple[PluginVariant, ...]:
    """Return the variants that any host may use, from the compiled plugin.

    NotFoundError: the file cannot be loaded.
    """
    return tuple(variant for variant in _variants(plugin) if variant.label not in OF_THE_DAEMON)


def _variants(plugin: Path) -> Iterator[PluginVariant]:
    try:
        describe = ctypes.CDLL(str(plugin)).ladspa_descriptor
    except (OSError, AttributeError) as error:
        raise NotFoundError(f"the plugin cannot be loaded: {error}; run `make run`") from None
    describe.argtypes, describe.restype = [ctypes.c_ulong], ctypes.POINTER(VariantDescriptor)
    index = 0
    while found := describe(index):
        index += 1
        shown = found.contents
        yield PluginVariant(
            shown.label.decode(),
            shown.name.decode(),
            tuple(
                Port(
                    shown.port_names[port].decode(),
                    shown.port_descriptors[port],
                    bool(shown.port_ranges[port].hint & TOGGLED),
                    shown.port_ranges[port].lower,
                    shown.port_ranges[port].upper,
                )
                for port in range(shown.port_count)
            ),
        )
