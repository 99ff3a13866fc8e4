"""The page's connection to the daemon, with reconnection after a loss."""

import asyncio
import json
import os
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager, closing, suppress
from typing import Any

from audioflinger_hook.service.one_line import one_line
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from audioflinger_hook.service.status_client import NO_DAEMON
from audioflinger_hook.service.status_server import NAME, PROTOCOL, peer_uid
from device.errors import CushionError, InternalError, NotFoundError, UsageError

RETRY_S = 0.5
SILENT_S = 5.0  # the connection counts as lost after this time without a line
LINE_BYTES_MAX = 1 << 18  # longest accepted line
LINE_SHARE = 0.2  # pause after each line as a share of 1 / rate_hz, to limit the CPU load


class DaemonLink:
    """Receives the daemon's messages and forwards requests, on the event loop's thread.

    tell: gets (kind, content) of each message. The daemon sends "frame", "status" and "settings".
    Kind "link" reports a change of the connection: {"connected": ..., "text": ...}.
    rate_hz: number of frames per second. page: the page's address, which the daemon prints.
    """

    def __init__(
        self,
        tell: Callable[[str, dict[str, Any]], None],
        rate_hz: float,
        page: str,
        environ: Mapping[str, str] = os.environ,
    ) -> None:
        self._tell, self._pause_s = tell, LINE_SHARE / rate_hz
        self._watch_request = {"ask": "watch", "rate_hz": rate_hz, "memory": True, "page": page}
        self._environ = environ
        self._control = asyncio.Lock()
        self._told = ""

    async def run(self) -> None:
        """Receive messages, and connect again after a loss, until the task is cancelled."""
        while True:
            self._note(await self._attempt(self._watch()), connected=False)
            await asyncio.sleep(RETRY_S)

    async def control(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Send a request and return the daemon's answer; {"error": text} after a failure."""
        async with self._control:
            answer: dict[str, Any] = {}

            async def ask() -> None:
                async with self._asked({**request, "ask": "control"}) as reader:
                    answer.update(await _message(reader))

            problem = await self._attempt(ask())
        return {"error": problem} if problem else answer

    async def _watch(self) -> None:
        async with self._asked(self._watch_request) as reader:
            hello = await _message(reader)
            if "hello" not in hello:
                told = hello.get("error")
                reason = one_line(told) if isinstance(told, str) else "its answer is not understood"
                raise UsageError(
                    f"the daemon is of another version than the page: {reason}; restart both"
                )
            self._note(f"connected to version {hello['hello'].get('version')}", connected=True)
            while True:
                for kind, content in (await _message(reader)).items():
                    if isinstance(content, dict):
                        self._tell(kind, content)
                await asyncio.sleep(self._pause_s)

    @asynccontextmanager
    async def _asked(self, request: Mapping[str, Any]) -> AsyncIterator[asyncio.StreamReader]:
        """Send a request on a new connection; yield the reader of its answers."""
        with RuntimeFolder(self._environ, create=False) as folder:
            async with asyncio.timeout(SILENT_S):
                address = folder.address(NAME)
                reader, writer = await asyncio.open_unix_connection(address, limit=LINE_BYTES_MAX)
        with closing(writer):
            owner = peer_uid(writer.get_extra_info("socket"))
            if owner != os.geteuid():
                raise UsageError(f"the daemon runs as user {owner}; run the page as that user")
            writer.write(json.dumps({**request, "protocol": PROTOCOL}).encode() + b"\n")
            yield reader

    async def _attempt(self, what: Awaitable[None]) -> str:
        try:
            await what
        except TimeoutError:
            return f"the daemon has sent nothing for {SILENT_S:g} s; waiting for it"
        except (NotFoundError, FileNotFoundError, ConnectionRefusedError):
            return NO_DAEMON
        except CushionError as error:
            return str(error)
        except OSError as error:
            return f"the connection to the daemon is lost ({error.strerror}); waiting for it"
        return ""

    def _note(self, text: str, *, connected: bool) -> None:
        if text != self._told:
            self._told = text
            self._tell("link", {"connected": connected, "text": text})


async def _message(reader: asyncio.StreamReader) -> dict[str, Any]:
    """Return the daemon's next message. InternalError: the daemon ended or sent invalid data."""
    message = None
    try:
        async with asyncio.timeout(SILENT_S):  # wait_for() can lose a cancellation
            line = await reader.readline()
        if not line:
            raise InternalError("the daemon has ended; waiting for the next one")
        with suppress(ValueError, RecursionError):
            message = json.loads(line)
    except ValueError as error:  # the line is too long
        long = f"the daemon sends lines over {LINE_BYTES_MAX} bytes; restart it"
        raise InternalError(long) from error
    if not isinstance(message, dict):
        raise InternalError("the daemon sent an invalid message; restart the daemon")
    return message
