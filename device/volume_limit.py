"""The limit for every volume that this program sets on a device."""

from __future__ import annotations

import math

from device.errors import UsageError

MAX_VOLUME_DB = 0.0
"""Highest level that is ever set: above it, a device amplifies full-scale signals."""


def limit_volume_db(
    wanted_db: float, lowest_db: float, what: str, limit_db: float = MAX_VOLUME_DB
) -> float:
    """Return the level in dB to set: at most wanted_db, limit_db and 0 dB.

    lowest_db: the lowest level that the device has. what: its name for messages.

    UsageError: wanted_db is NaN, or even the lowest level is above the limit.
    """
    most_db = min(MAX_VOLUME_DB, limit_db)
    if math.isnan(wanted_db):
        raise UsageError(f"volume {wanted_db} dB is not a number; choose one up to {most_db:g}")
    if lowest_db > most_db:
        raise UsageError(
            f"the lowest volume of {what} is {lowest_db:+.2f} dB, above the limit of "
            f"{most_db:+.2f} dB: it cannot be set safely"
        )
    return min(wanted_db, most_db)
