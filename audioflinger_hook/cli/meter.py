"""The demo's live view: levels of sound, vibration and acceleration, and what is vibrating."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from audioflinger_hook.scenes import Scene
from device.units import amplitude_to_db

REFRESH_S = 1 / 15
BAR_CELLS = 40
BAR_RANGE_DB = 60.0
SILENCE_DB = -70.0
"""Peaks below this level are shown as silence."""
SPECTRUM_WINDOW_S = 0.1
SPECTRUM_BANDS_HZ = np.arange(20, 221, 5)
STEPS = " ▁▂▃▄▅▆▇█"

Block = NDArray[np.floating[Any]]


class Meter:
    """Draws while the console is a terminal, and does nothing elsewhere.

    Called by the thread that steps the chain, which has time to spare in a demo.
    """

    def __init__(self, scene: Scene, console: Console) -> None:
        self._scene = scene
        self._events = scene.events()
        self._live = Live(console=console, auto_refresh=False, transient=True)
        self._on = console.file.isatty()
        self._next_frame = 0
        self._peaks = np.zeros(3)
        self._recent = np.zeros(round(SPECTRUM_WINDOW_S * scene.samplerate))
        times_s = np.arange(self._recent.size) / scene.samplerate
        self._probe = np.exp(-2j * np.pi * SPECTRUM_BANDS_HZ[:, None] * times_s)
        self._probe *= np.hanning(self._recent.size) * (4.0 / self._recent.size)

    def __enter__(self) -> Meter:
        if self._on:
            self._live.start()
        return self

    def __exit__(self, *_error: object) -> None:
        if self._on:
            self._live.stop()

    def show(self, frames: int, audio: Block, vibration: Block, acceleration: Block) -> None:
        """Take in one step and redraw when it is time; `frames`: of the scene so far."""
        if not self._on:
            return
        peaks = [float(np.abs(block).max(initial=0.0)) for block in (audio, vibration)]
        peaks.append(float(np.abs(acceleration).max(initial=0.0)))
        self._peaks = np.maximum(self._peaks, peaks)
        newest = vibration[-self._recent.size :, 0]
        self._recent = np.concatenate((self._recent[newest.size :], newest))
        if frames >= self._next_frame:
            self._next_frame = frames + round(REFRESH_S * self._scene.samplerate)
            self._live.update(self._view(frames / self._scene.samplerate), refresh=True)
            self._peaks *= 0.6  # peaks fall back over a few redraws

    def _view(self, now_s: float) -> Group:
        playing = ", ".join(label for start, end, label in self._events if start <= now_s < end)
        sound, vibration, acceleration = self._peaks
        return Group(
            Text(f"{now_s:5.1f} of {self._scene.duration_s:.0f} s   {playing or '-'}", "bold"),
            _bar("sound", sound, _level(sound), "cyan"),
            _bar("vibration", vibration, _level(vibration), "yellow"),
            _bar("cushion", acceleration / 100.0, f"{acceleration:5.1f} m/s²", "magenta"),
            self._spectrum(),
        )

    def _spectrum(self) -> Text:
        level_db = 20.0 * np.log10(np.abs(self._probe @ self._recent) + 1e-9)
        height = np.clip(1.0 + level_db / 50.0, 0.0, 1.0) * (len(STEPS) - 1)
        bars = "".join(STEPS[round(h)] for h in height)
        return Text.assemble(f"{'felt at':>10} 20 Hz ", (bars, "yellow"), " 220 Hz")


def _bar(label: str, amplitude: float, reading: str, colour: str) -> Text:
    share = min(1.0, max(0.0, 1.0 + amplitude_to_db(amplitude) / BAR_RANGE_DB))
    filled = round(share * BAR_CELLS)
    return Text.assemble(
        f"{label:>10} ", ("█" * filled, colour), ("░" * (BAR_CELLS - filled), "dim"), f" {reading}"
    )


def _level(amplitude: float) -> str:
    level_db = amplitude_to_db(amplitude)
    # What is left of a block that rings out is nobody's sound; the bar is empty long before.
    return " silence" if level_db < SILENCE_DB else f"{round(level_db, 1) + 0.0:6.1f} dBFS"
