"""The page's server for HTTP and websockets: static files, metrics and the live connection."""

import asyncio
import errno
import json
import logging
import socket
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from functools import partial
from http import HTTPStatus
from importlib.resources import files
from typing import Any

from prometheus_client import CONTENT_TYPE_LATEST
from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from audioflinger_hook.config.file import names_a_device
from audioflinger_hook.monitor.access import Access, Listen
from audioflinger_hook.monitor.clients import CLIENTS_MAX, Client, Clients
from audioflinger_hook.monitor.daemon_link import DaemonLink
from audioflinger_hook.monitor.figures import metrics_text
from audioflinger_hook.monitor.frames import Frames
from audioflinger_hook.service import autostart, install
from audioflinger_hook.service.one_line import one_line
from device.errors import CushionError, InternalError, UsageError

MESSAGE_BYTES_MAX = 4096
CONNECTIONS_MAX = 48  # further connections are closed immediately
OPEN_S = 5.0  # timeout for the arrival of a request
PING_S = 20.0
WRITE_BYTES = 16_384  # limit of a connection's write buffers, in this process and in the system
CONTROL_PAUSE_S = 0.02  # pause after each request that is forwarded to the daemon

SCRIPTS = (
    *("page", "connection", "elements", "drawing", "meters", "mapping", "waterfall", "controls"),
    *("figures", "applications", "sync"),
)
FILES = {  # URL path: (file, content type)
    "/": ("index.html", "text/html; charset=utf-8"),
    "/style.css": ("style.css", "text/css; charset=utf-8"),
    "/icon.svg": ("icon.svg", "image/svg+xml"),
    **{f"/{name}.js": (f"{name}.js", "text/javascript; charset=utf-8") for name in SCRIPTS},
}

SECURITY = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
        "img-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}

_REQUESTS = ("set", "application", "mute", "tone", "sync", "undo", "save")


class PageServer:
    """Serves the page until `run` is cancelled. Only the event loop's thread may use it.

    connections: number of open connections.
    """

    def __init__(
        self, listen: Listen, token: str, rate_hz: float, environ: Mapping[str, str]
    ) -> None:
        self._listen, self._token = listen, token
        self._rate_hz, self._environ = rate_hz, environ
        self._clients = Clients()
        self.connections = 0
        folder = files("audioflinger_hook.monitor").joinpath("static")
        self._files = {
            path: (folder.joinpath(name).read_bytes(), kind) for path, (name, kind) in FILES.items()
        }

    async def run(self, on_ready: Callable[[str], None]) -> None:
        """Serve the page; call `on_ready` with its URL. UsageError: the address cannot be used.

        InternalError: too many files are open.
        """
        bound = _bound(self._listen)
        listen = Listen(self._listen.host, bound.getsockname()[1])
        self._access = Access(listen, self._token)
        address = f"http://{listen.shown_host}:{listen.port}/#{self._token}"
        frames = Frames(
            self._clients.tell, self._rate_hz, lambda: len(self._clients) > 0, self._environ
        )
        self._link = DaemonLink(frames.take, self._rate_hz, address, self._environ)
        logger = logging.getLogger("audioflinger_hook.monitor")
        logger.addHandler(logging.NullHandler())
        logger.propagate = False  # do not let an attacker fill the system's journal
        async with serve(
            self._converse,
            sock=bound,
            process_request=self._answer,
            create_connection=partial(_Connection, self),  # type: ignore[arg-type]
            compression=None,
            max_size=MESSAGE_BYTES_MAX,
            max_queue=4,
            write_limit=WRITE_BYTES,
            open_timeout=OPEN_S,
            close_timeout=2.0,
            ping_interval=PING_S,
            ping_timeout=PING_S,
            server_header=None,
            logger=logger,
        ):
            on_ready(address)
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._link.run())
                tasks.create_task(frames.run())

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return the response to a request, or None to accept the live connection."""
        headers = request.headers
        access, path = self._access, request.path
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        refusal = access.refuse_host(hosts, str(connection.local_address[0]))
        if refusal := refusal or access.refuse_origin(origins, hosts[0], needed=path == "/live"):
            return _text(HTTPStatus.FORBIDDEN, refusal)
        if path in self._files:
            return _response(HTTPStatus.OK, *self._files[path])
        if path not in ("/session", "/metrics", "/live"):
            if any(sign in path for sign in ("..", "%", "\\", "//")):
                return _text(HTTPStatus.FORBIDDEN, "this path is refused")
            return _text(HTTPStatus.NOT_FOUND, "there is no such page")
        cookie = access.has_cookie("; ".join(headers.get_all("Cookie")))
        bearer = access.has_bearer(headers.get_all("Authorization"))
        if path == "/session" and bearer:
            response = _response(HTTPStatus.NO_CONTENT, b"", "text/plain")
            response.headers["Set-Cookie"] = access.cookie
            return response
        if path == "/metrics" and (cookie or bearer):
            return _response(HTTPStatus.OK, metrics_text(self._clients), CONTENT_TYPE_LATEST)
        if path == "/metrics" or not cookie:
            needed = "the token is missing or wrong; open the address that `cushion monitor` prints"
            return _text(HTTPStatus.FORBIDDEN, needed)
        if len(self._clients) >= CLIENTS_MAX:
            reason = f"{CLIENTS_MAX} pages are open already; close one of them"
            return _text(HTTPStatus.SERVICE_UNAVAILABLE, reason)
        return None if path == "/live" else _response(HTTPStatus.NO_CONTENT, b"", "text/plain")

    async def _converse(self, connection: ServerConnection) -> None:
        if len(self._clients) >= CLIENTS_MAX:  # other browsers connected since the first check
            await connection.close(1013, "too many pages are open")
            return
        client = self._clients.add()
        sending = asyncio.ensure_future(client.send_all(connection.send))
        try:
            async for message in connection:
                if not await self._take(client, message):
                    await connection.close(1008, "this message is refused")
                    return
        except ConnectionClosed:
            pass
        finally:
            self._clients.remove(client)
            sending.cancel()
            with suppress(asyncio.CancelledError, ConnectionClosed):
                await sending
            if client.tries:
                await self._link.control({"sync": {"try_ms": None}})

    async def _take(self, client: Client, message: str | bytes) -> bool:
        """Process a browser's message; return whether the message is valid."""
        asked = None
        with suppress(ValueError, RecursionError):
            asked = json.loads(message) if isinstance(message, str) else None
        if not isinstance(asked, dict):
            return False
        if type(asked.get("ack")) is int:
            client.acknowledge(asked["ack"])
            return True
        if type(asked.get("id")) is not int:
            return False
        request = {name: asked[name] for name in _REQUESTS if name in asked}
        if "autostart" in asked:
            answer = await asyncio.to_thread(self._start_at_login, asked["autostart"])
        else:
            answer = await self._link.control(request)
            if isinstance(sync := request.get("sync"), dict):
                client.tries = sync.get("try_ms") is not None
        client.answer(json.dumps({"id": asked["id"], "answer": answer}))
        await asyncio.sleep(CONTROL_PAUSE_S)
        return True

    def _start_at_login(self, on: object) -> dict[str, Any]:
        """Switch the start at login on or off, or only report it if `on` is None.

        The daemon cannot do this, because its service may not write to the config home.
        """
        if on is not None and not isinstance(on, bool):
            return {"error": "autostart takes true, false or null"}
        try:
            if on is not None:
                unit = install.installed_text(self._environ) or ""
                if on and '"--device"' not in unit and not names_a_device():
                    raise UsageError("the config names no device; run `cushion setup` first")
                autostart.set_on(on, self._environ)
            return {"done": True, "autostart": autostart.is_on(self._environ)}
        except CushionError as error:
            return {"error": one_line(str(error), 400)}


class _Connection(ServerConnection):
    """A connection with a small write buffer. `PageServer.connections` counts open connections."""

    def __init__(self, server: PageServer, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._page_server = server

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        own = transport.get_extra_info("socket")
        own.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, WRITE_BYTES)
        super().connection_made(transport)
        self._page_server.connections += 1
        if self._page_server.connections > CONNECTIONS_MAX:
            assert isinstance(transport, asyncio.Transport)
            transport.abort()

    def connection_lost(self, error: Exception | None) -> None:
        self._page_server.connections -= 1
        super().connection_lost(error)


def _bound(listen: Listen) -> socket.socket:
    where = f"{listen.host}:{listen.port}"
    try:
        found = socket.getaddrinfo(listen.host.strip("[]"), listen.port, type=socket.SOCK_STREAM)
        family, _, _, _, address = found[0]
        with ExitStack() as stack:
            bound = stack.enter_context(socket.socket(family, socket.SOCK_STREAM))
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            bound.bind(address)
            bound.listen(CONNECTIONS_MAX)
            stack.pop_all()
        return bound
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise UsageError(
                f"{where} is in use, perhaps by another page; open that one, or give another port "
                f"with --listen {listen.host}:{listen.port + 1}"
            ) from error
        problem = f"cannot listen on {where}: {error.strerror}"
        if error.errno in (errno.EMFILE, errno.ENFILE):
            raise InternalError(problem) from error
        raise UsageError(f"{problem}; give an address of this computer") from error


def _response(status: HTTPStatus, body: bytes, kind: str) -> Response:
    own = {"Content-Type": kind, "Content-Length": str(len(body)), "Connection": "close"}
    return Response(status.value, status.phrase, Headers(SECURITY | own), body)


def _text(status: HTTPStatus, reason: str) -> Response:
    return _response(status, f"{reason}\n".encode(), "text/plain; charset=utf-8")
