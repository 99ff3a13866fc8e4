"""The Python engine's memory for a live page: exact, written while watched, a file of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon.engine import Clocks, Engine
from audioflinger_hook.daemon.live_memory import WRITES_LEFT, live_memory
from audioflinger_hook.sources import PushTap, TapClient
from device.drive import ActuatorSettings

RATE_HZ = 48_000
BLOCK = 1024  # longer than the time between two writes


def engine_with(folder: Path | None, channels: int = 2, actuators: int = 2) -> Engine:
    settings = Settings(actuators=tuple(ActuatorSettings((number,)) for number in range(actuators)))
    clocks = Clocks(lambda: 0.0, lambda: 0.0)
    engine = Engine(TapClient(PushTap(RATE_HZ, channels)), RATE_HZ, settings, clocks=clocks)
    engine.live = live_memory(folder, RATE_HZ, channels, len(engine.driven_meters))
    return engine


def play(engine: Engine, blocks: int) -> None:
    tap = engine._client._tap  # type: ignore[attr-defined]
    for _ in range(blocks):
        number = engine.buffers
        seconds = (number * BLOCK + np.arange(BLOCK)) / RATE_HZ
        tone = 0.3 * np.sin(2.0 * np.pi * 440.0 * seconds)
        tap.push(np.outer(tone, 1.0 / (1.0 + np.arange(engine.channels))).astype(np.float32))
        assert engine.advance(number * BLOCK / RATE_HZ)


@pytest.mark.parametrize("actuators", [0, 2])
def test_a_watched_page_reads_what_the_engine_measured(tmp_path: Path, actuators: int) -> None:
    engine = engine_with(tmp_path, actuators=actuators)
    assert engine.live is not None
    engine.live.watch()
    play(engine, 48)
    (channels, driven, partials), numbers = engine.live.page.reader.shown()
    sound = engine.sound.meter.channel_readings()
    vibration = [meter.reading() for meter in engine.driven_meters]
    principal = engine.framework.principal
    assert (channels, driven, partials) == (2, max(1, actuators), len(principal))
    assert partials > 0
    expected = [value for group in (*sound, *vibration, *principal) for value in group]
    assert numbers == pytest.approx(expected)
    assert engine.live.page.frames == engine.frames


def test_nothing_is_written_while_nobody_watches(tmp_path: Path) -> None:
    engine = engine_with(tmp_path)
    assert engine.live is not None
    play(engine, 8)
    assert engine.live.page.frames == 0
    engine.live.watch()
    play(engine, 4 * WRITES_LEFT)
    written = engine.live.page.frames
    assert 0 < written < engine.frames
    play(engine, 8)
    assert engine.live.page.frames == written


def test_each_engine_has_a_file_of_its_own_and_old_ones_are_removed(tmp_path: Path) -> None:
    (tmp_path / "python-99.page").touch()
    first, second = engine_with(tmp_path), engine_with(tmp_path)
    assert first.live is not None
    assert second.live is not None
    assert first.live.page.path != second.live.page.path
    assert list(tmp_path.iterdir()) == [second.live.page.path]
    first.live.close()
    second.live.close()
    second.live.close()
    assert not list(tmp_path.iterdir())


def test_what_the_file_cannot_hold_is_left_to_the_socket(tmp_path: Path) -> None:
    assert engine_with(tmp_path, channels=9).live is None
    assert engine_with(None).live is None
    assert engine_with(tmp_path / "none").live is None
