import json
import socket
import threading
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

import pytest

from audioflinger_hook.service.status_server import CLIENTS_MAX, NAME, PROTOCOL, WATCHERS_MAX
from tests.monitor.stand_in import LIMIT_S, daemon_socket
from tests.servers.listening import wait_for


@pytest.fixture
def live(tmp_path):
    with daemon_socket(tmp_path) as found:
        yield found


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "cushion"


class Client:
    def __init__(self, folder: Path, **request: Any) -> None:
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(LIMIT_S)
        try:
            self.socket.connect(str(folder / NAME))
        except OSError:
            self.socket.close()
            raise
        self.lines = self.socket.makefile("rb")
        self.ask(**request)

    def ask(self, **request: Any) -> None:
        self.socket.sendall(json.dumps({"protocol": PROTOCOL, **request}).encode() + b"\n")

    def next(self) -> Any:
        return json.loads(self.lines.readline())

    def next_with(self, kind: str) -> Any:
        while kind not in (found := self.next()):
            pass
        return found[kind]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.lines.close()
        self.socket.close()


def test_a_client_that_watches_gets_everything_and_without_one_nothing_is_computed(live, folder):
    with Client(folder, ask="watch", rate_hz=60) as client:
        assert client.next()["hello"]["protocol"] == PROTOCOL
        assert (client.next()["frame"]["missed"], client.next()["settings"]["undo"]) == (0, 0)
        assert client.next_with("status")["state"] == "running"

    def is_over() -> bool:
        before = live.frames
        threading.Event().wait(0.2)  # five frames
        return bool(live.frames == before)

    wait_for(is_over, "end of the frames", LIMIT_S)


OUT = "rate_hz is out of range; allowed: 1 to 60"
OTHER = f"speaks protocol {PROTOCOL}"


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        *(({"ask": "watch", "protocol": number}, OTHER) for number in (0, 2, "1", None)),
        *(({"ask": "control", "mute": True, "protocol": n}, OTHER) for n in (0, 2, "1", None)),
        *(({"ask": "watch", "rate_hz": hz}, OUT) for hz in (0, 0.5, 61, -1, "30", None, True, 1e9)),
        ({"ask": "control", "set": {"gain_db": "x" * 4096}}, "longer than 4096 bytes"),
    ],
    ids=range(17),
)
def test_another_protocol_wrong_rates_and_long_requests_are_refused(live, folder, asked, words):
    with Client(folder, **asked) as client:
        assert words in client.next()["error"]
    assert live.requests == []


def test_some_threads_are_left_for_the_status(live, folder):
    with ExitStack() as stack:
        for _ in range(WATCHERS_MAX):
            client = stack.enter_context(Client(folder, ask="watch"))
            client.next_with("frame")
        with Client(folder, ask="watch") as another:
            assert "clients watch already" in another.next()["error"]
        with Client(folder, ask="status", protocol=None) as client:
            assert "error" in client.next()
        with Client(folder, ask="control", mute=True) as client:
            assert client.next() == {"done": True}


def test_a_client_that_does_not_read_misses_frames_and_then_gets_the_newest(live, folder):
    with Client(folder, ask="watch", rate_hz=60) as client:
        client.next_with("frame")
        wait_for(lambda: live.frames > 20, "frames", LIMIT_S)
        stalled = 0

        def has_stalled():
            nonlocal stalled
            before = live.frames
            threading.Event().wait(0.1)
            stalled += live.frames == before
            return stalled >= 3

        wait_for(has_stalled, "full buffer", LIMIT_S)
        made, frames = live.frames, 0
        while client.next_with("frame")["missed"] == 0:
            frames += 1
        # What was in the kernel is some tenths of a second, not the whole time.
        assert frames < min(120, made + 1)


def test_a_frame_that_cannot_be_made_costs_no_thread(live, folder, monkeypatch):
    def fail(_missed: int, *, in_memory: bool) -> tuple[bytes, bool]:
        raise AttributeError("the engine has ended")

    with monkeypatch.context() as broken:
        broken.setattr(live, "frame", fail)
        for _ in range(CLIENTS_MAX + 1):
            with Client(folder, ask="watch") as client:
                assert client.next()["hello"]
                assert "the engine has ended" in client.next()["error"]
                assert client.lines.readline() == b""
    with Client(folder, ask="watch") as client:
        assert client.next_with("frame")["state"] == "running"
