"""The haptic device's own volume: set as it was asked for, whenever the device is opened."""

from __future__ import annotations

from collections.abc import Callable

from device.errors import CushionError

SetVolume = Callable[[float], None]
"""Sets a device to a level in dB and lifts its mute; raises CushionError where it cannot."""


class DeviceVolume:
    """What was asked for, and whether the device has it. For the supervisor alone.

    wanted_db: 0 or less; None leaves the device as it is. limit_db: what the rig allows, which is
    set instead where more is wanted. warning: why it has not what was asked for, "" while nothing
    speaks against it: the vibration plays all the same.
    """

    def __init__(self, wanted_db: float | None = None, limit_db: float = 0.0) -> None:
        self.wanted_db = wanted_db
        self.limit_db = limit_db
        self.warning = ""
        self._last: tuple[float | None, float] = None, limit_db

    def want(self, other: DeviceVolume) -> None:
        """Want what another one wants, which `follow` then sets."""
        self.wanted_db, self.limit_db = other.wanted_db, other.limit_db

    def set(self, set_volume: SetVolume) -> None:
        """Set it, before the device is played to; raises nothing."""
        self._last, self.warning = (self.wanted_db, self.limit_db), ""
        if self.wanted_db is None:
            return
        problem = ""
        if self.wanted_db > self.limit_db:
            problem = f"the rig allows no more than {self.limit_db:g} dB, which it is set to"
        try:
            set_volume(min(self.wanted_db, self.limit_db))
        except CushionError as error:
            problem = str(error)
        if problem:
            self.warning = f"device_volume_db = {self.wanted_db:g}: {problem}"

    def follow(self, set_volume: SetVolume) -> None:
        """Set it if another one was asked for meanwhile; raises nothing.

        What a user sets elsewhere while the device plays stays.
        """
        if (self.wanted_db, self.limit_db) != self._last:
            self.set(set_volume)
