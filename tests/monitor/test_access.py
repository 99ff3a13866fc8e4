"""Nobody sees or changes anything who was not given the token, and no other page may try."""

import json
import os
import re
import stat
from contextlib import ExitStack, suppress

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from audioflinger_hook import __version__
from audioflinger_hook.monitor.access import TOKEN_NAME, Access, Listen, load_token
from audioflinger_hook.monitor.clients import CLIENTS_MAX, Clients
from audioflinger_hook.monitor.figures import figures_of, metrics_text
from audioflinger_hook.monitor.server import CONNECTIONS_MAX, FILES, MESSAGE_BYTES_MAX
from audioflinger_hook.service.json_codec import to_json
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from device.errors import UsageError
from tests.monitor.stand_in import STATUS, Page, ask, daemon_socket, everything, message, page
from tests.servers.listening import wait_for

FORBIDDEN = 403
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


def check_refused(served: Page, path: str, *headers: str, host: str | None = None) -> None:
    status, answer = served.request(path, *headers, host=host)
    assert status == FORBIDDEN
    assert served.token not in answer
    assert "Set-Cookie" not in answer


@pytest.mark.parametrize(
    "host",
    ["evil.example", "evil.example:8765", "", "127.0.0.1", "localhost", "127.0.0.1:1", "[::1"],
)
@pytest.mark.parametrize("path", ["/", "/live", "/metrics"])
def test_a_foreign_host_is_refused(served, host, path):
    check_refused(served, path, f"Cookie: {served.cookie}", *UPGRADE, host=host)
    check_refused(served, path, f"Cookie: {served.cookie}", "Host: evil.example")


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1", "https://{host}", "file://"]
)
def test_a_foreign_origin_is_refused_even_with_the_cookie_and_a_missing_one_as_well(served, origin):
    cookie, foreign = f"Cookie: {served.cookie}", origin.format(host=served.host)
    for path in ("/", "/live", "/metrics", "/session"):
        check_refused(served, path, f"Origin: {foreign}", cookie, *UPGRADE)
    with pytest.raises(InvalidStatus, match="403"):
        served.live(Origin=foreign)
    check_refused(served, "/live", cookie, *UPGRADE)


@pytest.mark.parametrize(
    "cookie", ["", "cushion=1", "{name}=", "{name}={wrong}", "{right}; {right}"]
)
def test_without_the_token_or_with_a_wrong_one_nothing_live_is_told(served, cookie):
    given = cookie.format(name=f"cushion_{served.port}", wrong="0" * 32, right=served.cookie)
    for path in ("/live", "/metrics", "/session"):
        check_refused(served, path, f"Origin: http://{served.host}", f"Cookie: {given}", *UPGRADE)
    with pytest.raises(InvalidStatus, match="403"):
        served.live(Cookie=given)


@pytest.mark.parametrize("given", ["Bearer", "Bearer " + "0" * 32, "Basic {token}", "{token}", "é"])
def test_a_wrong_bearer_gets_no_cookie_nor_do_two(served, given):
    check_refused(served, "/session", f"Authorization: {given.format(token=served.token)}")
    check_refused(served, "/session", *[f"Authorization: Bearer {served.token}"] * 2)


def test_the_token_becomes_a_cookie_that_no_script_and_no_other_site_can_use(served, base):
    status, answer = served.request("/session", f"Authorization: Bearer {served.token}")
    assert status == 204
    (cookie,) = [line for line in answer.split("\r\n") if line.startswith("Set-Cookie:")]
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} <= set(cookie.split("; "))
    assert served.cookie in cookie
    path = base / "cushion" / TOKEN_NAME
    assert (stat.S_IMODE(path.stat().st_mode), path.read_text()) == (0o600, served.token)
    assert len(bytes.fromhex(served.token)) == 16  # 128 bits


@pytest.mark.parametrize(
    ("path", "status"),
    [
        *((f"/{up}/{up}/etc/passwd", FORBIDDEN) for up in ("..", "..%2f", "%2e%2e", "..\\\\")),
        *((path, FORBIDDEN) for path in ("//etc/passwd", "/static/../../server.py")),
        *((f"/{name}", 404) for name in ("page.token", "server.py", "config.toml", "index.html")),
    ],
)
def test_only_the_table_is_served(served, path, status):
    found, answer = served.request(path, f"Cookie: {served.cookie}")
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
    assert not re.search("https?://", body.replace('xmlns="http://www.w3.org/2000/svg"', ""))
    assert not ("html" in kind and re.search("<style| style=| onclick=", body))


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "TRACE", "CONNECT"])
def test_other_methods_do_nothing(served, method):
    lines = [f"{method} /live HTTP/1.1", f"Host: {served.host}", f"Cookie: {served.cookie}"]
    body = ["Content-Length: 13", "", '{"mute":true}']
    status, answer = served.raw("\r\n".join([*lines, *body]).encode())
    assert status not in (200, 101, 204)
    assert "access-control" not in answer.lower()


@pytest.mark.parametrize(
    "request_bytes",
    [
        *(b"\x00" * 64, b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03", b"GET\r\n\r\n"),
        *(os.urandom(2000), b"GET / HTTP/1.1\r\nX: " + b"a" * 200_000),
    ],
    ids=range(5),
)
def test_garbage_instead_of_a_request_and_headers_without_end_are_closed(served, request_bytes):
    assert served.raw(request_bytes + b"\r\n\r\n")[0] in (0, 400, 431)


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
            with suppress(InvalidStatus):  # a page of the test before may be closing
                opened.enter_context(served.live())
                return True
            return False

        for _ in range(CLIENTS_MAX):
            wait_for(opens, "a free place")
        with pytest.raises(InvalidStatus, match="503"):
            served.live()


def test_a_hundred_connections_leave_the_page_as_it_was(served):
    with served.live() as live:
        message(live, "frame")
        held = [served.connection() for _ in range(100)]
        try:
            for client in held[CONNECTIONS_MAX:]:
                client.settimeout(20.0)
                with suppress(ConnectionResetError):
                    assert client.recv(1) == b""
            assert message(live, "frame")["n"] > 0
        finally:
            for client in held:
                client.close()


def test_a_request_that_never_ends_is_closed(served):
    with served.connection() as client:
        client.sendall(b"GET / HTTP/1.1\r\nHost: ")
        client.settimeout(20.0)
        with suppress(ConnectionResetError):
            assert b"200" not in client.recv(65_536).partition(b"\r\n")[0]


def test_a_token_stays_from_run_to_run_and_a_doubtful_one_is_replaced(tmp_path):
    with RuntimeFolder({"XDG_RUNTIME_DIR": str(tmp_path)}, create=True) as folder:
        token = load_token(folder)
        assert load_token(folder) == token
        path = folder.path / TOKEN_NAME
        path.chmod(0o644)  # others may have read it
        second = load_token(folder)
        assert second != token
        path.write_text("short")
        assert load_token(folder) not in (token, second, "short")
        path.unlink()
        path.symlink_to("/etc/hostname")
        with pytest.raises(Exception, match="cannot keep the token"):
            load_token(folder)


def test_another_name_of_this_computer_works_where_the_network_may_connect():
    access = Access(Listen.parse("0.0.0.0:8765"), "0" * 32)
    assert access.refuse_host(["192.0.2.1:8765"], "192.0.2.1") == ""
    assert access.refuse_host([f"{os.uname().nodename.lower()}:8765"], "192.0.2.1") == ""
    assert access.refuse_host(["192.0.2.1:8765"], "192.0.2.9") != ""
    assert access.refuse_origin(["http://192.0.2.1:8765"], "192.0.2.1:8765", needed=True) == ""
    access = Access(Listen.parse("[::]:8765"), "0" * 32)
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
    assert served.stderr.count("\n") == 1  # the address
