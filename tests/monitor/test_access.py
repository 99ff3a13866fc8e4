import json
import os
import re
import socket
import stat
from contextlib import ExitStack, suppress
from typing import cast

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection

from audioflinger_hook import __version__
from audioflinger_hook.monitor.access import CODE_S, KEY_NAME, Access, Listen, load_key, new_code
from audioflinger_hook.monitor.clients import CLIENTS_MAX, Clients
from audioflinger_hook.monitor.figures import figures_of, metrics_text
from audioflinger_hook.monitor.server import FILES, MESSAGE_BYTES_MAX, PENDING_MAX
from audioflinger_hook.service.json_codec import to_json
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from device.errors import UsageError
from tests.monitor import stand_in
from tests.monitor.stand_in import LIMIT_S, STATUS, ask, daemon_socket, everything, message, page
from tests.servers.listening import wait_for

FORBIDDEN = 403
NOWHERE = cast(RuntimeFolder, None)
UPGRADE = (
    *("Connection: Upgrade", "Upgrade: websocket", "Sec-WebSocket-Version: 13"),
    "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==",
)


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    return tmp_path_factory.mktemp("runtime")


@pytest.fixture(scope="module")
def daemon(base):
    with daemon_socket(base) as live:
        yield live


@pytest.fixture(scope="module")
def served(base, daemon):
    with page(base) as opened:
        yield opened
        assert opened.process.poll() is None


@pytest.fixture(autouse=True)
def nothing_was_changed(daemon, served):
    """After every attack the daemon has been asked nothing, and the page still serves."""
    daemon.requests.clear()
    yield
    assert daemon.requests == []
    with served.live() as live:
        assert ask(live, 1, undo=True) == {"done": True}
    daemon.requests.clear()


def check_refused(served: stand_in.Page, path: str, *headers: str, host: str | None = None) -> None:
    status, answer = served.request(path, *headers, host=host)
    assert status == FORBIDDEN
    assert served.key not in answer
    assert "Set-Cookie" not in answer


def closing(live: ClientConnection) -> str:
    with pytest.raises(ConnectionClosed):
        live.recv(timeout=LIMIT_S)
    return live.close_reason or ""


@pytest.mark.parametrize(
    "host",
    ["evil.example", "evil.example:8765", "", "127.0.0.1", "localhost", "127.0.0.1:1", "[::1"],
)
@pytest.mark.parametrize("path", ["/", "/live", "/metrics"])
def test_a_foreign_host_is_refused(served, host, path):
    bearer = f"Authorization: Bearer {served.key}"
    check_refused(served, path, bearer, *UPGRADE, host=host)
    check_refused(served, path, bearer, "Host: evil.example")


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1", "https://{host}", "file://"]
)
def test_a_foreign_origin_is_refused_even_with_the_key_and_a_missing_one_as_well(served, origin):
    bearer, foreign = f"Authorization: Bearer {served.key}", origin.format(host=served.host)
    for path in ("/", "/live", "/metrics"):
        check_refused(served, path, f"Origin: {foreign}", bearer, *UPGRADE)
    with pytest.raises(InvalidStatus, match="403"), served.live(Origin=foreign):
        pass
    check_refused(served, "/live", bearer, *UPGRADE)


@pytest.mark.parametrize(
    "shown",
    [
        *({}, {"key": ""}, {"key": "0" * 32}, {"key": 5}, {"key": None, "code": ["x"]}),
        *({"code": code} for code in ("", "../page.token", "\ud800", "x" * 3000)),
        {"id": 1, "undo": 1},
    ],
    ids=str,
)
def test_without_the_key_or_a_code_nothing_live_is_told_but_the_command(served, shown):
    said = f"run `cushion monitor --listen {served.host} --open`"
    with served.showing(shown) as live:
        assert closing(live) == f"this tab has no key; {said}"
        assert live.close_code == 1008


@pytest.mark.parametrize("given", ["Bearer", "Bearer " + "0" * 32, "Basic {key}", "{key}", "é"])
def test_the_metrics_need_the_key_as_the_only_bearer(served, given):
    check_refused(served, "/metrics", f"Authorization: {given.format(key=served.key)}")
    check_refused(served, "/metrics", *[f"Authorization: Bearer {served.key}"] * 2)
    assert served.request("/metrics", f"Authorization: Bearer {served.key}")[0] == 200


def test_a_code_becomes_the_key_once_for_a_minute_and_no_answer_sets_a_cookie(served, base):
    path = base / "cushion" / KEY_NAME
    assert (stat.S_IMODE(path.stat().st_mode), path.read_text()) == (0o600, served.key)
    assert len(bytes.fromhex(served.key)) == 16  # 128 bits
    code = served.new_address().partition("#")[2]
    for is_first in (True, False):
        with served.showing({"code": code.upper(), "key": ""}) as live:
            if is_first:
                assert message(live, "key") == {"key": served.key}
            else:
                assert "no key" in closing(live)
    answers = [served.request(path)[1].lower() for path in (*FILES, "/live", "/metrics", "/x")]
    assert not any("set-cookie" in one or served.key in one for one in answers)


def test_codes_expire_and_are_removed(tmp_path):
    with RuntimeFolder({"XDG_RUNTIME_DIR": str(tmp_path)}, create=True) as folder:
        access = Access(Listen.parse("127.0.0.1:1"), "0" * 32, folder)
        first, second = new_code(folder, 1000.0), new_code(folder, 1000.0)
        assert access.admits("", first, 1000.0 + CODE_S)
        assert not access.admits("", second, 1000.1 + CODE_S)
        assert not access.admits("", new_code(folder, 1000.0), 900.0)  # the clock was set back
        for now_s in (1000.0, 1100.0, 1200.0):
            third = new_code(folder, now_s)
        assert len([*folder.path.glob("page.code.*")]) == 1
        assert access.admits("0" * 32, third, 1200.0)  # ends the code as well
        assert not access.admits("", third, 1200.0)


@pytest.mark.parametrize(
    ("path", "status"),
    [
        *((f"/{up}/{up}/etc/passwd", FORBIDDEN) for up in ("..", "..%2f", "%2e%2e", "..\\\\")),
        *((path, FORBIDDEN) for path in ("//etc/passwd", "/static/../../server.py")),
        *((f"/{name}", 404) for name in ("page.token", "server.py", "config.toml", "index.html")),
    ],
)
def test_only_the_table_is_served(served, path, status):
    found, answer = served.request(path, f"Authorization: Bearer {served.key}")
    assert found == status
    assert "root:" not in answer


@pytest.mark.parametrize(("path", "kind"), [(path, kind) for path, (_, kind) in FILES.items()])
def test_every_file_of_the_page_has_the_policy_and_loads_nothing_from_elsewhere(served, path, kind):
    status, answer = served.request(path)
    head, _, body = answer.partition("\r\n\r\n")
    assert status == 200
    policy = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'"
    for line in (policy, "X-Content-Type-Options: nosniff", "X-Frame-Options: DENY"):
        assert line in head
    assert "access-control" not in head.lower()
    assert body
    body = body if path != "/jspsych.js" else ""  # its messages name pages of its manual
    assert not re.search("https?://", body.replace('xmlns="http://www.w3.org/2000/svg"', ""))
    assert not ("html" in kind and re.search("<style| style=| onclick=", body))


@pytest.mark.parametrize("name", ["", "try.js", "core.wasm", "game-44100.design", "chord.wav"])
def test_the_page_try_it_is_served_without_a_key_and_with_its_own_policy(served, name):
    status, answer = served.request(f"/try/{name}")
    assert status == 200
    assert answer.count("Content-Security-Policy") == 1 + (not name)  # the page has it, too
    assert "script-src 'self' 'wasm-unsafe-eval'; connect-src 'self'; style-src" in answer
    assert "frame-ancestors 'none'" in answer
    status, answer = served.request("/try")
    assert (status, "Location: /try/" in answer) == (308, True)
    assert served.request("/try/nothing.js")[0] == 404


METHODS = ["POST", "PUT", "DELETE", "OPTIONS", "TRACE", "CONNECT", "PATCH", "get", "M-SEARCH"]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("path", ["/", "/live", "/metrics"])
def test_other_methods_than_get_and_head_are_answered_by_405(served, method, path):
    lines = [f"{method} {path} HTTP/1.1", f"Host: {served.host}", *UPGRADE]
    for body in (["", ""], ["Content-Length: 13", "", '{"mute":true}']):
        status, answer = served.raw("\r\n".join([*lines, *body]).encode())
        assert status == 405
        assert "Allow: GET, HEAD" in answer
        assert "access-control" not in answer.lower()


@pytest.mark.parametrize("path", ["/", "/page.js", "/metrics", "/nothing", "/live"])
def test_head_is_answered_as_get_without_the_body_even_if_it_comes_in_pieces(served, path):
    lines = [f" {path} HTTP/1.1", f"Host: {served.host}", f"Authorization: Bearer {served.key}"]
    rest = "\r\n".join([*lines, f"Origin: http://{served.host}", *UPGRADE, "", ""]).encode()
    with served.connection() as client:
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for piece in (b"H", b"EAD", rest):
            client.sendall(piece)
        answer = b"".join(iter(lambda: client.recv(65_536), b"")).decode("latin-1")
    head, _, body = answer.partition("\r\n\r\n")
    assert body == ""
    if path == "/live":
        assert "405" in head.partition("\r\n")[0]
    else:
        assert head.partition("\r\n")[0] == served.request(path, *lines[2:])[1].partition("\r\n")[0]
        assert "Content-Length: 0" not in head


@pytest.mark.parametrize(
    "request_bytes",
    [
        *(b" GET / HTTP/1.1", b"\x00" * 64, b"GET\r\n\r\n", os.urandom(2000)),
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",  # of TLS
        b"GET / HTTP/1.1\r\nX: " + b"a" * 200_000,
    ],
    ids=range(6),
)
def test_garbage_instead_of_a_request_and_headers_without_end_are_closed(served, request_bytes):
    assert served.raw(request_bytes + b"\r\n\r\n")[0] in (0, 400, 405, 431)


@pytest.mark.parametrize(
    "sent",
    [
        *("x" * 5 * 1024, '{"id": 1, "set": {"gain_db": ' + "9" * 5_000 + "}}"),
        *("{", "[1, 2]", '"mute"', "[" * 2_000, '{"mute": true}', '{"id": "1", "mute": true}'),
        *(b"\x00\xff\xfe garbage", b'{"id": 1, "mute": true}'),
    ],
    ids=range(10),
)
def test_a_message_that_is_none_closes_the_connection(served, sent):
    with served.live() as live:
        message(live, "frame")
        live.send(sent)
        with pytest.raises(ConnectionClosed):
            everything(live)
    assert live.close_code in (1008, 1009)


def test_messages_up_to_the_limit_are_taken(daemon, served):
    with served.live() as live:
        text = json.dumps({"id": 3, "undo": True})
        live.send(text + " " * (MESSAGE_BYTES_MAX - len(text)))
        assert message(live, "answer")["answer"] == {"done": True}
    daemon.requests.clear()


def test_a_ninth_page_is_refused_with_the_reason(served):
    with ExitStack() as opened:

        def opens() -> bool:
            live = opened.enter_context(served.live())
            with suppress(ConnectionClosed):  # a page of the test before may be closing
                return bool(message(live, "key"))
            return False

        for _ in range(CLIENTS_MAX):
            wait_for(opens, "a free place")
        ninth = opened.enter_context(served.live())
        assert closing(ninth) == "8 pages are open already; close one of them"


def test_connections_without_the_key_shut_out_none_with_it_and_are_bounded(served):
    with served.live() as live, ExitStack() as held:
        message(live, "frame")
        silent = [held.enter_context(served.connection()) for _ in range(60)]
        mute = [held.enter_context(served.showing(None)) for _ in range(60)]
        for _ in range(3):
            assert served.request("/")[0] == 200
            with served.live() as other:
                message(other, "frame")
        for client in silent:
            client.settimeout(4.0)  # sooner than by the timeout
            with suppress(ConnectionResetError):
                assert client.recv(1) == b""
        for pending in mute[:-PENDING_MAX]:
            assert closing(pending) == ""
        assert message(live, "frame")["n"] > 0


def test_a_request_that_never_ends_is_closed(served):
    with served.connection() as client:
        client.sendall(b"GET / HTTP/1.1\r\nHost: ")
        client.settimeout(20.0)
        with suppress(ConnectionResetError):
            assert b"200" not in client.recv(65_536).partition(b"\r\n")[0]


def test_a_key_stays_from_run_to_run_and_a_doubtful_one_is_replaced(tmp_path):
    with RuntimeFolder({"XDG_RUNTIME_DIR": str(tmp_path)}, create=True) as folder:
        key = load_key(folder)
        assert load_key(folder) == key
        path = folder.path / KEY_NAME
        path.chmod(0o644)  # others may have read it
        second = load_key(folder)
        assert second != key
        path.write_text("short")
        assert load_key(folder) not in (key, second, "short")
        path.unlink()
        path.symlink_to("/etc/hostname")
        with pytest.raises(Exception, match="cannot keep the key"):
            load_key(folder)


def test_another_name_of_this_computer_works_where_the_network_may_connect():
    access = Access(Listen.parse("0.0.0.0:8765"), "0" * 32, NOWHERE)
    assert access.refuse_host(["192.0.2.1:8765"], "192.0.2.1") == ""
    assert access.refuse_host([f"{os.uname().nodename.lower()}:8765"], "192.0.2.1") == ""
    assert access.refuse_host(["192.0.2.1:8765"], "192.0.2.9") != ""
    assert access.refuse_origin(["http://192.0.2.1:8765"], "192.0.2.1:8765", needed=True) == ""
    access = Access(Listen.parse("[::]:8765"), "0" * 32, NOWHERE)
    assert access.refuse_host(["192.0.2.1:8765"], "::ffff:192.0.2.1") == ""
    assert access.refuse_host(["[2001:db8::1]:8765"], "2001:db8::1") == ""
    assert access.refuse_host(["192.0.2.9:8765"], "::ffff:192.0.2.1") != ""


def test_a_daemon_of_another_version_is_up_and_the_page_says_what_to_do():
    document = json.loads(to_json(STATUS)) | {"version": "0.9", "a new figure": 1}
    clients = Clients()
    clients.tell("status", {"error": "the status is not available: OSError"})
    assert b"cushion_up 0.0" in metrics_text(clients)
    clients.tell("status", document)
    text = metrics_text(clients)
    assert b"cushion_up 1.0" in text
    assert b'version="0.9"' in text
    ((_, told, tone, _),) = figures_of(document)["panels"]["health"]
    assert (told, tone) == (f"daemon 0.9, page {__version__}: restart the older one", "bad")


@pytest.mark.parametrize(
    "text", ["", "8765", "host", "a b:1", "::1:8765", "[::1]", "h:70000", "h:-1"]
)
def test_an_address_that_is_none_is_refused(text):
    with pytest.raises(UsageError, match="HOST:PORT"):
        Listen.parse(text)


def test_what_was_refused_is_told_to_nobody_but_the_one_who_asked(served):
    served.raw(b"GET /live HTTP/1.1\r\nHost: \xff\x7f\r\n\r\n")
    assert served.request("/live", "Cookie: \x7f" * 3, *UPGRADE)[0] in (0, 400, FORBIDDEN)
    assert served.stderr.count("\n") == 2  # the address, and how long it is valid
