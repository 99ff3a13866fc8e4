"""Names of USB devices: each leads to one device or to an error that says how to name one."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from device.address import parse_device
from device.errors import NotFoundError, UsageError
from device.usb import (
    NoUsbBusError,
    NoUsbDeviceError,
    UsbIdentity,
    find_devices,
    find_one,
    identify,
)
from tests.support.usb_tree import UsbTree

DAC = "0d8c:0014"

ids = st.from_regex(r"[0-9a-f]{4}", fullmatch=True)
ports = st.from_regex(r"[1-9][0-9]?-[1-9](\.[1-9][0-9]?){0,4}", fullmatch=True)
serials = st.text(min_size=1).filter(str.isprintable)


@pytest.fixture
def tree(tmp_path: Path) -> UsbTree:
    return UsbTree(tmp_path)


@given(ids, ids, st.just("") | serials, ports)
@example("0d8c", "0014", "A@1-2", "1-3")
@example("0d8c", "0014", "@1-2", "1-3.4")
@example("0d8c", "0014", ":@", "1-3")
def test_an_identity_written_out_is_the_same_identity(vendor, product, serial, port):
    identity = UsbIdentity(vendor, product, serial, port)
    assert UsbIdentity.parse(str(identity)) == identity


@pytest.mark.parametrize(
    ("text", "serial", "port"),
    [
        ("usb:0D8C:0014", "", ""),
        ("0d8c:0014", "", ""),
        ("usb:0d8c:0014:A42", "A42", ""),
        ("usb:0d8c:0014@1-2.3", "", "1-2.3"),
        ("usb:0d8c:0014:A42@1-2.3", "A42", "1-2.3"),
        ("usb:0d8c:0014:a:b c@home", "a:b c@home", ""),
        ("usb:0d8c:0014:x@1-2@2-1", "x@1-2", "2-1"),
    ],
)
def test_a_name_is_ids_then_perhaps_a_serial_then_perhaps_a_port(text, serial, port):
    assert UsbIdentity.parse(text) == UsbIdentity("0d8c", "0014", serial, port)


@pytest.mark.parametrize(
    "text",
    [
        "usb:",
        "usb:12",
        "usb:0d8c",
        "usb:0d8c:14",
        "usb:0d8c:0014:",
        "usb:0d8c:0014@",
        "usb:0d8c:0014@2",
        "usb:0d8c:0014@usb1",
        "usb:0d8c:0014 ",
        "usb:usb:0d8c:0014",
        "usb:0d8c:0014:a\nb",
    ],
)
def test_what_names_no_usb_device_is_refused_with_the_grammar(text):
    with pytest.raises(UsageError, match=r"usb:VID:PID\[:SERIAL\]\[@PORT\]"):
        UsbIdentity.parse(text)
    with pytest.raises(UsageError, match=r"usb:VID:PID\[:SERIAL\]\[@PORT\]"):
        parse_device(text)


def test_an_address_with_a_port_is_kept_as_it_is_written():
    address = parse_device("usb:0D8C:0014:A42@1-2.3")
    assert str(address) == "usb:0D8C:0014:A42@1-2.3"
    assert address.usb == UsbIdentity("0d8c", "0014", "A42", "1-2.3")
    assert parse_device("twin").usb is None


def test_a_dac_with_a_serial_of_its_own_keeps_its_name_in_every_port_and_as_every_card(tree):
    tree.plug("1-2", serial="A42", address=5, card=1)
    (before,) = find_devices(tree.root).devices
    name = str(identify(before, [before]))
    assert name == "usb:0d8c:0014:A42"
    tree.unplug("1-2")
    tree.plug("1-4.1", "1209:dac1", serial="X", address=6, card=1)
    tree.plug("1-3", serial="A42", address=7, card=2)
    found = find_devices(tree.root)
    after = find_one(UsbIdentity.parse(name), found)
    assert (after.port, after.address, after.cards[0].number) == ("1-3", 7, 2)
    assert str(identify(after, found.devices)) == name


@pytest.mark.parametrize("serial", [None, "20190808"])
def test_two_alike_are_told_apart_by_their_ports(tree, serial):
    tree.plug("1-2", serial=serial, address=5, card=1)
    tree.plug("1-3.1", serial=serial, address=6, card=2)
    found = find_devices(tree.root)
    names = [identify(device, found.devices) for device in found.devices]
    middle = f":{serial}" if serial else ""
    assert [str(name) for name in names] == [f"usb:{DAC}{middle}@1-2", f"usb:{DAC}{middle}@1-3.1"]
    assert [find_one(name, found) for name in names] == list(found.devices)


def test_a_device_without_a_serial_has_its_port_in_its_name_even_alone(tree):
    tree.plug("1-2")
    (device,) = find_devices(tree.root).devices
    assert str(identify(device, [device])) == "usb:0d8c:0014@1-2"


def test_a_serial_that_looks_like_a_port_is_not_taken_for_one(tree):
    tree.plug("1-2", serial="A@1-9")
    (device,) = find_devices(tree.root).devices
    name = identify(device, [device])
    assert str(name) == "usb:0d8c:0014:A@1-9@1-2"
    assert UsbIdentity.parse(str(name)).is_device(device)


def test_a_name_without_a_serial_finds_the_only_one_in_whatever_port(tree):
    tree.plug("1-4", serial="A42")
    found = find_devices(tree.root)
    assert find_one(UsbIdentity.parse(f"usb:{DAC}"), found).port == "1-4"


@pytest.mark.parametrize(
    "serial", ["A 42/b", "A_42_b", "C-Media_USB_Audio_A_42_b"], ids=["own", "udev", "server"]
)
def test_a_serial_may_be_written_as_udev_or_a_sound_server_shows_it(tree, serial):
    tree.plug(serial="A 42/b")
    found = find_devices(tree.root)
    assert find_one(UsbIdentity("0d8c", "0014", serial), found).serial == "A 42/b"


@pytest.mark.parametrize("serial", ["42", "A4", "a42", "A42 ", "USB_Audio_A42"])
def test_a_part_of_a_serial_is_not_the_serial(tree, serial):
    tree.plug(serial="A42")
    with pytest.raises(NoUsbDeviceError):
        find_one(UsbIdentity("0d8c", "0014", serial), find_devices(tree.root))


def test_a_name_of_nothing_there_is_answered_with_what_is_there_and_its_names(tree):
    tree.plug("1-2", serial="A42", card=1)
    tree.plug("1-3", "1209:dac1", product="Other", address=6)
    with pytest.raises(NoUsbDeviceError) as caught:
        find_one(UsbIdentity.parse("usb:0d8c:0014:B1"), find_devices(tree.root))
    assert str(caught.value) == (
        "usb:0d8c:0014:B1 is missing: plug it in, or name one of "
        "usb:0d8c:0014:A42 (C-Media USB Audio, port 1-2, card 1), "
        "usb:1209:dac1@1-3 (C-Media Other, port 1-3)"
    )


def test_a_name_of_several_is_answered_with_a_name_for_each(tree):
    tree.plug("1-2", serial="S", card=1)
    tree.plug("1-3", serial="S", address=6, card=2)
    tree.plug("1-4", serial="T", address=7)
    found = find_devices(tree.root)
    with pytest.raises(NotFoundError, match="not one device but 3") as caught:
        find_one(UsbIdentity.parse(f"usb:{DAC}"), found)
    offered = [word for word in str(caught.value).split() if word.startswith("usb:")][1:]
    assert offered == [f"usb:{DAC}:S@1-2", f"usb:{DAC}:S@1-3", f"usb:{DAC}:T"]
    assert [find_one(UsbIdentity.parse(name), found).port for name in offered] == [
        "1-2",
        "1-3",
        "1-4",
    ]


def test_where_there_is_no_bus_the_error_says_that_and_not_that_it_is_unplugged(tmp_path):
    found = find_devices(UsbTree(tmp_path, bus=False).root)
    with pytest.raises(NoUsbBusError, match=r"usb:0d8c:0014 is missing: no USB bus is visible"):
        find_one(UsbIdentity.parse(f"usb:{DAC}"), found)
