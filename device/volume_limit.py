"""The limit for every volume that this program sets on a device."""

import math

from device.errors import UsageError

MAX_VOLUME_DB = 0.0  # highest level that is ever set; a higher level would amplify the signal


def limit_volume_db(
    wanted_db: float, lowest_db: float, what: str, limit_db: float = MAX_VOLUME_DB
) -> float:
    """Return the level in dB to set: the lowest of wanted_db, limit_db and 0 dB (no gain).

    lowest_db: lowest level that the device allows. what: name of the volume control, for messages.
    UsageError: wanted_db is NaN, or lowest_db is above limit_db or 0 dB.
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
