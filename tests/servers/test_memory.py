"""How much memory the daemon holds with its native engine, at first and after changes."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.servers.conftest import started
from tests.servers.daemons import Daemon, running
from tests.servers.listening import noise, playing
from tools.live_latency.usage import held_by_family
from tools.sound_server import SoundServer
from tools.usage import CARE

pytestmark = pytest.mark.servers

MOST_MB, BESIDE_MB = 70.0, 8.0
PLAYED_S = 5.0
"""It does not grow after that: tools/usage.py prints the same after ten minutes."""


@pytest.fixture
def pipewire(monkeypatch: pytest.MonkeyPatch) -> Iterator[SoundServer]:
    yield from started("pipewire", monkeypatch)


def change(daemon: Daemon, config: Path, lines: str) -> None:
    """Let it read other settings, and wait until a chain with them plays."""
    before = daemon.wait_ready().engine_pid
    config.write_text(CARE + lines)
    daemon.process.send_signal(signal.SIGHUP)
    daemon.wait(lambda status: status.engine_pid not in (0, before), f"a chain with {lines}")


def check_memory(daemon: Daemon) -> None:
    """Daemon and native engine hold at most MOST_MB, and the programs beside them little."""
    time.sleep(PLAYED_S)
    held = dict(held_by_family(daemon.process.pid).values())
    print(held)
    own = held.pop("python") + held.pop("pipewire")
    assert own <= MOST_MB
    assert sum(held.values()) <= BESIDE_MB  # pw-cli, pw-dump and, now and then, pw-top


def test_daemon_and_native_engine_hold_70_mb_at_most(pipewire: SoundServer, tmp_path: Path) -> None:
    config = tmp_path / "care.toml"
    config.write_text(CARE)
    with (
        playing(pipewire, "desktop", noise(60.0)),
        running(pipewire, "--config", str(config), engine="native") as daemon,
    ):
        check_memory(daemon)
        for lines in ('profile = "game"\n', 'rig = "consumer"\n', 'profile = "music"\n'):
            change(daemon, config, lines)
            check_memory(daemon)
