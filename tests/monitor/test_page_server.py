import json
import shutil
import signal
import socket
import subprocess
import sys
import threading
from typing import Any
from unittest.mock import ANY

import pytest
from websockets.sync.client import ClientConnection

from audioflinger_hook.daemon.native.page import Page as NativePage
from audioflinger_hook.service.runtime_folder import FOLDER_NAME
from tests.monitor import stand_in
from tests.monitor.stand_in import LIMIT_S, Page, Settings, daemon_socket, message, odd_daemon, page
from tests.servers.listening import need, wait_for
from tests.support.commands import RUN, call
from tests.support.costs import resident_bytes


def test_a_browser_is_told_everything_and_the_last_of_its_values_wins(tmp_path):
    with daemon_socket(tmp_path) as daemon, page(tmp_path) as served, served.live() as live:
        assert message(live, "status")["status"]["engine"] == "python"
        shown = message(live, "figures")["figures"]
        assert ["samples", "0 limited, 0 replaced", "", ANY] in shown["panels"]["health"]
        assert shown["panels"]["rig"] == []
        assert [name for name, _, _ in shown["parts"]][:3] == ["tap", "transform", "driving"]
        assert message(live, "frame")["frame"]["partials"] == [[440, 100, 0.5]]
        assert daemon.page == served.base
        for number in range(2000):
            live.send(json.dumps({"id": number, "set": {"gain_db": -number}}))
        wait_for(lambda: message(live, "answer")["id"] == 1999, "the last answer")
        values = [asked["set"]["gain_db"] for asked in daemon.requests]
        assert values == sorted(set(values), reverse=True)
        assert (values[-1], len(values) < 200) == (-1999, True)


def test_a_browser_that_acknowledges_nothing_gets_few_frames_and_then_the_newest(tmp_path):
    with daemon_socket(tmp_path) as daemon, page(tmp_path, "--rate=60") as served:
        with served.live() as live:
            frames: list[Any] = []
            while len(frames) < 4:
                found = json.loads(live.recv(timeout=LIMIT_S))
                frames += [found] if "frame" in found else []
            before = daemon.frames
            wait_for(lambda: daemon.frames > before + 60, "frames", LIMIT_S)
            live.send(json.dumps({"ack": 4}))
            found = message(live, "frame")
            assert found["n"] == 5
            assert found["overwritten"] >= 40
        status, metrics = served.request("/metrics", f"Authorization: Bearer {served.key}")
        assert status == 200
        assert "cushion_page_overwritten_frames_total" in metrics


def test_without_a_daemon_the_page_says_so_and_finds_the_next_one(tmp_path):
    with page(tmp_path) as served, served.live() as live:
        link = message(live, "link")["link"]
        assert not link["connected"]
        assert "no daemon is running; start one with `cushion run`" in link["text"]
        assert "no daemon is running" in stand_in.ask(live, 1, mute=True)["error"]
        with_key = f"Authorization: Bearer {served.key}"
        assert "cushion_up 0.0" in served.request("/metrics", with_key)[1]
        for _ in range(2):
            with daemon_socket(tmp_path):
                assert message(live, "status")["status"]["state"] == "running"
            assert not message(live, "link")["link"]["connected"]


OLD = b'{"error": "the request is not known; allowed: {\\"ask\\": \\"status\\"}"}\n'
NEW = b'{"error": "this daemon (version 9.0) speaks protocol 9; restart the page"}\n'
HELLO = b'{"hello": {"protocol": 1, "version": "0.1.0"}}\n'


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (OLD, "the daemon is of another version than the page: the request is not known"),
        (NEW, "another version than the page: this daemon (version 9.0) speaks protocol 9"),
        (b"[]\n", "the daemon sent an invalid message"),
        (b"\xff\xfe\n", "the daemon sent an invalid message"),
        (b"x" * (1 << 19), "the daemon sends lines over 262144 bytes"),
        (b"", "the daemon has ended; waiting for the next one"),
    ],
)
def test_a_daemon_that_is_not_understood_is_told_in_words(tmp_path, answer, words):
    with (
        odd_daemon(tmp_path, lambda client: client.sendall(answer)),
        page(tmp_path) as served,
        served.live() as live,
    ):
        link = message(live, "link")["link"]
        assert words in link["text"]
        assert not link["connected"]
        assert served.request("/")[0] == 200


def test_a_daemon_that_stalls_is_left_and_asked_again(tmp_path, monkeypatch):
    gone = threading.Event()

    def stall(client: socket.socket) -> None:
        client.sendall(HELLO)
        gone.wait(LIMIT_S)

    hasty = "from audioflinger_hook.monitor import daemon_link\ndaemon_link.SILENT_S = 1.0\n"
    monkeypatch.setattr("tools.live_page.CUSHION", (sys.executable, "-c", hasty + RUN))
    with odd_daemon(tmp_path, stall), page(tmp_path) as served, served.live() as live:
        assert message(live, "link")["link"]["connected"]
        assert "the daemon has sent nothing for 1 s" in message(live, "link")["link"]["text"]
        gone.set()


def test_a_daemon_that_floods_costs_no_memory(tmp_path):
    frame = b'{"frame": {"sound": [], "vibration": [], "partials": [], "missed": 0}}\n' * 100

    def flood(client: socket.socket) -> None:
        client.sendall(HELLO)
        while True:
            client.sendall(frame)

    with odd_daemon(tmp_path, flood), page(tmp_path) as served, served.live() as live:
        message(live, "frame")
        resident = resident_bytes(served.process.pid)
        for _ in range(300):
            message(live, "frame")
        # a backlog would be 100 MB
        assert resident_bytes(served.process.pid) < resident + 4_000_000
        assert served.request("/")[0] == 200


def test_a_port_in_use_is_one_line_and_exit_code_2(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        second = Page(tmp_path, "--listen", f"127.0.0.1:{port}")
        assert second.process.wait(LIMIT_S) == 2
        second.close()
        assert second.stderr.count("\n") == 1
        assert f"127.0.0.1:{port} is in use" in second.stderr
        assert f"--listen 127.0.0.1:{port + 1}" in second.stderr


def test_a_page_that_is_served_already_is_shown_and_an_ended_one_served_anew(tmp_path, monkeypatch):
    shown, browser = tmp_path / "shown", tmp_path / "browser"
    browser.write_text(f'#!/bin/sh\ncp "${{1#file://}}" {shown}\n')
    browser.chmod(0o700)
    monkeypatch.setenv("BROWSER", f"{browser} %s")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with page(tmp_path, "--listen", f"127.0.0.1:{port}") as served:
        second = Page(tmp_path, "--listen", served.host, "--open")
        assert second.process.wait(LIMIT_S) == 0
        second.close()
        assert (second.base, second.address in shown.read_text()) == (served.base, True)
        assert second.address != served.address
        served.process.kill()
        served.process.wait()
        third = Page(tmp_path, "--listen", served.host)
        assert (third.request("/")[0], third.close()) == (200, 130)


def test_a_trial_ends_when_the_browser_that_plays_it_disappears(tmp_path):
    tries = {"sync": {"try_ms": 120}}
    with daemon_socket(tmp_path) as daemon, page(tmp_path) as served:
        with served.live() as stays, served.live() as goes:
            assert stand_in.ask(stays, 1, mute=True) == {"done": True}
            assert stand_in.ask(goes, 1, **tries) == {"done": True}
            goes.socket.shutdown(socket.SHUT_RDWR)
            wait_for(lambda: len(daemon.requests) == 3, "end of the trial", LIMIT_S)
            assert daemon.requests[-1]["sync"] == {"try_ms": None}
            assert stand_in.ask(stays, 2, **tries) == {"done": True}
            assert stand_in.ask(stays, 3, sync={"store_ms": 100}) == {"done": True}
        with served.live() as other:
            assert stand_in.ask(other, 1, mute=False) == {"done": True}
        assert [asked.get("sync") for asked in daemon.requests[-2:]] == [{"store_ms": 100}, None]


def test_a_page_for_the_network_warns_and_still_needs_the_key(tmp_path):
    with page(tmp_path, "--listen", "0.0.0.0:0") as served:
        wait_for(lambda: served.stderr.count("\n") == 3, "warning", LIMIT_S)
        assert "0.0.0.0 is open to the network, and HTTP is not encrypted" in served.stderr
        own = f"127.0.0.1:{served.port}"
        assert served.request("/", host=own)[0] == 200
        assert served.request("/metrics", host=own)[0] == 403
        assert served.request("/", host=f"evil.example:{served.port}")[0] == 403


def test_a_page_ends_on_a_signal_keeps_its_key_and_says_where_no_browser_opens(
    tmp_path, monkeypatch
):
    with page(tmp_path) as first:
        key = first.key
    assert first.process.returncode == 130
    assert first.stderr.endswith("cushion: interrupted\n")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    with page(tmp_path, "--open") as second:
        assert second.key == key
        second.process.send_signal(signal.SIGINT)
        assert second.process.wait(LIMIT_S) == 130
    assert "no browser could be started; open this address in one" in second.stderr


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--listen", "nowhere"], "is no address; allowed: HOST:PORT"),
        (["--listen", "192.0.2.77:8765"], "cannot listen on 192.0.2.77:8765"),
        (["--rate", "0"], "rate=0 is out of range; allowed: 1 to 60 Hz"),
        (["--rate", "61"], "rate=61 is out of range; allowed: 1 to 60 Hz"),
    ],
)
def test_wrong_options_say_what_is_allowed(tmp_path, monkeypatch, options, words):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    done = call("monitor", *options)
    assert done.code == 2
    assert words in done.stderr


def metrics_of(served: Page) -> str:
    status, answer = served.request("/metrics", f"Authorization: Bearer {served.key}")
    assert status == 200
    return answer.partition("\r\n\r\n")[2]


def test_the_metrics_are_those_of_the_status_in_base_units(tmp_path):
    with daemon_socket(tmp_path), page(tmp_path) as served, served.live() as live:
        message(live, "status")
        lines = metrics_of(served).splitlines()
    for line in (
        *("cushion_up 1.0", 'cushion_state{state="running"} 1.0'),
        *('cushion_state{state="idle"} 0.0', 'cushion_engine{engine="python"} 1.0'),
        *('cushion_hop_seconds_bucket{le="0.0001"} 1.0', "cushion_hop_seconds_count 6.0"),
        *("cushion_late_callbacks_total 1.0", 'cushion_recoveries_total{cause="device-lost"} 0.0'),
        *("cushion_clock_ratio 1.0", 'cushion_delay_part_seconds{part="delay_line"} 0.003'),
        *("cushion_delay_seconds 0.003", 'cushion_xruns_total{stream="output"} 0.0'),
        f'cushion_level_peak_ratio{{signal="vibration"}} {10.0 ** (-12.0 / 20.0)}',
        "cushion_muted 0.0",
    ):
        assert line in lines, line


@pytest.mark.servers
def test_promtool_finds_no_fault_with_the_metrics(tmp_path):
    need([] if shutil.which("promtool") else ["promtool"])
    with daemon_socket(tmp_path), page(tmp_path) as served, served.live() as live:
        message(live, "status")
        told: Any = {"input": metrics_of(served), "text": True, "capture_output": True}
        checked = subprocess.run(["promtool", "check", "metrics"], **told)
    assert (checked.returncode, checked.stderr, checked.stdout) == (0, "", "")


class Native(Settings):
    """A daemon whose native engine plays: its frames name the memory."""

    def __init__(self, **where: Any) -> None:
        super().__init__()
        self.where = where

    def frame(self, missed: int, *, in_memory: bool) -> tuple[bytes, bool]:
        assert in_memory
        self.frames += 1
        frame = {"state": "running", "level": 1.0, "memory": self.where, "missed": missed}
        return json.dumps({"frame": frame}).encode() + b"\n", True


@pytest.fixture
def native(tmp_path):
    (tmp_path / FOLDER_NAME).mkdir(mode=0o700)
    opened = NativePage(tmp_path / FOLDER_NAME / "memory", 2, 1, [0])
    yield opened
    opened.close()


def play(native: NativePage, hz: float) -> None:
    written = native.readings
    written.partials_count = 1
    written.partials[0][:] = (hz, 100.0, 0.25)
    written.sequence += 2
    written.sound[1].peak, written.sound[1].mean_square = 0.5, 0.125
    written.frames += 512


def partials(live: ClientConnection) -> Any:
    return message(live, "frame")["frame"]["partials"]


def test_frames_show_the_native_engines_memory_and_the_daemon_makes_few(tmp_path, native):
    daemon = Native(name="memory", channels=2, actuators=1)
    with daemon_socket(tmp_path, daemon), page(tmp_path) as served, served.live() as live:

        def shows(hz: float) -> bool:
            play(native, hz)
            return bool(partials(live) == [[hz, 100.0, 0.25]])

        wait_for(lambda: shows(440.0), "the partial")
        play(native, 440.0)
        frame = message(live, "frame")["frame"]
        assert (frame["sound"], frame["vibration"]) == ([[0, 0], [0.5, 0.125]], [[0, 0]])
        wait_for(lambda: partials(live) == [], "silence once nothing is processed")
        native.readings.frames += 512  # sound again, and nothing found in it yet
        assert partials(live) == []
        wait_for(lambda: shows(330.0), "the next partial")
        before = daemon.frames
        for _ in range(60):
            message(live, "frame")
        # Four a second: of two seconds, and some more on a busy machine.
        assert daemon.frames - before < 30


@pytest.mark.parametrize(
    "wrong",
    [
        *({"name": name} for name in ("../memory", "text", "link", "none", 5)),
        *(*({"channels": channels} for channels in (9, "2", 2.0)), {"actuators": 1 << 40}, None),
    ],
    ids=str,
)
def test_memory_that_is_none_is_not_read(tmp_path, native, wrong):
    folder = tmp_path / FOLDER_NAME
    (tmp_path / "memory").write_bytes(native.path.read_bytes())
    (folder / "text").write_text("no page")
    (folder / "link").symlink_to(tmp_path / "memory")
    where = {} if wrong is None else {"name": "memory", "channels": 2, "actuators": 1} | wrong
    with daemon_socket(tmp_path, Native(**where)), page(tmp_path) as served, served.live() as live:
        for _ in range(5):
            play(native, 440.0)
            frame = message(live, "frame")["frame"]
            assert (frame["sound"], frame["vibration"], frame["partials"]) == ([], [], [])
