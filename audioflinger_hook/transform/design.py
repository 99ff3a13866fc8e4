"""The live form's fixed grid: hop, low rate and window, all counted in frames of the stream."""

from __future__ import annotations

from dataclasses import dataclass

from audioflinger_hook.transform.parameters import TransformParameters

LOW_RATE_HZ = 3_000.0
"""Rate at which oscillators run, or a little more: over six times the highest vibration frequency
allowed."""

HOPS_A_WINDOW = 2.55
"""The hop is about 18 ms: onsets do not wait for it, and a shorter one costs more."""

TICK_S = 0.002
"""Onsets are looked for so often, and vibration is computed so far ahead."""


@dataclass(frozen=True)
class LiveGrid:
    """How the live form divides time at one samplerate.

    Everything is a whole number of frames, so that no split of the input can shift it:
    `decimation` frames are one step of the low rate, `tick_steps` of those one tick, `ticks` of
    these one hop.
    """

    samplerate: int
    window_frames: int
    decimation: int
    tick_steps: int
    ticks: int

    @classmethod
    def at(cls, parameters: TransformParameters, samplerate: int) -> LiveGrid:
        """Return the grid for a samplerate in Hz."""
        window_frames = parameters.window_frames(samplerate)
        decimation = max(1, int(samplerate / LOW_RATE_HZ))
        tick_steps = max(2, round(TICK_S * samplerate / decimation))
        ticks = max(1, round(window_frames / (HOPS_A_WINDOW * decimation * tick_steps)))
        return cls(samplerate, window_frames, decimation, tick_steps, ticks)

    @property
    def steps(self) -> int:
        """Steps of the low rate in one hop."""
        return self.tick_steps * self.ticks

    @property
    def tick_frames(self) -> int:
        """Frames from one look for onsets to the next."""
        return self.decimation * self.tick_steps

    @property
    def hop_frames(self) -> int:
        """Frames from one analysis to the next."""
        return self.decimation * self.steps

    @property
    def low_rate_hz(self) -> float:
        """Steps a second."""
        return self.samplerate / self.decimation

    @property
    def hop_s(self) -> float:
        """Seconds from one analysis to the next."""
        return self.hop_frames / self.samplerate

    @property
    def hops_in_window(self) -> int:
        """Hops that together cover one window."""
        return -(-self.window_frames // self.hop_frames)
