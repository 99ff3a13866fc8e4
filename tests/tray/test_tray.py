import asyncio
import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Mapping
from contextlib import AsyncExitStack, asynccontextmanager, nullcontext, suppress

import pytest

pytest.importorskip("dbus_fast")

from dbus_fast import Message, PropertyAccess, Variant
from dbus_fast.aio import MessageBus
from dbus_fast.annotations import DBusBool, DBusStr
from dbus_fast.service import ServiceInterface, dbus_method, dbus_property

from audioflinger_hook.service.autostart import icon_bytes
from audioflinger_hook.tray import item
from audioflinger_hook.tray.item import MENU_PATH, WATCHER, Menu, show
from audioflinger_hook.tray.menu import Entry, entries
from device.errors import NotFoundError

GAIN = {"key": "gain_db", "value": -6.0, "schema": {"minimum": -60.0, "maximum": 0.0}}
PROFILE = {"key": "profile", "value": "game", "schema": {"enum": ["cinema", "game"]}}
SETTINGS = {"keys": [GAIN, PROFILE], "muted": False}
MENU = MENU_PATH, "com.canonical.dbusmenu"
ICON = "/StatusNotifierItem", "org.freedesktop.DBus.Properties"


class Watcher(ServiceInterface):
    """The desktop's watcher. hosts_after: number of questions until a host is registered."""

    def __init__(self, hosts_after=0):
        super().__init__(WATCHER)
        self.names = []
        self.hosts_after = hosts_after

    @dbus_method()
    def RegisterStatusNotifierItem(self, name: DBusStr) -> None:
        self.names.append(name)

    @dbus_property(PropertyAccess.READ)
    def IsStatusNotifierHostRegistered(self) -> DBusBool:
        self.hosts_after -= 1
        return bool(self.hosts_after < 0)


@asynccontextmanager
async def desktop_with(watcher):
    desktop = await MessageBus().connect()
    desktop.export("/StatusNotifierWatcher", watcher)
    await desktop.request_name(WATCHER)
    try:
        yield desktop
    finally:
        desktop.disconnect()
        with suppress(EOFError):
            await desktop.wait_for_disconnect()


@asynccontextmanager
async def shown():
    bus = await show(Menu(lambda _: None), 5.0)
    yield
    bus.disconnect()
    await bus.wait_for_disconnect()


async def holds(condition):
    async with asyncio.timeout(20.0):
        while not condition():
            await asyncio.sleep(0.01)


@pytest.fixture
def session(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setattr(item, "HOST_S", 0.5)
    if shutil.which("dbus-daemon") is None:
        pytest.skip("dbus-daemon is not installed")
    command = ["dbus-daemon", "--session", "--nofork", "--print-address"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as daemon:
        assert daemon.stdout is not None
        monkeypatch.setenv("DBUS_SESSION_BUS_ADDRESS", daemon.stdout.readline().strip())
        yield daemon
        daemon.terminate()


async def asked(bus, to, member, signature, *body, of=MENU):
    path, interface = of
    message = Message(to, path, interface, member, signature=signature, body=list(body))
    return (await asyncio.wait_for(bus.call(message), 5.0)).body


def test_the_tray_shows_the_menu_and_a_click_asks_the_daemon(session, tmp_path):
    async def converse():
        async with desktop_with(Watcher()) as desktop:
            return await use(desktop)

    async def use(desktop):
        requests: list[Mapping[str, object]] = []
        menu = Menu(requests.append)
        menu.show(entries(SETTINGS))
        bus = await show(menu, 5.0)
        name = f"org.kde.StatusNotifierItem-{os.getpid()}-1"
        kind = "org.kde.StatusNotifierItem"
        (properties,) = await asked(desktop, name, "GetAll", "s", kind, of=ICON)
        assert {key: one.value for key, one in properties.items()} == {
            "Category": "Hardware",
            "Id": "haptic-cushion",
            "Title": "Haptic Cushion",
            "Status": "Active",
            "IconName": "haptic-cushion",
            "IconThemePath": str(tmp_path / "data/icons"),
            "ItemIsMenu": True,
            "Menu": MENU_PATH,
        }
        assert properties["Menu"].signature == "o"
        icon_path = tmp_path / "data/icons/hicolor/scalable/apps/haptic-cushion.svg"
        assert icon_path.read_bytes() == icon_bytes()
        _, (_, _, children) = await asked(desktop, name, "GetLayout", "iias", 0, -1, [])
        labels = {child.value[1]["label"].value: child.value for child in children}
        assert labels["Vibration on"][1]["toggle-state"].value == 1
        assert labels["Profile: game"][1]["toggle-state"].value == 1
        for label in ("Vibration on", "Weaker", "Profile: cinema", "Strength: -6 dB"):
            event = (labels[label][0], "clicked", Variant("i", 0), 0)
            await asked(desktop, name, "Event", "isvu", *event)
        bus.disconnect()
        return requests

    weaker, cinema = {"set": {"gain_db": -9.0}}, {"set": {"profile": "cinema"}}
    assert asyncio.run(converse()) == [{"mute": True}, weaker, cinema]


@pytest.mark.parametrize("has_watcher", [False, True])
def test_without_a_host_it_says_so_and_that_the_vibration_goes_on(session, has_watcher):
    async def converse():
        watcher = Watcher(hosts_after=1_000)
        async with desktop_with(watcher) if has_watcher else nullcontext(), shown():
            pass

    with pytest.raises(
        NotFoundError, match=r"no StatusNotifier host answers.*the vibration goes on"
    ):
        asyncio.run(converse())


def test_at_login_it_waits_for_a_host(session):
    async def start_late(watcher):
        await asyncio.sleep(0.15)
        async with desktop_with(watcher):
            await holds(lambda: watcher.hosts_after < 0)
            await asyncio.sleep(0.1)

    async def converse():
        desktop = asyncio.ensure_future(start_late(Watcher(hosts_after=1)))
        async with shown():
            await desktop

    asyncio.run(converse())


def test_the_icon_returns_after_the_panel_restarts(session):
    async def converse():
        restarted = Watcher()
        async with AsyncExitStack() as stack:
            async with desktop_with(Watcher()):
                await stack.enter_async_context(shown())
            async with desktop_with(restarted):
                await holds(lambda: restarted.names)

    asyncio.run(converse())


def test_the_end_of_the_session_ends_the_tray_without_a_message(session, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))

    async def converse():
        watcher = Watcher()
        async with desktop_with(watcher):
            command = [sys.executable, "-m", "audioflinger_hook", "tray"]
            tray = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
            await holds(lambda: watcher.names and watcher.hosts_after < 0)
            await asyncio.sleep(0.2)
            session.terminate()
            with tray:
                output, _ = await asyncio.to_thread(tray.communicate, timeout=20.0)
                return tray.returncode, output

    assert asyncio.run(converse()) == (0, b"")


def test_an_icon_that_cannot_be_written_is_left_to_the_desktop(session, tmp_path):
    (tmp_path / "data").write_text("in the way of a folder")

    async def converse():
        async with desktop_with(Watcher()), shown():
            pass

    asyncio.run(converse())


def test_a_session_bus_that_is_missing_or_never_answers_is_told_and_not_waited_for(
    monkeypatch, tmp_path
):
    monkeypatch.setenv("DBUS_SESSION_BUS_ADDRESS", f"unix:path={tmp_path}/bus")
    with pytest.raises(NotFoundError, match="no D-Bus session bus answers"):
        asyncio.run(show(Menu(lambda _: None), 5.0))
    with socket.socket(socket.AF_UNIX) as silent:
        silent.bind(f"{tmp_path}/bus")
        silent.listen()
        with pytest.raises(NotFoundError, match="no D-Bus session bus answers"):
            asyncio.run(asyncio.wait_for(show(Menu(lambda _: None), 0.1), 5.0))


def test_the_strength_stays_within_what_is_allowed_and_a_menu_says_why_it_is_empty():
    loudest = SETTINGS | {"keys": [GAIN | {"value": -1.0}]}
    by_label = {entry.label: entry.request for entry in entries(loudest)}
    assert by_label["Stronger"] == {"set": {"gain_db": 0.0}}
    full = {entry.label: entry for entry in entries({"keys": [GAIN | {"value": 0.0}]})}
    assert full["Stronger"].request is None
    assert entries(None, "no daemon is running") == [Entry("no daemon is running")]
