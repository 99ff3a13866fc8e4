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
from typing import Any, Protocol

from prometheus_client import CONTENT_TYPE_LATEST
from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from audioflinger_hook.config.file import names_a_device
from audioflinger_hook.monitor.access import Access, Listen, load_key
from audioflinger_hook.monitor.clients import CLIENTS_MAX, Client, Clients
from audioflinger_hook.monitor.daemon_link import DaemonLink
from audioflinger_hook.monitor.figures import metrics_text
from audioflinger_hook.monitor.frames import Frames
from audioflinger_hook.service import autostart, install
from audioflinger_hook.service.one_line import one_line
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from device.errors import CushionError, InternalError, UsageError

MESSAGE_BYTES_MAX = 4096
PENDING_MAX = 48  # connections that have not shown the key; a further one closes the oldest
OPEN_S = 5.0  # timeout for the arrival of a request, and of the key
PING_S = 20.0
WRITE_BYTES = 16_384  # limit of a connection's write buffers, in this process and in the system
READ_BYTES = 16_384  # limit of a connection's read buffer in the system
METHOD_BYTES_MAX = 32
NOT_ALLOWED = HTTPStatus.METHOD_NOT_ALLOWED, "the page takes GET and HEAD"
MESSAGES_PER_S, BURST_S = 5_000, 1.0  # of all browsers; limits the CPU load
CONTROL_PAUSE_S = 0.02  # pause after each request that is forwarded to the daemon

SCRIPTS = (
    *("page", "connection", "elements", "drawing", "meters", "mapping", "waterfall", "controls"),
    *("figures", "applications", "panels", "sync", "theme", "trial", "jspsych"),
)
FILES = {  # URL path: (file, content type)
    "/": ("index.html", "text/html; charset=utf-8"),
    "/trial": ("trial.html", "text/html; charset=utf-8"),
    "/trial.css": ("trial.css", "text/css; charset=utf-8"),
    "/style.css": ("style.css", "text/css; charset=utf-8"),
    "/icon.svg": ("icon.svg", "image/svg+xml"),
    **{f"/{name}.js": (f"{name}.js", "text/javascript; charset=utf-8") for name in SCRIPTS},
}

TRY = "/try/"  # path of the page "Try it", which needs no daemon

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


class Link(Protocol):
    """Answers the requests of browsers, such as `DaemonLink`."""

    async def run(self) -> None: ...  # noqa: D102

    async def control(self, request: Mapping[str, Any]) -> dict[str, Any]: ...  # noqa: D102


class PageServer:
    """Serves the page until `run` is cancelled. Only the event loop's thread may use it.

    folder: has the key and the codes. clock: gives the time of day. link: answers browsers, None
    for the daemon. clients: the browsers.
    pending: connections that have not shown the key, the oldest first.
    """

    def __init__(
        self,
        listen: Listen,
        folder: RuntimeFolder,
        rate_hz: float,
        clock: Callable[[], float],
        environ: Mapping[str, str],
        link: Link | None = None,
    ) -> None:
        self._other_link = link
        self._listen, self._folder, self._key = listen, folder, load_key(folder)
        self._rate_hz, self._clock, self._environ = rate_hz, clock, environ
        self.clients = Clients()
        self.pending: dict[_Connection, None] = {}
        self._read_s = 0.0  # time at which the messages so far are read at MESSAGES_PER_S
        static = files("audioflinger_hook.monitor").joinpath("static")
        self._files = {
            path: (static.joinpath(name).read_bytes(), kind) for path, (name, kind) in FILES.items()
        }

    async def run(self, on_ready: Callable[[Listen], None]) -> None:
        """Serve the page; call `on_ready` with its address.

        UsageError: the address cannot be used. InternalError: too many files are open.
        """
        bound = _bound(self._listen)
        listen = Listen(self._listen.host, bound.getsockname()[1])
        self._access = Access(listen, self._key, self._folder)
        frames = Frames(
            self.clients.tell, self._rate_hz, lambda: len(self.clients) > 0, self._environ
        )
        daemon = DaemonLink(frames.take, self._rate_hz, listen.url, self._environ)
        self._link: Link = self._other_link or daemon
        logger = logging.getLogger("audioflinger_hook.monitor")
        logger.addHandler(logging.NullHandler())
        logger.propagate = False  # do not let an attacker fill the system's journal
        async with serve(
            self._converse,
            sock=bound,
            process_request=self._respond,
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
            on_ready(listen)
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._link.run())
                tasks.create_task(frames.run())

    async def _respond(self, connection: ServerConnection, request: Request) -> Response | None:
        response = await self._answer(connection, request)
        if isinstance(connection, _Connection) and connection.method == b"HEAD":
            response = response or _text(*NOT_ALLOWED)  # a HEAD request opens no websocket
            response.body = b""
        return response

    async def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return the response to a request, or None to accept the live connection."""
        headers = request.headers
        access, path = self._access, request.path
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        refusal = access.refuse_host(hosts, str(connection.local_address[0]))
        if refusal := refusal or access.refuse_origin(origins, hosts[0], needed=path == "/live"):
            return _text(HTTPStatus.FORBIDDEN, refusal)
        if path == "/live":
            return None
        if path in self._files:
            return _response(HTTPStatus.OK, *self._files[path])
        if path == "/try":
            moved = _text(HTTPStatus.PERMANENT_REDIRECT, "the page is at /try/")
            moved.headers["Location"] = TRY
            return moved
        if path.startswith(TRY) and (found := await asyncio.to_thread(_try_file, path)):
            return found
        if path == "/metrics":
            if access.has_bearer(headers.get_all("Authorization")):
                return _response(HTTPStatus.OK, metrics_text(self.clients), CONTENT_TYPE_LATEST)
            needed = "the key is missing or wrong; send the key of the file page.token as a bearer"
            return _text(HTTPStatus.FORBIDDEN, needed)
        if any(sign in path for sign in ("..", "%", "\\", "//")):
            return _text(HTTPStatus.FORBIDDEN, "this path is refused")
        return _text(HTTPStatus.NOT_FOUND, "there is no such page")

    async def _converse(self, connection: ServerConnection) -> None:
        if refusal := await self._refuse(connection):
            await connection.close(*refusal)
            return
        assert isinstance(connection, _Connection)
        self.pending.pop(connection, None)
        client = self.clients.add()
        client.answer(json.dumps({"key": self._access.key}))
        sending = asyncio.ensure_future(client.send_all(connection.send))
        asking = asyncio.ensure_future(self._carry_out(client))
        try:
            async for message in connection:
                if not _take(client, message):
                    await connection.close(1008, "this message is refused")
                    break
                if asking.done():
                    asking = asyncio.ensure_future(self._carry_out(client))
                now_s = asyncio.get_running_loop().time()
                self._read_s = max(self._read_s + 1 / MESSAGES_PER_S, now_s - BURST_S)
                await asyncio.sleep(max(0.0, self._read_s - now_s))
        except ConnectionClosed:
            pass
        finally:
            self.clients.remove(client)
            sending.cancel()
            with suppress(asyncio.CancelledError, ConnectionClosed):
                await sending
            await asyncio.wait({asking}, timeout=3.0)
            asking.cancel()
            if client.tries:
                await self._link.control({"sync": {"try_ms": None}})

    async def _refuse(self, connection: ServerConnection) -> tuple[int, str] | None:
        """Return why a connection is closed, as code and text; None if it shows a key or code."""
        shown = None
        with suppress(TimeoutError, ConnectionClosed):
            async with asyncio.timeout(OPEN_S):
                shown = _document(await connection.recv())
        if shown is None:
            return 1008, "this message is refused"
        if len(self.clients) >= CLIENTS_MAX:
            return 1013, f"{CLIENTS_MAX} pages are open already; close one of them"
        if not self._access.admits(shown.get("key"), shown.get("code"), self._clock()):
            return 1008, self._access.advice
        return None

    async def _carry_out(self, client: Client) -> None:
        """Carry out the waiting requests of a browser."""
        while waiting := client.requests.take():
            request, answer_by = waiting
            if request.keys() == {"autostart"}:
                answer = await asyncio.to_thread(self._start_at_login, request["autostart"])
            else:
                if isinstance(sync := request.get("sync"), dict):
                    client.tries = sync.get("try_ms") is not None
                answer = await self._link.control(request)
            answer_by(answer)
            await asyncio.sleep(CONTROL_PAUSE_S)

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
    """A connection with a small write buffer. Unlike the library, it knows methods beside GET.

    method: the request's method; b"" until it is known.
    """

    def __init__(self, server: PageServer, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._pending = server.pending
        self._begin = self.method = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        own = transport.get_extra_info("socket")
        own.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, WRITE_BYTES)
        super().connection_made(transport)
        if len(self._pending) >= PENDING_MAX:
            oldest = next(iter(self._pending))
            del self._pending[oldest]
            oldest.transport.abort()
        self._pending[self] = None

    def data_received(self, data: bytes) -> None:
        if not self.method:
            data = self._begin = self._begin + data
            method, space, rest = data.partition(b" ")
            if not space and len(data) < METHOD_BYTES_MAX:
                return  # the method may be incomplete
            self.method = method or b" "  # never empty again
            if method == b"HEAD":
                data = b"GET " + rest
            elif method != b"GET":
                self.transport.write(_text(*NOT_ALLOWED).serialize())
                self.transport.write_eof()
        if self.method in (b"GET", b"HEAD"):
            super().data_received(data)

    def connection_lost(self, error: Exception | None) -> None:
        self._pending.pop(self, None)
        super().connection_lost(error)


def _document(message: str | bytes) -> dict[str, Any] | None:
    """Return a message's JSON object; None if it has none."""
    found = None
    with suppress(ValueError, RecursionError):
        found = json.loads(message) if isinstance(message, str) else None
    return found if isinstance(found, dict) else None


def _take(client: Client, message: str | bytes) -> bool:
    """Take a browser's message; return whether it is valid."""
    asked = _document(message) or {}
    if type(asked.get("ack")) is int:
        client.acknowledge(asked["ack"])
        return True
    number = asked.pop("id", None)
    if type(number) is int:
        client.requests.put(
            asked, lambda answer: client.answer(json.dumps({"id": number, "answer": answer}))
        )
    return type(number) is int


def _try_file(path: str) -> Response | None:
    """Return a file of the page "Try it"; None if it has no such file."""
    from audioflinger_hook.monitor import try_page  # takes memory

    name = path.removeprefix(TRY) or "index.html"
    content = try_page.page_files().get(name)
    if content is None:
        return None
    response = _response(HTTPStatus.OK, content(), try_page.content_type(name))
    del response.headers["Content-Security-Policy"]
    policy = f"{try_page.CONTENT_SECURITY_POLICY}; frame-ancestors 'none'"
    response.headers["Content-Security-Policy"] = policy
    return response


def _bound(listen: Listen) -> socket.socket:
    where = f"{listen.host}:{listen.port}"
    try:
        found = socket.getaddrinfo(listen.host.strip("[]"), listen.port, type=socket.SOCK_STREAM)
        family, _, _, _, address = found[0]
        with ExitStack() as stack:
            bound = stack.enter_context(socket.socket(family, socket.SOCK_STREAM))
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, READ_BYTES)
            bound.bind(address)
            bound.listen(PENDING_MAX)
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
    own["Allow"] = "GET, HEAD"
    return Response(status.value, status.phrase, Headers(SECURITY | own), body)


def _text(status: HTTPStatus, reason: str) -> Response:
    return _response(status, f"{reason}\n".encode(), "text/plain; charset=utf-8")
