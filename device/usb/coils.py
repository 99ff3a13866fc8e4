"""Which channels of a device drive coils, where its others drive something else.

A device that is not listed has coils on every channel, or on those that the user names.
"""

from __future__ import annotations

_DUALSENSE = (2, 3)
"""Behind the two of its speaker and headphones."""

_COILS = {
    ("054c", "0ce6"): _DUALSENSE,
    ("054c", "0df2"): _DUALSENSE,  # Edge
}


def coil_channels(vendor_id: str, product_id: str) -> tuple[int, ...]:
    """Return the channels with coils, counted from 0; () for a device that is not listed.

    vendor_id, product_id: four hexadecimal digits each, in lower case.
    """
    return _COILS.get((vendor_id, product_id), ())
