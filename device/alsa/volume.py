"""A whole card's volume, for whoever only wants it to play at a level."""

from __future__ import annotations

from pathlib import Path

from device.alsa.mixer import CardMixer
from device.alsa.use import DEVICES
from device.errors import NotFoundError, UsageError
from device.volume_limit import LOUDEST_DB


def set_card_volume(
    card: int, wanted_db: float, limit_db: float = LOUDEST_DB, devices: Path = DEVICES
) -> tuple[float, ...]:
    """Set all a card plays to wanted_db and lift its mutes; return the level of each volume in dB.

    Nothing becomes louder than wanted_db, limit_db or 0 dB: steps are rounded down, and of volumes
    that lie behind one another each is set. The volumes first, so that nothing is heard louder for
    a moment. card: ALSA's number. devices: the folder of device files. Any thread.

    Raises
    ------
    NotFoundError
        The card is not there, or has neither volume nor mute.
    UsageError
        wanted_db is no number, or of a volume nobody knows what its steps are in dB, or it cannot
        be set so low; it stays as it is, all others are set, and mutes are not lifted.
    """
    with CardMixer(card, devices) as mixer:
        if not mixer.volumes and not mixer.switches:
            raise NotFoundError(
                f"sound card {card} has no volume of its own; set the level with gain_db, or at "
                "the amplifier"
            )
        levels_db, failures = [], []
        for volume in mixer.volumes:
            try:
                levels_db.append(mixer.set_volume_db(volume, wanted_db, limit_db))
            except UsageError as error:
                failures.append(str(error))
        if failures:
            raise UsageError("; ".join(failures))
        for switch in mixer.switches:
            mixer.set_muted(switch, False)
    return tuple(levels_db)
