"""Names of ports in PipeWire's graph, from the positions that the sound server reports."""

from __future__ import annotations

from device.layouts import layout

_PORT_NAMES = {
    "mono": "MONO",
    "front-left": "FL",
    "front-right": "FR",
    "front-center": "FC",
    "lfe": "LFE",
    "rear-left": "RL",
    "rear-right": "RR",
    "rear-center": "RC",
    "side-left": "SL",
    "side-right": "SR",
    "front-left-of-center": "FLC",
    "front-right-of-center": "FRC",
    "top-center": "TC",
    "top-front-left": "TFL",
    "top-front-center": "TFC",
    "top-front-right": "TFR",
    "top-rear-left": "TRL",
    "top-rear-center": "TRC",
    "top-rear-right": "TRR",
}
"""PipeWire's port names of PulseAudio's positions."""


def port_names(channel_map: str, channels: int) -> tuple[str, ...]:
    """Return the end of each channel's port name, such as "FL"; AUX0, AUX1, ... if unknown.

    channel_map: positions in order, such as "front-left,front-right".
    """
    positions = channel_map.split(",") if channel_map else []
    names = tuple(
        _PORT_NAMES.get(position, position.upper().replace("-", "")) for position in positions
    )
    if len(names) == channels and len(set(names)) == channels:
        return names
    return tuple(f"AUX{channel}" for channel in range(channels))


def in_mixing_order(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the ends of port names in the order of the mixer's layout, if they are its positions.

    The transform adds channels in this order, and its sources go by it.
    """
    for known in (_REAR, _SIDE):
        wanted = tuple(known.get(name, name) for name in layout(len(names)))
        if sorted(wanted) == sorted(names):
            return wanted
    return names


_REAR = {"BL": "RL", "BR": "RR", "BC": "RC"}
"""PipeWire's names of Android's positions behind the listener."""

_SIDE = {"BL": "SL", "BR": "SR", "BC": "RC"}
"""The same of sinks whose only surrounds are at the sides."""
