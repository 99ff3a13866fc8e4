"""Channels with coils, of devices whose other channels drive something else.

Devices outside this list have coils on every channel, or on those that the user names.
"""

from __future__ import annotations

_DUALSENSE = (2, 3)
"""Channels 0 and 1 are its speaker and headphones."""

_COILS = {
    ("054c", "0ce6"): _DUALSENSE,
    ("054c", "0df2"): _DUALSENSE,  # Edge
}


def coil_channels(vendor_id: str, product_id: str) -> tuple[int, ...]:
    """Return the channels with coils, counted from 0; () for a device that is not listed.

    vendor_id, product_id: four hexadecimal digits each, in lower case.
    """
    return _COILS.get((vendor_id, product_id), ())
