"""The haptic device's own volume: set once for each opening, and again where another is wanted."""

from __future__ import annotations

import pytest

from audioflinger_hook.daemon.outputs.base import DeviceVolume
from device.errors import NotFoundError


def test_nothing_is_set_while_nothing_is_wanted() -> None:
    volume, levels_db = DeviceVolume(), list[float]()
    volume.set(levels_db.append)
    volume.update(levels_db.append)
    assert (levels_db, volume.warning) == ([], "")


def test_it_is_set_at_each_opening_and_between_them_only_where_another_is_wanted() -> None:
    volume, levels_db = DeviceVolume(-6.0), list[float]()
    for wanted_db in (-6.0, -6.0, -20.0, -20.0, None, -20.0):
        volume.wanted_db = wanted_db
        volume.update(levels_db.append)
    assert levels_db == [-6.0, -20.0, -20.0]
    volume.set(levels_db.append)
    assert levels_db[3:] == [-20.0]


def test_a_device_that_cannot_is_told_and_not_asked_again_until_it_is_opened_anew() -> None:
    asked = []

    def refuse(wanted_db: float) -> None:
        asked.append(wanted_db)
        raise NotFoundError("it has no volume")

    volume = DeviceVolume(-6.0)
    volume.set(refuse)
    volume.update(refuse)
    assert asked == [-6.0]
    assert volume.warning == "device_volume_db = -6: it has no volume"
    volume.set(asked.append)
    assert volume.warning == ""


def test_more_than_the_rig_allows_is_never_set_and_that_is_told() -> None:
    volume, levels_db = DeviceVolume(0.0, -6.0), list[float]()
    volume.set(levels_db.append)
    assert levels_db == [-6.0]
    assert volume.warning == (
        "device_volume_db = 0: the rig allows at most -6 dB, which is set instead"
    )
    volume.wanted_db, volume.limit_db = -10.0, -6.0
    volume.update(levels_db.append)
    assert (levels_db, volume.warning) == ([-6.0, -10.0], "")
    volume.wanted_db, volume.limit_db = -10.0, -20.0
    volume.update(levels_db.append)
    assert levels_db[2:] == [-20.0]


@pytest.mark.parametrize("wanted_db", [None, -3.0])
def test_a_warning_ends_with_what_it_was_about(wanted_db: float | None) -> None:
    def refuse(wanted_db: float) -> None:
        raise NotFoundError("no")

    volume = DeviceVolume(-6.0)
    volume.set(refuse)
    volume.wanted_db = wanted_db
    volume.update(lambda _: None)
    assert volume.warning == ""
