"""Icon and menu on D-Bus, by the protocols StatusNotifierItem and com.canonical.dbusmenu."""

# Without `from __future__ import annotations`: dbus-fast reads D-Bus types from annotations.

import asyncio
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Annotated, Any

from dbus_fast import BusType, Message, MessageType, PropertyAccess, Variant, annotations
from dbus_fast.aio import MessageBus
from dbus_fast.annotations import DBusInt32, DBusSignature, DBusStr, DBusUInt32
from dbus_fast.service import ServiceInterface, dbus_method, dbus_property, dbus_signal

from audioflinger_hook.service.autostart import NAME, install_icon
from audioflinger_hook.tray.menu import Entry
from device.errors import CushionError, NotFoundError

WATCHER = "org.kde.StatusNotifierWatcher"
BUS = "org.freedesktop.DBus"
ITEM_PATH, MENU_PATH = "/StatusNotifierItem", "/MenuBar"
HOST_S, ASK_EVERY_S = 2.0, 0.1  # at login, the desktop's panel may start after the icon
NO_HOST = (
    "this desktop shows no tray icons (no StatusNotifier host answers); install or enable its "
    "tray extension, or use the page: `cushion monitor --open`; the vibration goes on"
)


def _fixed(name: str, kind: Any, value: object) -> Any:
    """Return a property of a D-Bus interface that never changes. kind: D-Bus type of the value."""

    def read(_: ServiceInterface) -> Any:
        return value

    read.__name__, read.__annotations__["return"] = name, kind
    return dbus_property(PropertyAccess.READ)(read)


class Item(ServiceInterface):
    """The icon, which is written to the user's icon themes."""

    def __init__(self) -> None:
        super().__init__("org.kde.StatusNotifierItem")
        self._icons = ""
        with suppress(CushionError):  # without the file, the host shows a placeholder
            self._icons = str(install_icon())

    Category = _fixed("Category", DBusStr, "Hardware")
    Id = _fixed("Id", DBusStr, NAME)
    Title = _fixed("Title", DBusStr, "Haptic Cushion")
    Status = _fixed("Status", DBusStr, "Active")
    IconName = _fixed("IconName", DBusStr, NAME)
    ItemIsMenu = _fixed("ItemIsMenu", annotations.DBusBool, True)
    Menu = _fixed("Menu", annotations.DBusObjectPath, MENU_PATH)

    @dbus_property(PropertyAccess.READ)
    def IconThemePath(self) -> DBusStr:
        return self._icons


class Menu(ServiceInterface):
    """The menu. Entry number N of `entries` has the id N + 1. chosen: called with its request."""

    def __init__(self, chosen: Callable[[Mapping[str, Any]], None]) -> None:
        super().__init__("com.canonical.dbusmenu")
        self._chosen, self._entries, self._revision = chosen, list[Entry](), 1

    def show(self, entries: list[Entry]) -> None:
        """Show these entries."""
        if entries != self._entries:
            self._entries = entries
            self._revision += 1
            self.LayoutUpdated()

    Version = _fixed("Version", DBusUInt32, 3)
    Status = _fixed("Status", DBusStr, "normal")

    @dbus_method()
    def GetLayout(
        self, parent: DBusInt32, depth: DBusInt32, names: Annotated[list[str], DBusSignature("as")]
    ) -> Annotated[tuple[int, list[Any]], DBusSignature("u(ia{sv}av)")]:
        children = [
            Variant("(ia{sv}av)", [number, _shown(entry), []])
            for number, entry in enumerate(self._entries, 1)
        ]
        top = {"children-display": Variant("s", "submenu")}
        return self._revision, [0, top, children if parent == 0 and depth else []]

    @dbus_method()
    def GetGroupProperties(
        self,
        ids: Annotated[list[int], DBusSignature("ai")],
        names: Annotated[list[str], DBusSignature("as")],
    ) -> Annotated[list[list[Any]], DBusSignature("a(ia{sv})")]:
        numbered = enumerate(self._entries, 1)
        return [[number, _shown(entry)] for number, entry in numbered if not ids or number in ids]

    @dbus_method()
    def Event(
        self, number: DBusInt32, kind: DBusStr, content: annotations.DBusVariant, time: DBusUInt32
    ) -> None:
        if kind == "clicked" and 1 <= number <= len(self._entries):
            request = self._entries[number - 1].request
            if request is not None:
                self._chosen(request)

    @dbus_method()
    def AboutToShow(self, number: DBusInt32) -> annotations.DBusBool:
        return False

    @dbus_signal()
    def LayoutUpdated(self) -> Annotated[tuple[int, int], DBusSignature("ui")]:
        return self._revision, 0


def _shown(entry: Entry) -> dict[str, Variant]:
    shown = {"label": Variant("s", entry.label), "enabled": Variant("b", entry.request is not None)}
    if entry.toggle:
        shown["toggle-type"] = Variant("s", entry.toggle)
        shown["toggle-state"] = Variant("i", int(entry.checked))
    return shown


async def show(menu: Menu, timeout_s: float) -> MessageBus:
    """Show icon and menu in the tray; return the connection, which the caller closes.

    They are shown again after the desktop's panel has restarted. NotFoundError: there is no session
    bus, or no StatusNotifier host appears within HOST_S.
    """
    try:
        async with asyncio.timeout(timeout_s):
            bus = await MessageBus(bus_type=BusType.SESSION).connect()
    except Exception as error:  # the library raises several kinds
        raise NotFoundError(f"no D-Bus session bus answers; {NO_HOST}") from error
    bus.export(ITEM_PATH, Item())
    bus.export(MENU_PATH, menu)
    name = f"org.kde.StatusNotifierItem-{os.getpid()}-1"
    await bus.request_name(name)
    register = WATCHER, "/StatusNotifierWatcher", WATCHER, "RegisterStatusNotifierItem", name
    is_shown = *register[:2], f"{BUS}.Properties", "Get", WATCHER, "IsStatusNotifierHostRegistered"

    def register_again(message: Message) -> None:
        if message.member == "NameOwnerChanged" and message.body[0] == WATCHER and message.body[2]:
            bus.send(_call(*register))

    bus.add_message_handler(register_again)
    follow = f"sender='{BUS}',member='NameOwnerChanged',arg0='{WATCHER}'"
    async with asyncio.timeout(timeout_s):
        await bus.call(_call(BUS, "/org/freedesktop/DBus", BUS, "AddMatch", follow))
        for _ in range(round(HOST_S / ASK_EVERY_S)):
            answers = [await bus.call(_call(*one)) for one in (register, is_shown)]
            are_errors = [one.message_type is MessageType.ERROR for one in answers]
            if not any(are_errors) and answers[1].body[0].value:
                return bus
            await asyncio.sleep(ASK_EVERY_S)
    bus.disconnect()
    raise NotFoundError(NO_HOST)


def _call(to: str, path: str, interface: str, member: str, *words: str) -> Message:
    return Message(to, path, interface, member, signature="s" * len(words), body=[*words])
