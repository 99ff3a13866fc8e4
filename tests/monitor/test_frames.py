"""Frames: read from the native engine's memory, steady, and empty once the sound stands still."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from websockets.sync.client import ClientConnection

from audioflinger_hook.daemon.native.page import Page as NativePage
from audioflinger_hook.service.runtime_folder import FOLDER_NAME
from tests.monitor.stand_in import Settings, daemon_socket, message, page
from tests.servers.listening import wait_for


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
def native(tmp_path: Path) -> Iterator[NativePage]:
    (tmp_path / FOLDER_NAME).mkdir(mode=0o700)
    opened = NativePage(tmp_path / FOLDER_NAME / "memory", 2, 1, [0])
    yield opened
    opened.close()


def play(native: NativePage, hz: float) -> None:
    """Write as the plugin does at the end of a buffer."""
    written = native._page.readings
    written.partials_count = 1
    written.partials[0][:] = (hz, 100.0, 0.25)
    written.sequence += 2
    written.sound[1].peak, written.sound[1].mean_square = 0.5, 0.125
    written.frames += 512


def partials(live: ClientConnection) -> Any:
    return message(live, "frame")["frame"]["partials"]


def test_frames_show_the_memory_of_the_native_engine_while_it_plays(
    tmp_path: Path, native: NativePage
) -> None:
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
        native._page.readings.frames += 512  # sound again, and nothing found in it yet
        assert partials(live) == []
        wait_for(lambda: shows(330.0), "the next partial")


def test_the_daemon_makes_few_frames_for_a_client_that_reads_its_memory(
    tmp_path: Path, native: NativePage
) -> None:
    daemon = Native(name="memory", channels=2, actuators=1)
    with daemon_socket(tmp_path, daemon), page(tmp_path) as served, served.live() as live:
        message(live, "frame")
        before = daemon.frames
        for _ in range(60):
            message(live, "frame")
        # Four a second: of two seconds, and some more on a busy machine.
        assert daemon.frames - before < 30


@pytest.mark.parametrize(
    "where",
    [
        {"name": "../memory", "channels": 2, "actuators": 1},
        {"name": "text", "channels": 2, "actuators": 1},
        {"name": "link", "channels": 2, "actuators": 1},
        {"name": "none", "channels": 2, "actuators": 1},
        {"name": "memory", "channels": 9, "actuators": 1},
        {"name": "memory", "channels": 2, "actuators": 1 << 40},
        {"name": "memory", "channels": "2", "actuators": 1},
        {"name": "memory", "channels": 2.0, "actuators": 1},
        {"name": 5, "channels": 2, "actuators": 1},
        {},
    ],
    ids=str,
)
def test_memory_that_is_none_is_not_read(
    tmp_path: Path, native: NativePage, where: dict[str, Any]
) -> None:
    folder = tmp_path / FOLDER_NAME
    (tmp_path / "memory").write_bytes(native.path.read_bytes())
    (folder / "text").write_text("no page")
    (folder / "link").symlink_to(tmp_path / "memory")
    with daemon_socket(tmp_path, Native(**where)), page(tmp_path) as served, served.live() as live:
        for _ in range(5):
            play(native, 440.0)
            frame = message(live, "frame")["frame"]
            assert (frame["sound"], frame["vibration"], frame["partials"]) == ([], [], [])
