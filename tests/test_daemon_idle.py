"""Silence passes by the chain after a while, and the sound after it is felt as ever."""

from __future__ import annotations

import math

import numpy as np
import pytest

from audioflinger_hook.daemon import engine as engine_module
from audioflinger_hook.daemon.engine import IDLE_AFTER_S, Clocks, Engine
from audioflinger_hook.settings import Settings
from audioflinger_hook.transform.grid import LiveGrid
from device.units import Float32Array

RATE_HZ = 48_000
BLOCK = LiveGrid.at(Settings().parameters, RATE_HZ).hop_frames
"""Blocks of whole hops: what is skipped does not move the hops of what follows."""


def blocks_of(seconds: float) -> int:
    return math.ceil(seconds * RATE_HZ / BLOCK)


def vibrations(
    idle_after_s: float, loud: Float32Array, silent_s: float, monkeypatch: pytest.MonkeyPatch
) -> tuple[Engine, Float32Array]:
    """The engine, and all that went into its delay line: sound, silence and sound again."""
    monkeypatch.setattr(engine_module, "IDLE_AFTER_S", idle_after_s)
    engine = Engine(RATE_HZ, 2, RATE_HZ, clocks=Clocks(lambda: 0.0, lambda: 0.0))
    written: list[Float32Array] = []
    monkeypatch.setattr(
        engine.delay_line, "write", lambda frames, now_s: written.append(np.array(frames))
    )
    silence = np.zeros((BLOCK, 2), np.float32)
    buffers = [*loud, *[silence] * blocks_of(silent_s), *loud]
    for number, buffer in enumerate(buffers):
        engine.on_frames(buffer, number * BLOCK / RATE_HZ)
    return engine, np.concatenate(written)


def test_skipped_silence_loses_nothing_of_the_sound_after_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    count = blocks_of(1.0)
    times_s = np.arange(count * BLOCK) / RATE_HZ
    wave = (0.3 * np.sin(2.0 * np.pi * 110.0 * times_s)).astype(np.float32)
    loud = np.column_stack([wave, wave]).reshape(count, BLOCK, 2)
    silent_s = IDLE_AFTER_S + 2.0
    treated, wanted = vibrations(math.inf, loud, silent_s, monkeypatch)
    idle, got = vibrations(IDLE_AFTER_S, loud, silent_s, monkeypatch)
    assert treated.skipped == 0
    assert idle.skipped > RATE_HZ
    assert len(got) == len(wanted) == idle.frames == treated.frames
    assert np.abs(wanted[-BLOCK:]).max() > 0.1
    np.testing.assert_allclose(got, wanted, rtol=0.0, atol=1e-5)
