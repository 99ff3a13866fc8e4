"""Names of USB devices: each leads to one device or to an error that says how to name one."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from device.address import parse_device
from device.errors import NotFoundError, NoUsbBusError, NoUsbDeviceError, UsageError
from device.usb import UsbIdentity, find_devices, find_one, identify
from tests.support.usb_tree import UsbTree

DAC = "0d8c:0014"

ids = st.from_regex(r"[0-9a-f]{4}", fullmatch=True)
ports = st.from_regex(r"[1-9][0-9]?-[1-9](\.[1-9][0-9]?){0,4}", fullmatch=True)
serials = st.text(min_size=1).filter(str.isprintable)


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
        ("usb:0d8c:0014:A42", "A42", ""),
        ("usb:0d8c:0014@1-2.3", "", "1-2.3"),
        ("usb:0D8C:0014:A42@1-2.3", "A42", "1-2.3"),
        ("usb:0d8c:0014:a:b c@home", "a:b c@home", ""),
        ("usb:0d8c:0014:x@1-2@2-1", "x@1-2", "2-1"),
    ],
)
def test_a_name_is_ids_then_perhaps_a_serial_then_perhaps_a_port(text, serial, port):
    expected = UsbIdentity("0d8c", "0014", serial, port)
    assert UsbIdentity.parse(text) == UsbIdentity.parse(text.removeprefix("usb:")) == expected
    address = parse_device(text)
    assert (str(address), address.usb) == (text, expected)
    assert parse_device("twin").usb is None


@pytest.mark.parametrize(
    "text",
    ["usb:", "usb:12", "usb:0d8c", "usb:0d8c:14", "usb:usb:0d8c:0014"]
    + [f"usb:0d8c:0014{rest}" for rest in (":", "@", "@2", "@usb1", " ", ":a\nb")],
)
def test_what_names_no_usb_device_is_refused_with_the_grammar(text):
    for parse in (UsbIdentity.parse, parse_device):
        with pytest.raises(UsageError, match=r"usb:VID:PID\[:SERIAL\]\[@PORT\]"):
            parse(text)


def test_a_dac_with_a_serial_of_its_own_keeps_its_name_in_every_port_and_as_every_card(tree):
    tree.plug("1-2", serial="A42", address=5, card=1)
    name = str(identify(tree.only, tree.devices))
    assert name == "usb:0d8c:0014:A42"
    tree.unplug("1-2")
    tree.plug("1-4.1", "1209:dac1", serial="X", address=6, card=1)
    tree.plug("1-3", serial="A42", address=7, card=2)
    after = find_one(UsbIdentity.parse(name), find_devices(tree.root))
    assert (after.port, after.address, after.cards[0].number) == ("1-3", 7, 2)
    assert str(identify(after, tree.devices)) == name


@pytest.mark.parametrize(
    ("serials", "names"),
    [
        ((None,), ["@1-2"]),
        (("A@1-9",), [":A@1-9@1-2"]),  # it looks like a port
        ((None, None), ["@1-2", "@1-3.1"]),
        (("20190808", "20190808"), [":20190808@1-2", ":20190808@1-3.1"]),
    ],
)
def test_two_alike_and_those_without_a_serial_are_told_apart_by_their_ports(tree, serials, names):
    for number, (port, serial) in enumerate(zip(("1-2", "1-3.1"), serials, strict=False)):
        tree.plug(port, serial=serial, address=5 + number, card=number)
    found = [identify(device, tree.devices) for device in tree.devices]
    assert [str(name) for name in found] == [f"usb:{DAC}{rest}" for rest in names]
    for name, device in zip(found, tree.devices, strict=True):
        assert find_one(UsbIdentity.parse(str(name)), find_devices(tree.root)) == device
        assert [one for one in tree.devices if name.is_device(one)] == [device]


@pytest.mark.parametrize("serial", ["", "A 42/b", "A_42_b", "C-Media_USB_Audio_A_42_b"])
def test_a_serial_may_be_left_out_or_be_as_udev_or_a_sound_server_shows_it(tree, serial):
    tree.plug("1-4", serial="A 42/b")
    one = find_one(UsbIdentity("0d8c", "0014", serial), find_devices(tree.root))
    assert (one.serial, one.port) == ("A 42/b", "1-4")


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
    ports = [find_one(UsbIdentity.parse(name), found).port for name in offered]
    assert ports == ["1-2", "1-3", "1-4"]


def test_where_there_is_no_bus_the_error_says_that_and_not_that_it_is_unplugged(tmp_path):
    found = find_devices(UsbTree(tmp_path, bus=False).root)
    with pytest.raises(NoUsbBusError, match=r"usb:0d8c:0014 is missing: no USB bus is visible"):
        find_one(UsbIdentity.parse(f"usb:{DAC}"), found)
