"""`cushion monitor`: serves the live page of a running daemon to browsers."""

import argparse
import asyncio
import fcntl
import html
import os
import signal
import sys
import time
import webbrowser
from collections.abc import Coroutine
from contextlib import ExitStack, suppress
from typing import Any

from audioflinger_hook.cli.terminal import warn
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from device.atomic_file import write_bytes_atomically
from device.errors import UsageError, not_installed

OPENER = "page.html"
"""A private file that redirects a browser to the page. The browser's arguments, which other users
can read, name this file instead of the address with the code."""


def run(options: argparse.Namespace) -> int:
    """Serve the page until a signal arrives. If it is served already, only show it."""
    try:
        from audioflinger_hook.monitor.access import CODE_S, LOOPBACK, Listen, new_code
        from audioflinger_hook.monitor.server import PageServer
    except ModuleNotFoundError as error:
        raise UsageError(not_installed(str(error.name), "page")) from error
    listen = Listen.parse(options.listen)
    if not 1.0 <= options.rate <= 60.0:
        raise UsageError(f"rate={options.rate:.12g} is out of range; allowed: 1 to 60 Hz")
    with RuntimeFolder(os.environ, create=True) as folder, ExitStack() as stack:

        def is_served(listen: Listen) -> bool:
            """Whether another process serves the page there; else, mark that this one does."""
            name = f"page.{listen.shown_host}:{listen.port}"
            try:  # as long as a page is served at this address, its process locks a file
                lock = stack.enter_context((folder.path / name).open("w"))
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:  # other errors: a second page does not find this one
                return isinstance(error, BlockingIOError)
            return False

        def tell(served: Listen) -> None:
            if not listen.port:
                is_served(served)
            address = f"{served.url}#{new_code(folder, time.time())}"
            print(f"cushion: the live page: {address}", file=sys.stderr)
            again = f"`{served.command}` prints another"
            print(
                f"cushion: it opens once, within {CODE_S:g} s; {again}", file=sys.stderr, flush=True
            )
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

        if listen.port and is_served(listen):
            tell(listen)
            return 0
        server = PageServer(listen, folder, options.rate, time.time, os.environ)
        asyncio.run(_until_signal(server.run(tell)))
    return 0


async def _until_signal(serving: Coroutine[Any, Any, None]) -> None:
    task = asyncio.ensure_future(serving)
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, task.cancel)
    with suppress(asyncio.CancelledError):
        await task
    raise KeyboardInterrupt
