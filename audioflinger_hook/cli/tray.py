"""`cushion tray`: a tray icon with on and off, strength and profile."""

import argparse
import asyncio
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from audioflinger_hook.cli.terminal import warn
from audioflinger_hook.monitor.daemon_link import DaemonLink
from audioflinger_hook.tray.menu import entries
from device.errors import NotFoundError, UsageError, not_installed

TIMEOUT_S = 5.0
RATE_HZ = 1.0


def run(options: argparse.Namespace) -> int:
    """Show the icon until an interruption or the session's end; the daemon continues without."""
    try:
        asyncio.run(_serve())
    except ModuleNotFoundError as error:
        raise UsageError(not_installed(str(error.name), "tray")) from error
    except TimeoutError as error:
        raise NotFoundError("the desktop's tray does not answer; the vibration goes on") from error
    return 0


async def _serve() -> None:
    from audioflinger_hook.tray.item import Menu, show

    tasks = set[asyncio.Task[None]]()

    async def ask(request: Mapping[str, Any]) -> None:
        answer = await link.control(request)
        if "error" in answer:
            warn(str(answer["error"]))

    def choose(request: Mapping[str, Any]) -> None:
        task = asyncio.ensure_future(ask(request))
        tasks.add(task)
        task.add_done_callback(tasks.discard)

    def tell(kind: str, content: Mapping[str, Any]) -> None:
        if kind == "settings":
            menu.show(entries(content))
        elif kind == "link" and not content["connected"]:
            menu.show(entries(None, str(content["text"])))

    menu = Menu(choose)
    menu.show(entries(None))
    link = DaemonLink(tell, RATE_HZ, "")
    bus = await show(menu, TIMEOUT_S)
    following = asyncio.ensure_future(link.run())
    try:
        with suppress(EOFError, OSError):  # the session ends, as at logout
            await bus.wait_for_disconnect()  # type: ignore[no-untyped-call]
    finally:
        following.cancel()
        bus.disconnect()
