"""The status server answers its user and is hurt by nobody."""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import socket
import stat
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.service import status_server as server_module
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from audioflinger_hook.service.state import DaemonState
from audioflinger_hook.service.status import Endpoint, Status
from audioflinger_hook.service.status_client import ask_status
from audioflinger_hook.service.status_server import (
    CLIENTS_MAX,
    NAME,
    PAUSE_S,
    REQUEST_BYTES_MAX,
    StatusServer,
    answer,
)
from device.errors import InternalError, NotFoundError, UsageError
from tests.service.test_runtime_folder import root_only
from tests.support.commands import environment, open_files

DEADLINE_S = 10.0
STATUS = Status("1", 1, DaemonState.IDLE, "", 1.0, Endpoint("default"), Endpoint("twin"))
ASK = b'{"ask": "status"}\n'
SERVE = """
import os, sys, time
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from audioflinger_hook.service.status_server import StatusServer
server = StatusServer(RuntimeFolder(os.environ, True), lambda: None, time.monotonic)
print("listening", flush=True)
sys.stdin.read()
"""


class Daemon:
    """A server in a folder of its own, and its clients."""

    def __init__(self, base: str) -> None:
        self.environ = {"XDG_RUNTIME_DIR": base}
        self.folder = RuntimeFolder(self.environ, create=True)
        self.status: Status | Exception = STATUS
        self.server = StatusServer(self.folder, self.read, time.monotonic)
        self.server.__enter__()

    def read(self) -> Status:
        if isinstance(self.status, Exception):
            raise self.status
        return self.status

    def connect(self) -> socket.socket:
        client = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        client.connect(self.folder.address(NAME))  # waits while the queue is full
        client.settimeout(DEADLINE_S)
        return client

    def ask(self) -> Status:
        return ask_status(DEADLINE_S, time.monotonic, self.environ)

    def close(self) -> None:
        alive = self.server._stopping.is_set() or all(t.is_alive() for t in self.server._threads)
        self.server.stop()
        assert alive
        self.folder.close()


@pytest.fixture
def daemon(tmp_path):
    daemon = Daemon(str(tmp_path))
    yield daemon
    daemon.close()


def until(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline_s
        os.sched_yield()


def everything(client: socket.socket) -> bytes:
    """Return all that comes until the server closes."""
    received = bytearray()
    try:
        while piece := client.recv(65_536):
            received += piece
    except ConnectionResetError:  # it closed while more was on its way
        pass
    return bytes(received)


def line(client: socket.socket) -> dict[str, object]:
    received = bytearray()
    while not received.endswith(b"\n"):
        piece = client.recv(65_536)
        assert piece, received
        received += piece
    parsed = json.loads(received)
    assert isinstance(parsed, dict)
    return parsed


def test_a_client_gets_the_status_as_it_is_when_it_asks(daemon):
    assert daemon.ask() == STATUS
    daemon.status = replace(STATUS, state=DaemonState.RUNNING, warnings=("é" * 50_000,) * 2)
    assert daemon.ask() == daemon.status


def test_the_socket_is_for_its_owner_alone(tmp_path):
    before = os.umask(0)
    try:
        daemon = Daemon(str(tmp_path))
    finally:
        os.umask(before)
    mode = (daemon.folder.path / NAME).stat().st_mode
    daemon.close()
    assert stat.S_ISSOCK(mode)
    assert stat.S_IMODE(mode) == 0o600


def test_a_path_longer_than_a_socket_address_makes_no_difference(tmp_path):
    deep = tmp_path / ("d" * 100) / ("e" * 100)
    deep.mkdir(parents=True)
    daemon = Daemon(str(deep))
    assert daemon.ask() == STATUS
    daemon.close()


def test_many_requests_on_one_connection_are_answered_in_order(daemon):
    with daemon.connect() as client:
        client.sendall(ASK * 3 + b"nonsense\n" + ASK)
        client.shutdown(socket.SHUT_WR)
        answers = [json.loads(text) for text in everything(client).splitlines()]
    assert ["error" in parsed for parsed in answers] == [False, False, False, True, False]


def test_a_client_that_has_closed_its_writing_half_gets_its_answer(daemon):
    with daemon.connect() as client:
        client.sendall(ASK)
        client.shutdown(socket.SHUT_WR)
        assert json.loads(everything(client))["state"] == "idle"


@pytest.mark.parametrize("half", [socket.SHUT_RD, socket.SHUT_RDWR])
def test_clients_that_will_not_read_do_no_harm(daemon, half):
    for _ in range(3 * CLIENTS_MAX):
        with daemon.connect() as client:
            client.sendall(ASK)
            client.shutdown(half)
    assert daemon.ask() == STATUS


def test_a_request_that_is_too_long_is_answered_and_ends_the_connection(daemon):
    with daemon.connect() as client:
        client.sendall(b'{"ask": "' + b"x" * REQUEST_BYTES_MAX)
        assert b"longer than 4096 bytes" in everything(client)
    with daemon.connect() as client:
        client.sendall(b" " * (REQUEST_BYTES_MAX - len(ASK)) + ASK)
        assert "version" in line(client)


def test_a_request_without_line_break_is_answered_with_what_is_missing(daemon):
    with daemon.connect() as client:
        client.sendall(ASK.strip())
        client.shutdown(socket.SHUT_WR)
        assert b"no line break" in everything(client)


def test_a_status_that_cannot_be_told_harms_neither_daemon_nor_client(daemon):
    for broken in (RuntimeError("boom\nboom"), replace(STATUS, since_s=float("nan"))):
        daemon.status = broken
        with pytest.raises(InternalError, match="does not report its status: the status"):
            daemon.ask()
    daemon.status = STATUS
    assert daemon.ask() == STATUS


pieces = st.one_of(
    st.binary(max_size=200),
    st.sampled_from([ASK, b"\n", b"{}\n", b"[" * 4000 + b"\n", b"\xff\n", b"NaN\n", b"1e999\n"]),
    st.sampled_from([b'{"ask": 1}\n', b'{"ask": "status", "x": 1}\n', b"x" * 5000, b"\0" * 4095]),
)


@pytest.fixture(scope="module")
def shared_daemon(tmp_path_factory):
    daemon = Daemon(str(tmp_path_factory.mktemp("run")))
    yield daemon
    daemon.close()


@given(st.lists(pieces, max_size=6))
@settings(max_examples=40)
def test_whatever_is_sent_every_answer_is_a_line_of_json_and_the_next_client_is_served(
    shared_daemon, messages
):
    with shared_daemon.connect() as client:
        try:
            for message in messages:
                client.sendall(message)
            client.shutdown(socket.SHUT_WR)
        except OSError:  # closed in its face
            pass
        for text in everything(client).splitlines():
            assert {"error", "version"} & json.loads(text).keys()
    assert shared_daemon.ask() == STATUS


@given(st.binary(max_size=5000) | st.recursive(st.none(), st.lists).map(str).map(str.encode))
def test_every_request_has_an_answer_of_one_line(request_line):
    reply = answer(request_line, lambda: STATUS)
    assert reply.endswith(b"\n")
    assert reply.count(b"\n") == 1
    assert json.loads(reply)


# ------------------------------------------------------------------------- slow and many clients


@pytest.fixture
def hasty_daemon(daemon, monkeypatch):
    monkeypatch.setattr(server_module, "REQUEST_TIME_S", 0.2)
    monkeypatch.setattr(server_module, "LIFETIME_S", 0.5)
    return daemon


def test_a_client_that_takes_too_long_is_let_go(hasty_daemon):
    with hasty_daemon.connect() as slow, hasty_daemon.connect() as drip:
        drip.sendall(ASK)
        assert "version" in line(drip)
        slow.sendall(b"{")
        began_s = time.monotonic()
        with contextlib.suppress(OSError):
            while time.monotonic() < began_s + DEADLINE_S:  # a piece of a request buys no time
                drip.sendall(b" ")
                time.sleep(0.02)
        assert 0.1 < time.monotonic() - began_s < 0.5 * DEADLINE_S
        assert hasty_daemon.ask() == STATUS
        assert everything(slow) == everything(drip) == b""


def test_a_client_that_does_not_take_its_answer_is_let_go(hasty_daemon):
    hasty_daemon.status = replace(STATUS, warnings=("x" * 3_000_000,))
    with hasty_daemon.connect() as deaf:
        deaf.sendall(ASK)
        until(lambda: len(hasty_daemon.server._clients) == 1)
        hasty_daemon.status = STATUS
        until(lambda: not hasty_daemon.server._clients)
        assert len(everything(deaf)) < 3_000_000


def test_the_ninth_client_waits_until_one_of_eight_has_gone(daemon):
    idle = [daemon.connect() for _ in range(CLIENTS_MAX)]
    until(lambda: len(daemon.server._clients) == CLIENTS_MAX)
    with daemon.connect() as ninth:
        ninth.sendall(ASK)
        with selectors.DefaultSelector() as selector:
            selector.register(ninth, selectors.EVENT_READ)
            assert selector.select(0.05) == []
        idle[0].close()
        assert "version" in line(ninth)
    for client in idle:
        client.close()


def test_nobody_keeps_a_place_for_ever_by_asking_on_and_on(hasty_daemon):
    began_s = time.monotonic()
    with hasty_daemon.connect() as client, contextlib.suppress(OSError):
        client.sendall(ASK)
        while client.recv(65_536):
            client.sendall(ASK)
    assert 0.4 < time.monotonic() - began_s < 0.5 * DEADLINE_S


def test_a_flood_costs_the_daemon_a_bounded_number_of_answers_and_others_get_theirs(daemon):
    asked = 0

    def count() -> Status:
        nonlocal asked
        asked += 1
        return STATUS

    daemon.server._read = count
    over = threading.Event()

    def flood() -> None:
        while not over.is_set():
            try:
                with daemon.connect() as client:
                    while not over.is_set():
                        client.sendall(ASK * 20)
                        client.recv(65_536)
            except OSError:
                pass

    floods = [threading.Thread(target=flood) for _ in range(3)]
    began_s = time.monotonic()
    for thread in floods:
        thread.start()
    try:
        for _ in range(5):
            assert daemon.ask() == STATUS
    finally:
        over.set()
        for thread in floods:
            thread.join(DEADLINE_S)
    assert not any(thread.is_alive() for thread in floods)
    # every place rests after each answer
    assert 5 <= asked <= CLIENTS_MAX * ((time.monotonic() - began_s) / PAUSE_S + 1)


def test_other_users_get_no_answer(daemon, monkeypatch):
    monkeypatch.setattr(server_module, "peer_uid", lambda _: os.geteuid() + 1)
    with daemon.connect() as client:
        with contextlib.suppress(BrokenPipeError):  # closed before it could ask
            client.sendall(ASK)
        assert everything(client) == b""


@root_only
def test_another_user_who_reaches_the_socket_gets_no_answer():
    with tempfile.TemporaryDirectory() as base:
        os.chmod(base, 0o755)  # noqa: PTH101
        daemon = Daemon(base)
        daemon.folder.path.chmod(0o755)
        (daemon.folder.path / NAME).chmod(0o666)
        script = (
            "import socket, sys; s = socket.socket(socket.AF_UNIX); s.settimeout(10);"
            "s.connect(sys.argv[1]); s.sendall(sys.argv[2].encode()); print(s.recv(9))"
        )
        address = str(daemon.folder.path / NAME)
        done = subprocess.run(
            ["/usr/bin/env", "python3", "-c", script, address, ASK.decode()],
            user=65534,
            capture_output=True,
            text=True,
            timeout=DEADLINE_S,
        )
        daemon.close()
    # EOF, or the end before it could send
    assert "version" not in done.stdout
    assert done.stdout == "b''\n" or "Error" in done.stderr
    assert "PermissionError" not in done.stderr


# ------------------------------------------------------------------------------ start and end


def test_stopping_closes_everything_and_removes_the_socket(tmp_path):
    files, threads = open_files(), threading.active_count()
    daemon = Daemon(str(tmp_path))
    with daemon.connect() as client:
        client.sendall(ASK)
        line(client)
        daemon.close()
        daemon.server.stop()
        assert everything(client) == b""
    assert list((tmp_path / "cushion").iterdir()) == []
    assert open_files() == files
    assert threading.active_count() == threads


def test_the_socket_of_a_killed_daemon_is_replaced_and_that_of_a_living_one_is_not(tmp_path):
    environ = {"XDG_RUNTIME_DIR": str(tmp_path)}
    with (
        RuntimeFolder(environ, create=True) as folder,
        subprocess.Popen(
            [sys.executable, "-c", SERVE],
            env=environment(**environ),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        ) as other,
    ):
        assert other.stdout is not None
        assert other.stdout.readline() == b"listening\n"
        for _ in range(3 * CLIENTS_MAX):  # even when its queue is full: it never accepts
            with pytest.raises(UsageError, match="another cushion daemon answers"):
                StatusServer(folder, lambda: STATUS, time.monotonic)
        other.kill()
        other.wait(DEADLINE_S)
        assert (folder.path / NAME).is_socket()
        with pytest.raises(NotFoundError, match="no daemon is running"):
            ask_status(1.0, time.monotonic, environ)
        with StatusServer(folder, lambda: STATUS, time.monotonic):
            assert ask_status(DEADLINE_S, time.monotonic, environ) == STATUS


def test_a_server_that_lost_its_place_leaves_the_new_one_alone(daemon):
    (daemon.folder.path / NAME).unlink()
    with StatusServer(daemon.folder, lambda: STATUS, time.monotonic):
        daemon.server.stop()
        assert daemon.ask() == STATUS


def test_what_is_no_socket_of_ours_is_neither_removed_nor_used(tmp_path):
    environ = {"XDG_RUNTIME_DIR": str(tmp_path)}
    with RuntimeFolder(environ, create=True) as folder:
        files = open_files()
        (folder.path / NAME).write_text("precious")
        with pytest.raises(UsageError, match="is not a socket; remove it"):
            StatusServer(folder, lambda: STATUS, time.monotonic)
        assert (folder.path / NAME).read_text() == "precious"
        (folder.path / NAME).unlink()
        (folder.path / NAME).symlink_to("elsewhere")
        with pytest.raises(UsageError, match="is not a socket; remove it"):
            StatusServer(folder, lambda: STATUS, time.monotonic)
        if os.geteuid() == 0:
            os.chown(folder.path / NAME, 65534, 65534, follow_symlinks=False)
            with pytest.raises(UsageError, match="belongs to user 65534; remove it as that user"):
                StatusServer(folder, lambda: STATUS, time.monotonic)
        assert open_files() == files


# ---------------------------------------------------------------------------------- the client


def test_without_a_daemon_the_client_says_how_to_start_one(tmp_path):
    environ = {"XDG_RUNTIME_DIR": str(tmp_path)}
    message = "^no daemon is running; start one with `cushion run`$"
    with pytest.raises(NotFoundError, match=message):
        ask_status(1.0, time.monotonic, environ)
    RuntimeFolder(environ, create=True).close()
    with pytest.raises(NotFoundError, match=message):
        ask_status(1.0, time.monotonic, environ)
    with pytest.raises(UsageError, match="XDG_RUNTIME_DIR is 'nowhere'"):
        ask_status(1.0, time.monotonic, {"XDG_RUNTIME_DIR": "nowhere"})


@pytest.fixture
def odd_daemon(tmp_path):
    """A socket where the daemon's should be, which answers as the test says."""
    environ = {"XDG_RUNTIME_DIR": str(tmp_path)}
    with (
        RuntimeFolder(environ, create=True) as folder,
        socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener,
    ):
        listener.bind(folder.address(NAME))
        yield environ, listener


@pytest.mark.parametrize("backlog", [1, 0])
def test_a_daemon_that_hangs_is_left_after_the_timeout(odd_daemon, backlog):
    environ, listener = odd_daemon
    listener.listen(backlog)
    waiting = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    with waiting:
        if not backlog:  # the queue is full: even the connection waits
            waiting.connect(listener.getsockname())
        began_s = time.monotonic()
        with pytest.raises(InternalError, match=r"has not answered within 0.2 s"):
            ask_status(0.2, time.monotonic, environ)
        assert 0.2 <= time.monotonic() - began_s < 2.0


def test_an_answer_that_drips_in_is_left_after_the_timeout(odd_daemon):
    environ, listener = odd_daemon
    listener.listen(1)

    def drip() -> None:
        accepted, _ = listener.accept()
        with accepted, contextlib.suppress(OSError):
            while True:  # there is always something to read
                accepted.sendall(b"x")
                time.sleep(0.001)

    thread = threading.Thread(target=drip)
    thread.start()
    with pytest.raises(InternalError, match=r"has not answered within 0.3 s"):
        ask_status(0.3, time.monotonic, environ)
    thread.join(DEADLINE_S)
    assert not thread.is_alive()


@pytest.mark.parametrize(
    ("reply", "message"),
    [
        (b"", "cut off or too long"),
        (b'{"version": ', "cut off or too long"),
        (b"x" * 2**21, "cut off or too long"),
        (b"nonsense\n", "is not JSON.*; restart it with this version"),
        (b'{"version": "9"}\n', "has no pid.*; restart it with this version"),
        (b'{"error": "busy"}\n', "does not report its status: busy"),
    ],
    ids=range(6),
)
def test_an_answer_that_is_not_understood_is_an_error_of_one_line(odd_daemon, reply, message):
    environ, listener = odd_daemon
    listener.listen(1)

    def serve() -> None:
        accepted, _ = listener.accept()
        with accepted:
            accepted.recv(100)
            with contextlib.suppress(OSError):  # it has heard enough
                accepted.sendall(reply)

    thread = threading.Thread(target=serve)
    thread.start()
    with pytest.raises(InternalError, match=message):
        ask_status(DEADLINE_S, time.monotonic, environ)
    thread.join(DEADLINE_S)
