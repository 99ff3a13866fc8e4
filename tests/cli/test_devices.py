"""What `cushion devices` takes from the driver where descriptors do not tell."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from audioflinger_hook.cli.usb_formats import by_setting
from device.usb import UsbAudioDevice, find_devices
from tests.support.sound_cards import ADAPTIVE, ASYNC, Cards
from tests.support.usb_tree import UsbTree


@pytest.fixture
def device(tmp_path: Path) -> UsbAudioDevice:
    UsbTree(tmp_path / "machine").plug(card=1)
    (found,) = find_devices(tmp_path / "machine").devices
    return found


def test_rates_of_each_setting_are_those_that_the_driver_offers(
    device: UsbAudioDevice, tmp_path: Path
) -> None:
    Cards(tmp_path / "asound").plug(1, "DAC", stream=ASYNC)
    offered = by_setting(device, tmp_path / "asound")
    assert sorted(offered) == [(1, 1), (1, 2), (1, 3)]
    assert 192_000 in offered[1, 2].rates
    assert 192_000 not in offered[1, 3].rates


def test_a_card_that_went_meanwhile_or_of_another_device_offers_nothing(
    device: UsbAudioDevice, tmp_path: Path
) -> None:
    cards = Cards(tmp_path / "asound")
    assert by_setting(device, tmp_path / "asound") == {}
    cards.plug(2, "Other", stream=ADAPTIVE)
    assert by_setting(device, tmp_path / "asound") == {}
    shutil.rmtree(tmp_path / "asound")
    assert by_setting(device, tmp_path / "asound") == {}
