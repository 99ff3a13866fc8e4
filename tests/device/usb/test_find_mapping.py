from dataclasses import replace

import pytest

from device.address import parse_device
from device.errors import NotFoundError
from device.server.snapshot import Sink
from device.usb import UsbIdentity, mapping
from tests.support.snapshots import sink, snapshot
from tests.support.usb_tree import HOST


def pulseaudio(port: str, card: int, serial: str = "C-Media_USB_Audio_S") -> Sink:
    """A sink as PulseAudio describes it, which made it of what udev says."""
    folders = port if "." not in port else f"{port.partition('.')[0]}/{port}"
    properties = {"device.vendor.id": "0d8c", "device.product.id": "0014", "device.serial": serial}
    properties |= {"alsa.card": str(card), "device.string": f"front:{card}", "device.bus": "usb"}
    properties["sysfs.path"] = f"/{HOST}/usb1/{folders}/{port}:1.0/sound/card{card}"
    properties["device.bus_path"] = f"pci-0000:00:14.0-usb-0:{port.partition('-')[2]}:1.0"
    return sink(1, f"alsa_output.{port}", properties)


def pipewire(port: str, card: int, serial: str = "C-Media_USB_Audio_S") -> Sink:
    """The same as PipeWire describes it: ids with 0x, and more names for the number of the card."""
    known = pulseaudio(port, card, serial)
    properties = {**known.properties, "device.vendor.id": "0x0d8c", "device.product.id": "0x0014"}
    properties |= {"api.alsa.pcm.card": str(card), "api.alsa.path": properties.pop("device.string")}
    return replace(known, properties=properties)


def without(known: Sink, *keys: str) -> Sink:
    return replace(known, properties={k: v for k, v in known.properties.items() if k not in keys})


def having(known: Sink, **properties: str) -> Sink:
    renamed = {key.replace("__", "."): text for key, text in properties.items()}
    return replace(known, properties={**known.properties, **renamed})


@pytest.fixture
def tree(tree):
    """Two alike to the letter, one of them behind a hub, and a built-in card."""
    tree.add_built_in_card(0)
    tree.plug("1-2", serial="S", address=5, card=1, card_id="DAC")
    tree.plug("1-3", "05e3:0610", address=2, interfaces=[(9, 0)])
    tree.plug("1-3.4", serial="S", address=6, card=2, card_id="DAC_1", playback=(0, 1))
    return tree


@pytest.fixture
def devices(tree):
    return tree.devices


@pytest.mark.parametrize("server", [pulseaudio, pipewire])
def test_sinks_of_two_alike_lead_to_the_one_they_play_on(devices, server):
    near, far = devices
    sinks = (server("1-2", 1), server("1-3.4", 2), sink(1, "virtual"))
    assert [mapping.device_of_sink(one, devices) for one in sinks] == [near, far, None]


@pytest.mark.parametrize("server", [pulseaudio, pipewire])
def test_the_place_in_sys_counts_more_than_the_number_of_the_card(devices, server):
    assert mapping.device_of_sink(having(server("1-3.4", 2), alsa__card="1"), devices) == devices[1]


@pytest.mark.parametrize("key", ["alsa.card", "api.alsa.pcm.card", "api.alsa.card"])
def test_without_a_place_the_card_leads_to_the_device(devices, key):
    assert mapping.device_of_sink(sink(1, "by hand", {key: "2"}), devices) == devices[1]


@pytest.mark.parametrize("key", ["api.alsa.path", "device.string"])
@pytest.mark.parametrize("name", ["hw:2,0", "front:2", "hw:DAC_1", "plughw:CARD=DAC_1,DEV=0"])
def test_without_a_number_the_name_that_was_opened_leads_to_the_device(devices, key, name):
    assert mapping.device_of_sink(sink(1, "by hand", {key: name}), devices) == devices[1]


def test_a_card_number_that_another_device_has_taken_leads_nowhere(tree):
    stale = without(pulseaudio("1-2", 1, "Maker_Model_T"), "sysfs.path", "device.bus_path")
    tree.unplug("1-2")
    tree.plug("1-2", "1209:dac1", address=7, card=1)
    devices = tree.devices
    assert mapping.device_of_sink(stale, devices) is None
    another_unit = having(stale, device__vendor__id="1209", device__product__id="dac1")
    assert mapping.device_of_sink(another_unit, devices) == devices[0]
    tree.unplug("1-2")
    tree.plug("1-2", "1209:dac1", address=8, serial="B1", card=1)
    assert mapping.device_of_sink(another_unit, tree.devices) is None


def test_a_sink_whose_device_has_gone_leads_to_no_other_device(tree):
    stale = pulseaudio("1-2", 1)
    tree.unplug("1-2")
    tree.plug("1-4", serial="S", address=8, card=1)
    assert mapping.device_of_sink(stale, tree.devices) is None


def test_ids_and_serial_lead_to_a_device_only_if_it_is_the_only_one(devices):
    told = without(pulseaudio("1-2", 1), "sysfs.path", "alsa.card", "device.string")
    assert mapping.device_of_sink(told, devices) == devices[0], "by the ports in device.bus_path"
    alike = without(told, "device.bus_path")
    assert mapping.device_of_sink(alike, devices) is None
    assert mapping.device_of_sink(alike, devices[:1]) == devices[0]
    another = having(alike, device__serial="C-Media_USB_Audio_T")
    assert mapping.device_of_sink(another, devices[:1]) is None


def test_sinks_that_are_not_usb_lead_to_no_device(devices):
    built_in = {"alsa.card": "0", "device.bus": "pci", "sysfs.path": "/devices/pci0000:00/x"}
    bluetooth = {"device.bus": "bluetooth", "device.vendor.id": "0d8c"}
    for properties in (built_in, {"alsa.card": "0"}, bluetooth, {}):
        assert mapping.device_of_sink(sink(1, "other", properties), devices) is None


def test_a_serial_that_udev_drops_does_not_part_a_sink_from_its_device(tree):
    tree.unplug("1-2")
    tree.plug("1-2", serial=b"A,\x01", address=7, card=1)
    devices = tree.devices
    told = without(pulseaudio("1-2", 1, "C-Media_USB_Audio"), "sysfs.path")
    assert mapping.device_of_sink(told, devices) == devices[0]


NAMES = {
    "1": ("hw:1,0", "hw:1"),
    "DAC": ("plughw:DAC,0", "hw:CARD=DAC,DEV=0"),
    "DAC_1": ("front:CARD=DAC_1",),
    "12": ("DAC: USB Audio (hw:12,0)", "Maker: (hw:9,0) (hw:12,1)"),
    "": ("default", "DAC: USB Audio", "pulse", ""),
}


@pytest.mark.parametrize(("name", "card"), [(name, card) for card in NAMES for name in NAMES[card]])
def test_a_name_of_alsa_or_portaudio_names_a_card_or_none(name, card):
    assert mapping.card_of_name(name) == card


def test_every_hw_name_of_a_device_leads_back_to_it(devices):
    assert [mapping.hw_names(device) for device in devices] == [("hw:1,0",), ("hw:2,0", "hw:2,1")]
    for device in devices:
        for name in mapping.hw_names(device):
            assert mapping.device_of_card(mapping.card_of_name(name), devices) == device
    for card in ("DAC_1", 2):
        assert mapping.device_of_card(card, devices) == devices[1]
    assert mapping.device_of_card(0, devices) is mapping.device_of_card("", devices) is None


def test_a_device_without_a_card_has_no_hw_name_and_the_number_of_its_last_one_leads_nowhere(tree):
    tree.unplug("1-2")
    tree.plug("1-2", serial="S", address=7, driver=None)
    devices = tree.devices
    assert (mapping.hw_names(devices[0]), mapping.device_of_card(1, devices)) == ((), None)
    assert mapping.device_of_sink(without(pulseaudio("1-2", 1), "sysfs.path"), devices) is None


@pytest.mark.parametrize("server", [pulseaudio, pipewire])
def test_an_address_with_a_port_takes_the_sink_of_that_one_of_two_alike(server):
    sinks = (server("1-2", 1), server("1-3.4", 2))
    there = snapshot(sinks=sinks)
    assert parse_device("usb:0d8c:0014@1-3.4").sink(there) == sinks[1]
    assert parse_device("usb:0d8c:0014:S@1-2").sink(there) == sinks[0]
    with pytest.raises(NotFoundError, match="plug it in"):
        parse_device("usb:0d8c:0014@1-3").sink(there)
    words = r"several USB devices match.*'alsa_output\.1-3\.4' in port 1-3\.4.*@PORT"
    with pytest.raises(NotFoundError, match=words):
        parse_device("usb:0d8c:0014:S").sink(there)


def test_an_address_without_a_port_takes_the_only_sink_as_before():
    sinks = (pulseaudio("1-2", 1, "C-Media_USB_Audio_S_42"), sink(1, "virtual"))
    there = snapshot(sinks=sinks)
    for serial in ("", ":S 42", ":C-Media_USB_Audio_S_42"):  # blanks are as servers have them
        assert parse_device(f"usb:0D8C:0014{serial}").sink(there) == sinks[0]
    for text in ("usb:0d8c:0015", "usb:0d8c:0014:T 42", "usb:0d8c:0014:Audio"):
        with pytest.raises(NotFoundError):
            parse_device(text).sink(there)


def test_a_port_is_known_from_the_place_or_the_bus_path_or_it_is_no_match():
    wanted = UsbIdentity("0d8c", "0014", port="1-3.4")
    told = pulseaudio("1-3.4", 2)
    assert (mapping.port_of_sink(told), mapping.is_sink_of(wanted, told)) == ("1-3.4", True)
    by_chain = without(told, "sysfs.path")
    assert (mapping.port_of_sink(by_chain), mapping.is_sink_of(wanted, by_chain)) == ("", True)
    assert not mapping.is_sink_of(wanted, without(by_chain, "device.bus_path"))
