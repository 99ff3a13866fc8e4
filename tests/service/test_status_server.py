import contextlib
import json
import os
import selectors
import socket
import stat
import subprocess
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from audioflinger_hook.service import status_server
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from audioflinger_hook.service.state import DaemonState
from audioflinger_hook.service.status import Endpoint, Status
from audioflinger_hook.service.status_client import ask_control, ask_status
from audioflinger_hook.service.status_server import CLIENTS_MAX, NAME, PAUSE_S, REQUEST_BYTES_MAX
from device.errors import InternalError, NotFoundError, UsageError
from tests.monitor.stand_in import odd_daemon
from tests.servers.listening import wait_for
from tests.service.test_runtime_folder import holding, root_only
from tests.support.commands import open_files

DEADLINE_S = 10.0
STATUS = Status("1", 1, DaemonState.IDLE, "", 1.0, Endpoint("default"), Endpoint("twin"))
ASK = b'{"ask": "status"}\n'
SERVE = """
import os, sys, time
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from audioflinger_hook.service.status_server import StatusServer
server = StatusServer(RuntimeFolder(os.environ, True), lambda: None, time.monotonic)
print("held", flush=True)
sys.stdin.read()
"""


class Daemon:
    def __init__(self, base: str) -> None:
        self.environ = {"XDG_RUNTIME_DIR": base}
        self.folder = RuntimeFolder(self.environ, create=True)
        self.status: Status | Exception = STATUS
        self.server = status_server.StatusServer(self.folder, self.read, time.monotonic)
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


def everything(client: socket.socket) -> bytes:
    received = b""
    with contextlib.suppress(ConnectionResetError):  # it closed while more was on its way
        while piece := client.recv(65_536):
            received += piece
    return received


def line(client: socket.socket) -> Any:
    with client.makefile("rb") as lines:
        return json.loads(lines.readline())


def test_the_socket_is_for_its_owner_alone_and_its_path_longer_than_an_address(tmp_path):
    deep = tmp_path / ("d" * 100) / ("e" * 100)
    deep.mkdir(parents=True)
    before = os.umask(0)
    try:
        daemon = Daemon(str(deep))
    finally:
        os.umask(before)
    mode = (daemon.folder.path / NAME).stat().st_mode
    assert daemon.ask() == STATUS
    daemon.close()
    assert (stat.S_ISSOCK(mode), stat.S_IMODE(mode)) == (True, 0o600)


def test_many_requests_are_answered_in_order_and_a_status_that_cannot_be_told_harms_nobody(daemon):
    with daemon.connect() as client:
        client.sendall(ASK * 3 + b"nonsense\n" + ASK)
        client.shutdown(socket.SHUT_WR)
        answers = [json.loads(text) for text in everything(client).splitlines()]
    assert ["error" in parsed for parsed in answers] == [False, False, False, True, False]
    for broken in (RuntimeError("boom\nboom"), replace(STATUS, since_s=float("nan"))):
        daemon.status = broken
        with pytest.raises(InternalError, match="does not report its status: the status"):
            daemon.ask()
    for whole in (replace(STATUS, warnings=("é" * 50_000,) * 2), STATUS):
        daemon.status = whole
        assert daemon.ask() == whole


@pytest.mark.parametrize("half", [socket.SHUT_RD, socket.SHUT_RDWR])
def test_clients_that_will_not_read_do_no_harm(daemon, half):
    for _ in range(3 * CLIENTS_MAX):
        with daemon.connect() as client:
            client.sendall(ASK)
            client.shutdown(half)
    assert daemon.ask() == STATUS


def test_a_request_that_is_too_long_or_not_ended_is_answered_and_ends_the_connection(daemon):
    with daemon.connect() as client:
        client.sendall(b'{"ask": "' + b"x" * REQUEST_BYTES_MAX)
        assert b"longer than 4096 bytes" in everything(client)
    with daemon.connect() as client:
        client.sendall(b" " * (REQUEST_BYTES_MAX - len(ASK)) + ASK)
        assert "version" in line(client)
    with daemon.connect() as client:
        client.sendall(ASK.strip())
        client.shutdown(socket.SHUT_WR)
        assert b"no line break" in everything(client)


pieces = st.one_of(
    st.binary(max_size=200),
    st.sampled_from([ASK, b"\n", b"{}\n", b"[" * 4000 + b"\n", b"\xff\n", b"NaN\n", b"1e999\n"]),
    st.sampled_from([b'{"ask": 1}\n', b'{"ask": "status", "x": 1}\n', b"x" * 5000, b"\0" * 4095]),
)


@given(messages=st.lists(pieces, max_size=6))
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whatever_is_sent_every_answer_is_json_and_the_next_is_served(daemon, messages):
    with daemon.connect() as client:
        try:
            for message in messages:
                client.sendall(message)
            client.shutdown(socket.SHUT_WR)
        except OSError:  # closed in its face
            pass
        for text in everything(client).splitlines():
            assert {"error", "version"} & json.loads(text).keys()
    assert daemon.ask() == STATUS


@pytest.fixture
def hasty_daemon(daemon, monkeypatch):
    monkeypatch.setattr(status_server, "REQUEST_TIME_S", 0.2)
    monkeypatch.setattr(status_server, "LIFETIME_S", 0.5)
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
    began_s = time.monotonic()
    with hasty_daemon.connect() as client, contextlib.suppress(OSError):
        client.sendall(ASK)
        while client.recv(65_536):  # nor does asking on and on
            client.sendall(ASK)
    assert 0.4 < time.monotonic() - began_s < 0.5 * DEADLINE_S


def test_a_client_that_does_not_take_its_answer_is_let_go(hasty_daemon):
    hasty_daemon.status = replace(STATUS, warnings=("x" * 3_000_000,))
    with hasty_daemon.connect() as deaf:
        deaf.sendall(ASK)
        wait_for(lambda: len(hasty_daemon.server._clients) == 1, "the client")
        hasty_daemon.status = STATUS
        wait_for(lambda: not hasty_daemon.server._clients, "its end")
        assert len(everything(deaf)) < 3_000_000


def test_the_ninth_client_waits_until_one_of_eight_has_gone(daemon):
    idle = [daemon.connect() for _ in range(CLIENTS_MAX)]
    wait_for(lambda: len(daemon.server._clients) == CLIENTS_MAX, "all of them")
    with daemon.connect() as ninth:
        ninth.sendall(ASK)
        with selectors.DefaultSelector() as selector:
            selector.register(ninth, selectors.EVENT_READ)
            assert selector.select(0.05) == []
        idle[0].close()
        assert "version" in line(ninth)
    for client in idle:
        client.close()


def test_a_flood_costs_the_daemon_a_bounded_number_of_answers_and_others_get_theirs(daemon):
    daemon.server._read = asked = Mock(return_value=STATUS)
    over = threading.Event()

    def flood() -> None:
        while not over.is_set():
            with contextlib.suppress(OSError), daemon.connect() as client:
                while not over.is_set():
                    client.sendall(ASK * 20)
                    client.recv(65_536)

    began_s = time.monotonic()
    with ThreadPoolExecutor(3) as floods:
        flooding = [floods.submit(flood) for _ in range(3)]
        try:
            assert [daemon.ask() for _ in range(5)] == [STATUS] * 5
        finally:
            over.set()
        assert [one.result(DEADLINE_S) for one in flooding] == [None] * 3
    # every place rests after each answer
    most = CLIENTS_MAX * ((time.monotonic() - began_s) / PAUSE_S + 1)
    assert 5 <= asked.call_count <= most


def test_other_users_get_no_answer(daemon, monkeypatch):
    monkeypatch.setattr(status_server, "peer_uid", lambda _: os.geteuid() + 1)
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
        words = [script, str(daemon.folder.path / NAME), ASK.decode()]
        told: Any = {"user": 65534, "capture_output": True, "text": True, "timeout": DEADLINE_S}
        done = subprocess.run(["/usr/bin/env", "python3", "-c", *words], **told)
        daemon.close()
    # EOF, or the end before it could send
    assert "version" not in done.stdout
    assert done.stdout == "b''\n" or "Error" in done.stderr
    assert "PermissionError" not in done.stderr


def test_stopping_closes_everything_and_removes_the_socket(tmp_path):
    files, threads, daemon = open_files(), threading.active_count(), Daemon(str(tmp_path))
    with daemon.connect() as client:
        client.sendall(ASK)
        line(client)
        daemon.close()
        daemon.server.stop()
        assert everything(client) == b""
    assert (list((tmp_path / "cushion").iterdir()), open_files()) == ([], files)
    assert threading.active_count() == threads
    daemon = Daemon(str(tmp_path))  # one that has lost its place leaves the new one alone
    (daemon.folder.path / NAME).unlink()
    with status_server.StatusServer(daemon.folder, lambda: STATUS, time.monotonic):
        daemon.server.stop()
        assert daemon.ask() == STATUS
    daemon.close()


def test_an_answer_that_takes_seconds_still_arrives(tmp_path):
    now_s = [0.0]

    def read() -> Status:
        now_s[0] += 3.0
        return STATUS

    environ = {"XDG_RUNTIME_DIR": str(tmp_path)}
    folder = RuntimeFolder(environ, create=True)
    with status_server.StatusServer(folder, read, lambda: now_s[0]):
        assert ask_status(DEADLINE_S, time.monotonic, environ) == STATUS
    folder.close()


def test_the_socket_of_a_killed_daemon_is_replaced_and_that_of_a_living_one_is_not(tmp_path):
    environ = {"XDG_RUNTIME_DIR": str(tmp_path)}
    with RuntimeFolder(environ, create=True) as folder, holding(environ, SERVE) as other:
        for _ in range(3 * CLIENTS_MAX):  # even when its queue is full: it never accepts
            with pytest.raises(UsageError, match="another cushion daemon answers"):
                status_server.StatusServer(folder, lambda: STATUS, time.monotonic)
        other.kill()
        other.wait(DEADLINE_S)
        assert (folder.path / NAME).is_socket()
        with pytest.raises(NotFoundError, match="no daemon is running"):
            ask_status(1.0, time.monotonic, environ)
        with status_server.StatusServer(folder, lambda: STATUS, time.monotonic):
            assert ask_status(DEADLINE_S, time.monotonic, environ) == STATUS


def test_what_is_no_socket_of_ours_is_neither_removed_nor_used(tmp_path):
    with RuntimeFolder({"XDG_RUNTIME_DIR": str(tmp_path)}, create=True) as folder:
        files, place = open_files(), folder.path / NAME

        def refused(words: str) -> None:
            with pytest.raises(UsageError, match=words):
                status_server.StatusServer(folder, lambda: STATUS, time.monotonic)

        place.write_text("precious")
        refused("is not a socket; remove it")
        assert place.read_text() == "precious"
        place.unlink()
        place.symlink_to("elsewhere")
        refused("is not a socket; remove it")
        if os.geteuid() == 0:
            os.chown(place, 65534, 65534, follow_symlinks=False)
            refused("belongs to user 65534; remove it as that user")
        assert open_files() == files


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


def dripping(accepted: socket.socket) -> None:
    while True:  # there is always something to read
        accepted.sendall(b"x")
        time.sleep(0.001)


@pytest.mark.parametrize(
    ("behave", "accepts"), [(everything, True), (everything, False), (dripping, True)], ids=range(3)
)
def test_a_daemon_that_hangs_or_drips_is_left_after_the_timeout(tmp_path, behave, accepts):
    with odd_daemon(tmp_path, behave, accepts=accepts):
        began_s = time.monotonic()
        with pytest.raises(InternalError, match=r"has not answered within 0.2 s"):
            ask_status(0.2, time.monotonic, {"XDG_RUNTIME_DIR": str(tmp_path)})
        assert 0.2 <= time.monotonic() - began_s < 2.0


@pytest.mark.parametrize(
    ("reply", "message"),
    [
        *((b"", "cut off or too long"), (b'{"version": ', "cut off or too long")),
        (b"x" * 2**21, "cut off or too long"),
        (b"nonsense\n", "is not JSON.*; restart it with this version"),
        (b'{"version": "9"}\n', "has no pid.*; restart it with this version"),
        (b'{"error": "busy"}\n', "does not report its status: busy"),
    ],
    ids=range(6),
)
def test_an_answer_that_is_not_understood_is_an_error_of_one_line(tmp_path, reply, message):
    replies = odd_daemon(tmp_path, lambda accepted: accepted.sendall(reply))
    with replies, pytest.raises(InternalError, match=message):
        ask_status(DEADLINE_S, time.monotonic, {"XDG_RUNTIME_DIR": str(tmp_path)})


@pytest.mark.parametrize("reply", [b"nonsense\n", b"3\n", b"[" * 100_000 + b"\n"], ids=range(3))
def test_an_answer_to_control_that_is_no_object_is_an_error_too(tmp_path, monkeypatch, reply):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    replies = odd_daemon(tmp_path, lambda accepted: accepted.sendall(reply))
    with replies, pytest.raises(InternalError, match="not understood; restart it"):
        ask_control({"trial": True}, DEADLINE_S, time.monotonic)
