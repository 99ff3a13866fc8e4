import os
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from device.address import parse_device
from device.errors import NotFoundError, NoUsbBusError, NoUsbDeviceError, UsageError
from device.usb import UsbIdentity, find_devices, find_one, identify
from tests.support import usb_builder
from tests.support.usb_shapes import SHAPES
from tests.support.usb_tree import CONTROL, HID, HOST, MIDI, STREAMING, UsbTree


def test_a_dac_is_described_without_being_opened(tree):
    raw = bytes(range(64))
    tree.plug("1-2", "0D8C:0014", serial="A42", address=7, card=1, descriptors=raw)
    device = tree.only
    assert (device.vendor_id, device.product_id, device.serial) == ("0d8c", "0014", "A42")
    assert (device.manufacturer, device.product) == ("C-Media", "USB Audio")
    assert (device.port, device.bus, device.address) == ("1-2", 1, 7)
    assert (device.speed, device.max_power_ma, device.descriptors) == (480.0, 100, raw)
    assert device.node == tree.root / "dev/bus/usb/001/007"
    assert [(one.number, one.subclass) for one in device.interfaces] == [(0, 1), (1, 2)]
    assert {one.driver for one in device.interfaces} == {"snd-usb-audio"}
    assert [(card.number, card.id, card.playback) for card in device.cards] == [(1, "DAC", (0,))]
    assert device.plays


def test_found_is_sorted_by_port_as_numbers(tree):
    for address, port in enumerate(("1-10", "1-2", "1-1.4", "1-1.10"), 5):
        tree.plug(port, address=address)
    assert tree.ports == ["1-1.4", "1-1.10", "1-2", "1-10"]


def test_a_dac_behind_two_hubs_has_its_own_card_and_no_other_is_of_a_device(tree):
    tree.plug("1-2", "05e3:0610", address=2, interfaces=[(9, 0)])
    tree.plug("1-2.3", "05e3:0610", address=3, interfaces=[(9, 0)])
    tree.plug("1-2.3.1", address=4, card=2)
    tree.add_built_in_card(0)
    assert (tree.ports, tree.only.path) == (["1-2.3.1"], f"/{HOST}/usb1/1-2/1-2.3/1-2.3.1")
    assert [card.number for card in tree.only.cards] == [2]


def test_of_a_composite_device_only_the_audio_interfaces_are_told(tree):
    tree.plug(interfaces=[CONTROL, STREAMING, HID], card=1)
    tree.plug("1-3", "046d:c31c", address=6, interfaces=[HID])
    assert [interface.number for interface in tree.only.interfaces] == [0, 1]


@pytest.mark.parametrize("card", [None, 1])
def test_a_device_only_for_midi_is_found_but_is_no_output(tree, card):
    tree.plug(interfaces=[CONTROL, MIDI], card=card, playback=(), product="Keys")
    assert not tree.only.plays
    with pytest.raises(NoUsbDeviceError, match="'C-Media Keys' in port 1-2"):
        raise find_devices(tree.root).reason  # type: ignore[misc]


RECORDS = usb_builder.configuration(
    usb_builder.control(0, 0), usb_builder.streaming(1, 1, 0, usb_builder.endpoint(0x81, 5, 96))
)


@pytest.mark.parametrize(
    ("raw", "plays"),
    [(SHAPES["headset_adapter"], True), (SHAPES["basic_3"], True), (RECORDS, False)],
)
@pytest.mark.parametrize("card", [None, 1])
def test_what_the_descriptors_tell_counts_where_no_card_plays(tree, raw, plays, card):
    tree.plug(card=card, playback=(), descriptors=usb_builder.device() + raw)
    assert tree.only.plays is plays
    assert (find_devices(tree.root).reason is None) is plays


@pytest.mark.parametrize("card", [1, None])
def test_without_descriptors_the_card_and_then_the_interfaces_count(tree, card):
    driver = "snd-usb-audio" if card else None
    tree.plug(card=card, driver=driver, playback=())
    assert tree.only.plays is (card is None)
    assert [interface.driver for interface in tree.only.interfaces] == [driver or ""] * 2
    assert len(tree.only.cards) == (card is not None)


def test_the_number_of_the_active_configuration_is_told(tree):
    (tree.plug() / "bConfigurationValue").write_text("2\n")
    tree.plug("1-3", address=6)
    assert [device.configuration for device in tree.devices] == [2, None]


def test_a_container_without_a_bus_is_told_from_an_empty_socket(tmp_path):
    tree = UsbTree(tmp_path / "container", bus=False)
    for folder in ("", "bus/usb/devices"):  # the kernel's folder, but no bus in it
        (tree.sys / folder).mkdir(parents=True, exist_ok=True)
        assert tree.devices == ()
        with pytest.raises(NoUsbBusError, match="no USB bus is visible"):
            raise find_devices(tree.root).reason  # type: ignore[misc]
        with pytest.raises(NoUsbBusError, match=r"usb:0d8c:0014 is missing: no USB bus is visible"):
            find_one(UsbIdentity.parse("usb:0d8c:0014"), find_devices(tree.root))
    (tree.root / "dev/bus/usb").mkdir(parents=True)
    for root in (tree.root, UsbTree(tmp_path / "empty").root):
        assert find_devices(root).devices == ()
        with pytest.raises(NoUsbDeviceError, match="no USB audio device is plugged in"):
            raise find_devices(root).reason  # type: ignore[misc]


def test_what_a_device_does_not_say_is_empty(tree):
    folder = tree.plug(manufacturer=None, product=None, serial=None, descriptors=None)
    (folder / "speed").write_text("unknown\n")
    (folder / "bMaxPower").unlink()
    device = tree.only
    assert (device.manufacturer, device.product, device.serial) == ("", "", "")
    assert (device.speed, device.max_power_ma, device.descriptors) == (0.0, None, b"")
    assert device.label == "0d8c:0014"


def test_odd_strings_become_one_printable_line(tree):
    tree.plug(product=b" USB\x00\x1b[31m\nAudio \xff\xfe ", serial=b"\x01\x02\r\n")
    assert (tree.only.product, tree.only.serial) == ("USB��[31m�Audio ��", "��")
    assert f"{tree.only.label}{tree.only.serial}".isprintable()


@pytest.mark.parametrize("name", ["idVendor", "busnum", "devnum"])
@pytest.mark.parametrize("content", [None, b"", b"none\n"])
def test_a_device_that_cannot_be_read_is_left_out_and_its_neighbour_is_not(tree, name, content):
    folder = tree.plug()
    tree.plug("1-3", address=6)
    (folder / name).unlink()
    if content is not None:
        (folder / name).write_bytes(content)
    assert tree.ports == ["1-3"]


def before_reading(monkeypatch, act):
    """Have `act` called with the path before each file that is read."""
    read = Path.read_bytes

    def reads(path: Path) -> bytes:
        act(path)
        return read(path)

    monkeypatch.setattr(Path, "read_bytes", reads)


ATTRIBUTES = ["devnum", "busnum", "idVendor", "manufacturer", "serial", "bMaxPower", "descriptors"]


@pytest.mark.parametrize("name", [*ATTRIBUTES, "bInterfaceClass", "bInterfaceSubClass"])
def test_a_device_that_vanishes_while_it_is_read_is_left_out(tree, name, monkeypatch):
    tree.plug(serial="A42", card=1)
    tree.plug("1-3", address=6)

    def pull_out(path):
        if path.name == name and "1-2" in str(path) and tree.path("1-2").exists():
            tree.unplug("1-2")

    before_reading(monkeypatch, pull_out)
    assert tree.ports == ["1-3"]


def test_two_devices_that_change_places_while_one_is_read_are_never_mixed(tree, monkeypatch):
    tree.plug(serial="A42")

    def exchange(path):
        if path.name == "serial" and (tree.path("1-2") / "devnum").read_text() == "5\n":
            tree.unplug("1-2")
            tree.plug("1-2", "1209:dac1", serial="B1", address=6)

    before_reading(monkeypatch, exchange)
    assert (tree.devices, tree.only.vendor_id, tree.only.serial) == ((), "1209", "B1")


def test_what_may_not_be_read_or_listed_is_as_good_as_empty(tree, monkeypatch):
    tree.plug(serial="A42", card=1)

    def refuse(path):
        if path.name in ("descriptors", "id"):
            raise PermissionError(13, "Permission denied")

    before_reading(monkeypatch, refuse)
    assert (tree.only.descriptors, tree.only.serial, tree.only.cards[0].id) == (b"", "A42", "")
    listed = os.listdir

    def list_some(path):
        if "sound" in str(path):
            raise PermissionError(13, "Permission denied")
        return listed(path)

    monkeypatch.setattr(os, "listdir", list_some)
    assert tree.only.cards == ()


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
