"""Devices that come and go are noticed at the next poll, and nothing is where nothing does."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from device.usb import find_devices, presence
from device.usb.identity import find_again
from device.usb.presence import PresenceChange, PresenceWatch
from device.usb.uevents import Uevents
from tests.support.usb_tree import UsbTree


@pytest.fixture
def tree(tmp_path: Path) -> UsbTree:
    return UsbTree(tmp_path)


def watching(tree: UsbTree) -> PresenceWatch:
    return PresenceWatch(tree.root, listen=False)


def test_a_poll_where_nothing_changed_reads_no_device(tree, monkeypatch):
    tree.plug(card=1)
    watch = watching(tree)
    monkeypatch.setattr(presence, "find_devices", lambda root: pytest.fail("read"))
    for now_s in (0.0, 0.5, 1.0):
        assert watch.poll(now_s) == PresenceChange(now_s)
        assert not watch.poll(now_s)


def test_what_is_there_at_first_did_not_appear(tree):
    tree.plug()
    watch = watching(tree)
    assert [device.port for device in watch.found.devices] == ["1-2"]
    assert not watch.poll(0.0)


def test_plugging_in_and_pulling_out_are_noticed_within_one_poll(tree):
    watch = watching(tree)
    tree.plug(card=1)
    (device,) = find_devices(tree.root).devices
    assert watch.poll(1.0) == PresenceChange(1.0, appeared=(device,))
    assert watch.is_present(device)
    tree.unplug("1-2")
    assert watch.poll(2.0) == PresenceChange(2.0, vanished=(device,))
    assert not watch.is_present(device)
    assert not watch.poll(3.0)
    assert watch.found.reason is not None


def test_of_two_alike_the_one_that_was_pulled_out_has_vanished(tree):
    tree.plug("1-2", serial="S", address=5, card=1)
    tree.plug("1-3", serial="S", address=6, card=2)
    watch = watching(tree)
    near, far = watch.found.devices
    tree.unplug("1-3")
    assert watch.poll(0.0).vanished == (far,)
    assert watch.is_present(near)
    assert not watch.is_present(far)


@pytest.mark.parametrize("nodes", [True, False])
def test_pulled_and_plugged_again_between_two_polls_it_is_not_the_same(tree, nodes):
    if not nodes:
        (tree.root / "dev/bus/usb/001").rmdir()  # a container to which only /sys was passed on
    tree.plug("1-2", serial="S", address=5, card=1)
    watch = watching(tree)
    (before,) = watch.found.devices
    tree.unplug("1-2")
    tree.plug("1-2", serial="S", address=6, card=1)
    change = watch.poll(0.0)
    assert change.vanished == (before,)
    assert [device.address for device in change.appeared] == [6]
    assert not watch.is_present(before)


def test_back_in_another_port_as_another_card_it_is_known_again(tree):
    tree.plug("1-2", serial="S", address=5, card=1)
    watch = watching(tree)
    there = watch.found.devices
    tree.unplug("1-2")
    watch.poll(0.0)
    assert find_again(there[0], there, watch.found.devices) is None
    tree.plug("1-4", serial="S", address=6, card=2)
    assert len(watch.poll(1.0).appeared) == 1
    back = find_again(there[0], there, watch.found.devices)
    assert back is not None
    assert (back.port, back.cards[0].number) == ("1-4", 2)
    assert watch.is_present(back)
    assert not watch.is_present(there[0])


def test_a_card_that_comes_up_after_its_device_is_a_change_of_the_device(tree):
    watch = watching(tree)
    tree.plug("1-2")
    (device,) = watch.poll(0.0).appeared
    assert device.cards == ()
    tree.add_card("1-2", 1)
    change = watch.poll(1.0)
    assert (change.appeared, change.vanished) == ((), ())
    assert [card.number for card in change.changed[0].cards] == [1]
    assert watch.is_present(device)


def test_what_is_no_audio_device_comes_and_goes_unmentioned(tree):
    watch = watching(tree)
    tree.plug("1-5", "046d:c31c", interfaces=[(3, 1)])
    assert not watch.poll(0.0)
    tree.unplug("1-5")
    assert not watch.poll(1.0)


def test_a_bus_that_comes_later_is_watched_too(tmp_path):
    tree = UsbTree(tmp_path, bus=False)
    watch = watching(tree)
    assert not watch.poll(0.0)
    tree.add_bus(1)
    tree.plug()
    assert len(watch.poll(1.0).appeared) == 1


def test_what_happens_while_devices_are_read_is_noticed_at_the_next_poll(tree, monkeypatch):
    tree.plug("1-2", address=5, serial="S")
    watch = watching(tree)
    tree.plug("1-3", address=6)

    def meanwhile(root):
        found = find_devices(root)
        if tree.path("1-2").exists():
            tree.unplug("1-2")
            tree.plug("1-2", address=7, serial="S")
            monkeypatch.undo()
        return found

    monkeypatch.setattr(presence, "find_devices", meanwhile)
    watch.poll(0.0)
    watch.poll(1.0)
    assert [device.address for device in watch.found.devices] == [7, 6]


def pair() -> tuple[socket.socket, Uevents]:
    kernel, ours = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
    return kernel, Uevents(ours)


@pytest.mark.parametrize(
    ("messages", "changed"),
    [
        ([], False),
        ([b"add@/devices/x\0ACTION=add\0SUBSYSTEM=usb\0SEQNUM=1\0"], True),
        ([b"remove@/devices/x\0ACTION=remove\0SUBSYSTEM=sound\0"], True),
        ([b"change@/devices/x\0ACTION=change\0SUBSYSTEM=net\0"], False),
        ([b"x\0SUBSYSTEM=net\0", b"x\0SUBSYSTEM=usb\0", b"x\0SUBSYSTEM=net\0"], True),
        ([b"\xff\0SUBSYSTEM=usbmisc\0"], False),
    ],
)
def test_only_messages_of_usb_or_sound_say_that_something_may_have_changed(messages, changed):
    kernel, uevents = pair()
    with kernel:
        for message in messages:
            kernel.send(message)
        assert uevents.drain() is changed
        assert uevents.drain() is False
    uevents.close()


def test_a_message_makes_the_next_poll_read_even_if_names_are_the_same(tree, monkeypatch):
    folder = tree.plug("1-2", address=5, serial="S")
    kernel, uevents = pair()
    monkeypatch.setattr(Uevents, "open", lambda: uevents)
    with kernel, PresenceWatch(tree.root) as watch:
        assert watch.fileno() == uevents.fileno()
        (folder / "serial").write_text("T\n")
        assert not watch.poll(0.0)
        kernel.send(b"change@/devices/x\0SUBSYSTEM=usb\0")
        assert [device.serial for device in watch.poll(1.0).appeared] == ["T"]
    assert watch.fileno() is None
    assert not watch.poll(2.0)


@pytest.mark.parametrize("step", ["socket", "bind"])
def test_where_no_socket_can_be_opened_polling_does_all(tree, step, monkeypatch):
    class Refusing(socket.socket):
        def bind(self, address):
            raise PermissionError(1, "Operation not permitted")

    def refused(*arguments):
        raise OSError(97, "Address family not supported by protocol")

    monkeypatch.setattr(socket, "socket", refused if step == "socket" else Refusing)
    watch = PresenceWatch(tree.root)
    assert watch.fileno() is None
    tree.plug()
    assert len(watch.poll(0.0).appeared) == 1


def test_a_real_socket_never_makes_the_caller_wait():
    uevents = Uevents.open()
    if uevents is None:
        pytest.skip("no netlink socket of kernel messages here")
    uevents.drain()
    uevents.close()
    uevents.close()
