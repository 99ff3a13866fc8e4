import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from audioflinger_hook.daemon.outputs.base import DeviceVolume
from device.errors import LostError, NotFoundError, UsageError
from device.volume_limit import limit_volume_db


def test_it_is_set_at_each_opening_and_between_them_only_where_another_is_wanted():
    volume, levels_db = DeviceVolume(), list[float]()
    volume.set(levels_db.append)
    assert (levels_db, volume.warning) == ([], "")
    for wanted_db in (-6.0, -6.0, -20.0, -20.0, None, -20.0):
        volume.wanted_db = wanted_db
        volume.update(levels_db.append)
    assert levels_db == [-6.0, -20.0, -20.0]
    volume.set(levels_db.append)
    assert levels_db[3:] == [-20.0]


def refuse(wanted_db: float) -> None:
    raise UsageError("it has no volume")


def lose(wanted_db: float) -> None:
    raise LostError("gone")


def test_a_device_that_cannot_does_not_play_and_is_asked_again_each_time():
    volume = DeviceVolume(-6.0)
    for attempt in (volume.set, volume.update, volume.update):
        words = "device_volume_db = -6 cannot be set.*it has no volume.*-db off"
        with pytest.raises(NotFoundError, match=words):
            attempt(refuse)
    levels_db: list[float] = []
    volume.update(levels_db.append)
    assert levels_db == [-6.0]
    volume.wanted_db = None
    volume.update(refuse)  # nothing is asked of it
    volume = DeviceVolume(-6.0)
    with pytest.raises(LostError):  # that the server is lost is no refusal of the device
        volume.set(lose)
    volume.update(levels_db.append)
    assert levels_db == [-6.0, -6.0]


def test_more_than_the_rig_allows_is_never_set_and_that_is_told():
    volume, levels_db = DeviceVolume(0.0, -6.0), list[float]()
    volume.set(levels_db.append)
    assert levels_db == [-6.0]
    warning = "device_volume_db = 0: the rig allows at most -6 dB, which is set instead"
    assert volume.warning == warning
    volume.wanted_db, volume.limit_db = -10.0, -6.0
    volume.update(levels_db.append)
    assert (levels_db, volume.warning) == ([-6.0, -10.0], "")
    volume.wanted_db, volume.limit_db = -10.0, -20.0
    volume.update(levels_db.append)
    assert (levels_db[2:], bool(volume.warning)) == ([-20.0], True)
    volume.wanted_db = None
    volume.update(levels_db.append)
    assert (levels_db[3:], volume.warning) == ([], "")


@given(st.floats(allow_nan=False), st.floats(-80.0, 20.0))
def test_no_level_above_0_db_nor_the_limit_is_ever_set(wanted_db, limit_db):
    level_db = limit_volume_db(wanted_db, -math.inf, "the device", limit_db)
    assert level_db <= min(0.0, limit_db)
    assert level_db == wanted_db or wanted_db > min(0.0, limit_db)
    with pytest.raises(UsageError, match="cannot be set safely"):
        limit_volume_db(-6.0, 1.0, "the device")
