"""Icon and menu on D-Bus, by the protocols StatusNotifierItem and com.canonical.dbusmenu."""

# Without `from __future__ import annotations`: dbus-fast reads D-Bus types from annotations.

import asyncio
import os
from collections.abc import Callable, Mapping
from typing import Annotated, Any

from dbus_fast import BusType, Message, MessageType, PropertyAccess, Variant
from dbus_fast.aio import MessageBus
from dbus_fast.annotations import (
    DBusBool,
    DBusInt32,
    DBusObjectPath,
    DBusSignature,
    DBusStr,
    DBusUInt32,
    DBusVariant,
)
from dbus_fast.service import ServiceInterface, dbus_method, dbus_property, dbus_signal

from audioflinger_hook.service.desktop_entry import NAME
from audioflinger_hook.tray.menu import Entry
from device.errors import NotFoundError

WATCHER = "org.kde.StatusNotifierWatcher"
ITEM_PATH, MENU_PATH = "/StatusNotifierItem", "/MenuBar"
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
    """The icon."""

    Category = _fixed("Category", DBusStr, "Hardware")
    Id = _fixed("Id", DBusStr, NAME)
    Title = _fixed("Title", DBusStr, "Haptic Cushion")
    Status = _fixed("Status", DBusStr, "Active")
    IconName = _fixed("IconName", DBusStr, NAME)
    ItemIsMenu = _fixed("ItemIsMenu", DBusBool, True)
    Menu = _fixed("Menu", DBusObjectPath, MENU_PATH)


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
        self, number: DBusInt32, kind: DBusStr, content: DBusVariant, time: DBusUInt32
    ) -> None:
        if kind == "clicked" and 1 <= number <= len(self._entries):
            request = self._entries[number - 1].request
            if request is not None:
                self._chosen(request)

    @dbus_method()
    def AboutToShow(self, number: DBusInt32) -> DBusBool:
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

    NotFoundError: there is no session bus, or no StatusNotifier host.
    """
    try:
        bus = await MessageBus(bus_type=BusType.SESSION).connect()
    except Exception as error:  # the library raises several kinds
        raise NotFoundError(f"no D-Bus session bus answers; {NO_HOST}") from error
    bus.export(ITEM_PATH, Item("org.kde.StatusNotifierItem"))
    bus.export(MENU_PATH, menu)
    name = f"org.kde.StatusNotifierItem-{os.getpid()}-1"
    await bus.request_name(name)
    call = Message(
        destination=WATCHER,
        path="/StatusNotifierWatcher",
        interface=WATCHER,
        member="RegisterStatusNotifierItem",
        signature="s",
        body=[name],
    )
    async with asyncio.timeout(timeout_s):
        answer = await bus.call(call)
    if answer.message_type is MessageType.ERROR:
        bus.disconnect()
        raise NotFoundError(NO_HOST)
    return bus
