"""How loud anything here may ever set a device: the rule that all volumes go through."""

from __future__ import annotations

import math

from device.errors import UsageError

MAX_VOLUME_DB = 0.0
"""Above it a device amplifies what is full scale already; nothing here ever sets more."""


def limit_volume_db(
    wanted_db: float, lowest_db: float, what: str, limit_db: float = MAX_VOLUME_DB
) -> float:
    """Return a level in dB that is neither above `wanted_db`, limit_db nor 0 dB. Any thread.

    lowest_db: the least that can be set. what: is set, for people.

    Raises
    ------
    UsageError
        wanted_db is no number, or even the lowest level is above the limit.
    """
    most_db = min(MAX_VOLUME_DB, limit_db)
    if math.isnan(wanted_db):
        raise UsageError(f"volume {wanted_db} dB is no number; choose one up to {most_db:g}")
    if lowest_db > most_db:
        raise UsageError(
            f"the lowest volume of {what} is {lowest_db:+.2f} dB, above the limit of "
            f"{most_db:+.2f} dB: it cannot be set safely"
        )
    return min(wanted_db, most_db)
