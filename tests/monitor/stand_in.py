"""A daemon's socket without a daemon, and requests as an attacker would write them."""

import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

from audioflinger_hook.service.meters import BufferTimes, Level
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from audioflinger_hook.service.state import DaemonState
from audioflinger_hook.service.status import Endpoint, LatencyBudget, Levels, Status
from audioflinger_hook.service.status_server import NAME, StatusServer
from tests.support.commands import environment
from tools.live_page import Monitor

LIMIT_S = 60.0

STATUS = Status(
    *("0.1.0", 1, DaemonState.RUNNING, "", 1.0),
    *(Endpoint("default", "desktop.monitor"), Endpoint("sink:haptic", "haptic")),
    levels=Levels(Level(-6.0, -9.0), Level(-12.0, -15.0)),
    buffer_times=BufferTimes(0.2, 0.4, 1.0, 10.7, 2.0, (1, 2, 3, 4, 5, 6, 6, 6, 6, 6), 0.004, 1),
    latency=LatencyBudget.of(delay_line_ms=3.0),
    engine="python",
    profile="cinema",
)


class Settings:
    """What a page shows and changes, as a `Live` of the status server; requests: it was asked."""

    def __init__(self) -> None:
        self.requests: list[dict[str, Any]] = []
        self.page, self.frames, self.settings = "", 0, {"keys": [], "unsaved": 0, "undo": 0}

    def frame(self, missed: int, *, in_memory: bool) -> tuple[bytes, bool]:
        self.frames += 1
        frame = {"state": "running", "level": 1.0, "sound": [[0.5, 0.125]] * 2}
        frame |= {"vibration": [[0.25, 0.03]], "partials": [[440, 100, 0.5]], "missed": missed}
        return json.dumps({"frame": frame}).encode() + b"\n", False

    def watched_by(self, page: str) -> None:
        self.page = page

    def control(self, request: dict[str, Any]) -> dict[str, Any]:
        self.requests.append(request)
        return {"done": True}


@contextmanager
def daemon_socket(base: Path, live: Settings | None = None) -> Iterator[Settings]:
    live = live or Settings()
    with (
        RuntimeFolder({"XDG_RUNTIME_DIR": str(base)}, create=True) as folder,
        StatusServer(folder, lambda: STATUS, time.monotonic, live),
    ):
        yield live


@contextmanager
def odd_daemon(base, behave, *, accepts=True) -> Iterator[None]:
    """A socket in the daemon's place whose connections do as told, once they were asked."""
    with (
        RuntimeFolder({"XDG_RUNTIME_DIR": str(base)}, create=True) as folder,
        socket.socket(socket.AF_UNIX) as listener,
        socket.socket(socket.AF_UNIX) as waiting,
    ):
        listener.bind(folder.address(NAME))
        listener.listen(8 if accepts else 0)

        def serve() -> None:
            with suppress(OSError):  # it is shut down
                while True:
                    client, _ = listener.accept()
                    with client, suppress(OSError):
                        client.recv(4096)
                        behave(client)

        if accepts:
            threading.Thread(target=serve, daemon=True).start()
        else:  # the queue is full: even the connection waits
            waiting.connect(listener.getsockname())
        yield
        listener.shutdown(socket.SHUT_RDWR)


class Page(Monitor):
    """A running `cushion monitor` in the runtime folder `base`, and requests to it."""

    def __init__(self, base: Path, *options: str) -> None:
        super().__init__(environment(XDG_RUNTIME_DIR=str(base)), *options)

    def connection(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.port), LIMIT_S)

    def request(self, path: str = "/", *headers: str, host: str | None = None) -> tuple[int, str]:
        """The status and the rest of the answer to a GET; 0 where the connection is closed."""
        lines = [f"GET {path} HTTP/1.1", f"Host: {self.host if host is None else host}", *headers]
        return self.raw("\r\n".join([*lines, "", ""]).encode())

    def raw(self, request: bytes) -> tuple[int, str]:
        with self.connection() as client:
            try:
                client.sendall(request)
                answer = b""
                while piece := client.recv(65_536):
                    answer += piece
            except ConnectionError:
                pass
        text = answer.decode("latin-1")
        return (int(text.split()[1]) if text.startswith("HTTP/") else 0), text

    def live(self, **headers: str) -> AbstractContextManager[ClientConnection]:
        """An open live connection with the key, as the page's own script opens it."""
        return self.showing({"key": self.key}, **headers)

    @contextmanager
    def showing(self, shown: Any, **headers: str) -> Iterator[ClientConnection]:
        """A live connection whose first message is this one; None: without a message."""
        headers = {"Origin": f"http://{self.host}", **headers}
        options: Any = {"compression": None, "max_size": 1 << 20, "open_timeout": LIMIT_S}
        url = f"ws://{self.host}/live"
        with connect(url, additional_headers=headers, **options) as live:
            if shown is not None:
                live.send(json.dumps(shown))
            yield live


@contextmanager
def page(base: Path, *options: str) -> Iterator[Page]:
    opened = Page(base, "--listen", "127.0.0.1:0", *options)
    try:
        yield opened
    finally:
        opened.close()


def everything(live: ClientConnection) -> None:
    for _ in range(1000):
        live.recv(timeout=LIMIT_S)


def message(live: ClientConnection, kind: str) -> dict[str, Any]:
    """The next message with this key; frames on the way are acknowledged."""
    end_s = time.monotonic() + LIMIT_S
    while time.monotonic() < end_s:
        found: dict[str, Any] = json.loads(live.recv(timeout=LIMIT_S))
        if "frame" in found:
            live.send(json.dumps({"ack": found["n"]}))
        if kind in found:
            return found
    raise AssertionError(f"no {kind}")


def ask(live: ClientConnection, number: int, **request: Any) -> Any:
    live.send(json.dumps({"id": number, **request}))
    found = message(live, "answer")
    assert found["id"] == number
    return found["answer"]
