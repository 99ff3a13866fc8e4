"""The tray icon, beside a private session bus with a stand-in for the desktop's tray."""

import asyncio
import shutil
import subprocess
from collections.abc import Mapping

import pytest

pytest.importorskip("dbus_fast")

from dbus_fast import Message, Variant
from dbus_fast.aio import MessageBus
from dbus_fast.annotations import DBusStr
from dbus_fast.service import ServiceInterface, dbus_method

from audioflinger_hook.tray.item import MENU_PATH, WATCHER, Menu, show
from audioflinger_hook.tray.menu import Entry, entries
from device.errors import NotFoundError

GAIN = {"key": "gain_db", "value": -6.0, "schema": {"minimum": -60.0, "maximum": 0.0}}
PROFILE = {"key": "profile", "value": "game", "schema": {"enum": ["cinema", "game"]}}
SETTINGS = {"keys": [GAIN, PROFILE], "muted": False}
MENU = MENU_PATH, "com.canonical.dbusmenu"
ICON = "/StatusNotifierItem", "org.freedesktop.DBus.Properties"


class Watcher(ServiceInterface):
    def __init__(self):
        super().__init__(WATCHER)
        self.names = []

    @dbus_method()
    def RegisterStatusNotifierItem(self, name: DBusStr) -> None:
        self.names.append(name)


@pytest.fixture
def bus_address(monkeypatch):
    if shutil.which("dbus-daemon") is None:
        pytest.skip("dbus-daemon is not installed")
    command = ["dbus-daemon", "--session", "--nofork", "--print-address"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as daemon:
        assert daemon.stdout is not None
        address = daemon.stdout.readline().strip()
        monkeypatch.setenv("DBUS_SESSION_BUS_ADDRESS", address)
        yield address
        daemon.terminate()


async def asked(bus, to, member, signature, *body, of=MENU):
    path, interface = of
    message = Message(to, path, interface, member, signature=signature, body=list(body))
    return (await asyncio.wait_for(bus.call(message), 5.0)).body


def test_the_tray_shows_the_menu_and_a_click_asks_the_daemon(bus_address):
    async def converse():
        desktop = await MessageBus(bus_address=bus_address).connect()
        watcher = Watcher()
        desktop.export("/StatusNotifierWatcher", watcher)
        await desktop.request_name(WATCHER)
        requests: list[Mapping[str, object]] = []
        menu = Menu(requests.append)
        menu.show(entries(SETTINGS))
        bus = await show(menu, 5.0)
        (name,) = watcher.names
        item = "org.kde.StatusNotifierItem"
        (properties,) = await asked(desktop, name, "GetAll", "s", item, of=ICON)
        assert {key: one.value for key, one in properties.items()} == {
            "Category": "Hardware",
            "Id": "haptic-cushion",
            "Title": "Haptic Cushion",
            "Status": "Active",
            "IconName": "haptic-cushion",
            "ItemIsMenu": True,
            "Menu": MENU_PATH,
        }
        assert properties["Menu"].signature == "o"
        _, (_, _, children) = await asked(desktop, name, "GetLayout", "iias", 0, -1, [])
        labels = {child.value[1]["label"].value: child.value for child in children}
        assert labels["Vibration on"][1]["toggle-state"].value == 1
        assert labels["Profile: game"][1]["toggle-state"].value == 1
        for label in ("Vibration on", "Weaker", "Profile: cinema", "Strength: -6 dB"):
            event = (labels[label][0], "clicked", Variant("i", 0), 0)
            await asked(desktop, name, "Event", "isvu", *event)
        bus.disconnect()
        desktop.disconnect()
        return requests

    weaker, cinema = {"set": {"gain_db": -9.0}}, {"set": {"profile": "cinema"}}
    assert asyncio.run(converse()) == [{"mute": True}, weaker, cinema]


def test_without_a_host_it_says_so_and_that_the_vibration_goes_on(bus_address):
    with pytest.raises(NotFoundError, match=r"no StatusNotifier host answers.*vibration goes on"):
        asyncio.run(show(Menu(lambda _: None), 5.0))


def test_without_a_session_bus_it_says_so(monkeypatch, tmp_path):
    monkeypatch.setenv("DBUS_SESSION_BUS_ADDRESS", f"unix:path={tmp_path}/none")
    with pytest.raises(NotFoundError, match="no D-Bus session bus answers"):
        asyncio.run(show(Menu(lambda _: None), 5.0))


def test_the_strength_stays_within_what_is_allowed():
    loudest = SETTINGS | {"keys": [GAIN | {"value": -1.0}]}
    by_label = {entry.label: entry.request for entry in entries(loudest)}
    assert by_label["Stronger"] == {"set": {"gain_db": 0.0}}
    full = {entry.label: entry for entry in entries({"keys": [GAIN | {"value": 0.0}]})}
    assert full["Stronger"].request is None


def test_without_a_daemon_the_menu_says_what_is_missing():
    assert entries(None, "no daemon is running") == [Entry("no daemon is running")]
