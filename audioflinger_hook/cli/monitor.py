"""`cushion monitor`: serves the live page of a running daemon to browsers."""

from __future__ import annotations

import argparse
import asyncio
import fcntl
import html
import os
import signal
import sys
import webbrowser
from collections.abc import Coroutine
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from audioflinger_hook.cli.terminal import warn
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from device.atomic_file import write_bytes_atomically
from device.errors import UsageError, not_installed

OPENER = "page.html"
"""A file, readable only by the user, that redirects a browser to the page. The browser's arguments
name this file instead of the address with the token, because other users can read the arguments.
"""

SERVED = "page.{}"  # file that a running page locks, by its port; it holds the page's address


def run(options: argparse.Namespace) -> int:
    """Serve the page until a signal arrives. If it is served already, only show it."""
    try:
        from audioflinger_hook.monitor.access import LOOPBACK, Listen, load_token
        from audioflinger_hook.monitor.server import PageServer
    except ModuleNotFoundError as error:
        raise UsageError(not_installed(str(error.name), "page")) from error
    listen = Listen.parse(options.listen)
    if not 1.0 <= options.rate <= 60.0:
        raise UsageError(f"rate={options.rate:.12g} is out of range; allowed: 1 to 60 Hz")
    with RuntimeFolder(os.environ, create=True) as folder, ExitStack() as stack:
        token = load_token(folder)
        server = PageServer(listen, token, options.rate, os.environ)

        def begin(address: str) -> None:
            port = address.partition("/#")[0].rpartition(":")[2]
            with suppress(OSError):  # a second page on another host, or a full disk
                file = stack.enter_context((folder.path / SERVED.format(port)).open("a"))
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                file.truncate(0)
                print(address, end="", file=file, flush=True)
            tell(address)

        def tell(address: str) -> None:
            print(f"cushion: the live page: {address}", file=sys.stderr, flush=True)
            if listen.host not in LOOPBACK:
                warn(f"{listen.host} is open to the network, and HTTP is not encrypted")
            if options.open:
                path = folder.path / OPENER
                to = html.escape(address)
                page = f'<!doctype html><meta http-equiv="refresh" content="0; url={to}">\n'
                write_bytes_atomically(path, page.encode())
                path.chmod(0o600)
                if not webbrowser.open(path.as_uri()):
                    warn("no browser could be started; open this address in one")

        place = f"http://{listen.shown_host}:{listen.port}/"
        address = _served(folder.path / SERVED.format(listen.port))
        if address.startswith(place):
            tell(address)
        else:
            asyncio.run(_until_signal(server.run(begin)))
    return 0


def _served(path: Path) -> str:
    """Return the address that a running page has written to its locked file, else ""."""
    try:
        with path.open() as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return path.read_text()
    except OSError:  # no page has written it
        pass
    return ""


async def _until_signal(serving: Coroutine[Any, Any, None]) -> None:
    task = asyncio.ensure_future(serving)
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, task.cancel)
    with suppress(asyncio.CancelledError):
        await task
    raise KeyboardInterrupt
