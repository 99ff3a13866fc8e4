"""What is found of USB audio devices in /sys, and what is said where nothing is."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from device.usb import NoUsbBusError, NoUsbDeviceError, find_devices
from tests.support import usb_builder
from tests.support.usb_shapes import SHAPES
from tests.support.usb_tree import CONTROL, HID, HOST, MIDI, STREAMING, UsbTree


@pytest.fixture
def tree(tmp_path: Path) -> UsbTree:
    return UsbTree(tmp_path)


def test_a_dac_is_described_without_being_opened(tree):
    raw = bytes(range(64))
    tree.plug("1-2", "0D8C:0014", serial="A42", address=7, card=1, descriptors=raw)
    (device,) = find_devices(tree.root).devices
    assert (device.vendor_id, device.product_id, device.serial) == ("0d8c", "0014", "A42")
    assert (device.manufacturer, device.product) == ("C-Media", "USB Audio")
    assert (device.port, device.bus, device.address) == ("1-2", 1, 7)
    assert device.path == f"/{HOST}/usb1/1-2"
    assert (device.speed, device.max_power_ma) == (480.0, 100)
    assert device.descriptors == raw
    assert device.node == tree.root / "dev/bus/usb/001/007"
    assert [(one.number, one.subclass, one.protocol) for one in device.interfaces] == [
        (0, 1, 0x20),
        (1, 2, 0x20),
    ]
    assert {one.driver for one in device.interfaces} == {"snd-usb-audio"}
    assert [(card.number, card.id, card.playback) for card in device.cards] == [(1, "DAC", (0,))]
    assert device.plays


def test_found_is_sorted_by_port_as_numbers(tree):
    for address, port in enumerate(("1-10", "1-2", "1-1.4", "1-1.10"), 5):
        tree.plug(port, address=address)
    ports = [device.port for device in find_devices(tree.root).devices]
    assert ports == ["1-1.4", "1-1.10", "1-2", "1-10"]


def test_a_dac_behind_two_hubs_has_its_own_card_and_the_hubs_are_none(tree):
    tree.plug("1-2", "05e3:0610", address=2, interfaces=[(9, 0)])
    tree.plug("1-2.3", "05e3:0610", address=3, interfaces=[(9, 0)])
    tree.plug("1-2.3.1", address=4, card=2)
    (device,) = find_devices(tree.root).devices
    assert device.port == "1-2.3.1"
    assert device.path == f"/{HOST}/usb1/1-2/1-2.3/1-2.3.1"
    assert [card.number for card in device.cards] == [2]


def test_a_card_that_is_not_usb_belongs_to_no_device(tree):
    tree.add_built_in_card(0)
    tree.plug(card=1)
    (device,) = find_devices(tree.root).devices
    assert [card.number for card in device.cards] == [1]


def test_of_a_composite_device_only_the_audio_interfaces_are_told(tree):
    tree.plug(interfaces=[CONTROL, STREAMING, HID], card=1)
    tree.plug("1-3", "046d:c31c", address=6, interfaces=[HID])
    (device,) = find_devices(tree.root).devices
    assert [interface.number for interface in device.interfaces] == [0, 1]


def test_a_device_without_a_driver_still_plays_as_far_as_its_interfaces_tell(tree):
    tree.plug(driver=None)
    (device,) = find_devices(tree.root).devices
    assert device.plays
    assert [interface.driver for interface in device.interfaces] == ["", ""]
    assert device.cards == ()


@pytest.mark.parametrize("card", [None, 1])
def test_a_device_only_for_midi_is_found_but_is_no_output(tree, card):
    tree.plug(interfaces=[CONTROL, MIDI], card=card, playback=(), product="Keys")
    found = find_devices(tree.root)
    assert len(found.devices) == 1
    assert not found.devices[0].plays
    assert isinstance(found.reason, NoUsbDeviceError)
    assert "'C-Media Keys' in port 1-2" in str(found.reason)


@pytest.mark.parametrize(
    ("shape", "plays"), [("headset_adapter", True), ("basic_3", True), ("record_only", False)]
)
@pytest.mark.parametrize("card", [None, 1])
def test_what_the_descriptors_tell_counts_where_no_card_plays(tree, shape, plays, card):
    record_only = usb_builder.configuration(
        usb_builder.control(0, 0), usb_builder.streaming(1, 1, 0, usb_builder.endpoint(0x81, 5, 96))
    )
    raw = usb_builder.device() + SHAPES.get(shape, record_only)
    tree.plug(card=card, playback=(), descriptors=raw)
    found = find_devices(tree.root)
    assert found.devices[0].plays is plays
    assert (found.reason is None) is plays


def test_the_number_of_the_active_configuration_is_told(tree):
    folder = tree.plug()
    (folder / "bConfigurationValue").write_text("2\n")
    tree.plug("1-3", address=6)
    found = find_devices(tree.root).devices
    assert [device.configuration for device in found] == [2, None]


def test_a_microphone_is_no_output_once_it_is_a_card(tree):
    tree.plug(card=1, playback=())
    assert not find_devices(tree.root).devices[0].plays


def test_a_container_without_a_bus_is_told_from_an_empty_socket(tmp_path):
    container = find_devices(UsbTree(tmp_path / "container", bus=False).root)
    empty = find_devices(UsbTree(tmp_path / "empty").root)
    assert container.devices == empty.devices == ()
    assert isinstance(container.reason, NoUsbBusError)
    assert "no USB bus is visible" in str(container.reason)
    assert isinstance(empty.reason, NoUsbDeviceError)
    assert "no USB audio device is plugged in" in str(empty.reason)


def test_a_bus_folder_without_buses_is_no_bus_unless_nodes_are_there(tmp_path):
    tree = UsbTree(tmp_path, bus=False)
    (tree.sys / "bus/usb/devices").mkdir(parents=True)
    assert isinstance(find_devices(tree.root).reason, NoUsbBusError)
    (tree.root / "dev/bus/usb").mkdir(parents=True)
    assert isinstance(find_devices(tree.root).reason, NoUsbDeviceError)


def test_what_a_device_does_not_say_is_empty(tree):
    folder = tree.plug(manufacturer=None, product=None, serial=None, descriptors=None)
    (folder / "speed").write_text("unknown\n")
    (folder / "bMaxPower").unlink()
    (device,) = find_devices(tree.root).devices
    assert (device.manufacturer, device.product, device.serial) == ("", "", "")
    assert (device.speed, device.max_power_ma, device.descriptors) == (0.0, None, b"")
    assert device.label == "0d8c:0014"


def test_odd_strings_become_one_printable_line(tree):
    tree.plug(product=b" USB\x00\x1b[31m\nAudio \xff\xfe ", serial=b"\x01\x02\r\n")
    (device,) = find_devices(tree.root).devices
    assert device.product == "USB��[31m�Audio ��"
    assert device.serial == "��"
    assert f"{device.label}{device.serial}".isprintable()


@pytest.mark.parametrize("name", ["idVendor", "busnum", "devnum"])
@pytest.mark.parametrize("content", [None, b"", b"none\n"])
def test_a_device_that_cannot_be_read_is_left_out_and_its_neighbour_is_not(tree, name, content):
    folder = tree.plug()
    tree.plug("1-3", address=6)
    (folder / name).unlink()
    if content is not None:
        (folder / name).write_bytes(content)
    assert [device.port for device in find_devices(tree.root).devices] == ["1-3"]


ATTRIBUTES = ["devnum", "busnum", "idVendor", "manufacturer", "serial", "bMaxPower", "descriptors"]


@pytest.mark.parametrize("name", [*ATTRIBUTES, "bInterfaceClass", "bInterfaceProtocol"])
def test_a_device_that_vanishes_while_it_is_read_is_left_out(tree, name, monkeypatch):
    tree.plug(serial="A42", card=1)
    tree.plug("1-3", address=6)
    read = Path.read_bytes

    def pulled_out(path: Path) -> bytes:
        if path.name == name and "1-2" in str(path) and tree.path("1-2").exists():
            tree.unplug("1-2")
        return read(path)

    monkeypatch.setattr(Path, "read_bytes", pulled_out)
    assert [device.port for device in find_devices(tree.root).devices] == ["1-3"]


def test_two_devices_that_change_places_while_one_is_read_are_never_mixed(tree, monkeypatch):
    tree.plug(serial="A42")
    read = Path.read_bytes

    def exchanged(path: Path) -> bytes:
        if path.name == "serial" and (tree.path("1-2") / "devnum").read_text() == "5\n":
            tree.unplug("1-2")
            tree.plug("1-2", "1209:dac1", serial="B1", address=6)
        return read(path)

    monkeypatch.setattr(Path, "read_bytes", exchanged)
    assert find_devices(tree.root).devices == ()
    (device,) = find_devices(tree.root).devices
    assert (device.vendor_id, device.serial) == ("1209", "B1")


def test_a_file_that_may_not_be_read_is_as_good_as_empty(tree, monkeypatch):
    tree.plug(serial="A42", card=1)
    read = Path.read_bytes

    def refused(path: Path) -> bytes:
        if path.name in ("descriptors", "id"):
            raise PermissionError(13, "Permission denied")
        return read(path)

    monkeypatch.setattr(Path, "read_bytes", refused)
    (device,) = find_devices(tree.root).devices
    assert (device.descriptors, device.serial) == (b"", "A42")
    assert device.cards[0].id == ""


def test_folders_that_may_not_be_listed_are_as_good_as_missing(tree, monkeypatch):
    tree.plug(card=1)
    listed = os.listdir

    def refused(path):
        if "sound" in str(path):
            raise PermissionError(13, "Permission denied")
        return listed(path)

    monkeypatch.setattr(os, "listdir", refused)
    (device,) = find_devices(tree.root).devices
    assert device.cards == ()


def test_finding_loads_neither_pyusb_nor_a_sound_servers_library():
    code = (
        "import sys; from device.usb import find_devices, sysfs; find_devices(); "
        "print(sorted({'usb', 'pulsectl'} & set(sys.modules)))"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "[]"
