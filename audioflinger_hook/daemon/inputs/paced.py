"""A file, a capture or a scene, played into the mix as if it were sounding now."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from audioflinger_hook.daemon.capture_queue import Feed
from audioflinger_hook.daemon.engine import Engine
from audioflinger_hook.daemon.pacing import FrameTime, Pacer
from audioflinger_hook.sources import FileTap, Tap, TapAddress, open_tap
from device.clock import DelayState
from device.server import PulseConnection, ServerSnapshot
from device.units import Float32Array

BLOCK_FRAMES = 256
"""Of a file's buffers; a capture's are as they were captured."""

LEAD_IN_S = 0.2
"""Silence before the sound, until the delay line plays: else the beginning would not be felt."""

LEAD_IN_MAX_S = 5.0
"""The longest lead-in: where nothing reads the delay line by then, the sound begins anyway."""

RUN_OUT_S = 0.3
"""Silence behind the last vibration, for what lies in the buffers of a sound server."""

PLAYING = (DelayState.SETTLING, DelayState.LOCKED)


class PacedInput:
    """Sound that is at hand, delivered buffer by buffer when it would have been played.

    address: of kind file, capture or scene. Each buffer is due when its last frame is. It is
    never idle; closed, it pauses, and goes on where it was. `ended` once all was played and felt.
    For the supervising thread alone; the pacer's thread delivers.

    Raises
    ------
    UsageError, NotFoundError
        The sound cannot be used; see `open_tap`.
    """

    needs_server = False
    may_rest = False
    xruns = 0

    def __init__(self, address: TapAddress, pacer: Pacer, feed: Feed) -> None:
        self._address = address
        self._pacer = pacer
        self._feed = feed
        self._player: _Player | None = None
        self._tap = (
            FileTap(Path(address.name), BLOCK_FRAMES)
            if address.kind == "file"
            else open_tap(address)
        )
        self.samplerate = self._tap.samplerate
        self.channels = self._tap.channels

    def __str__(self) -> str:
        return str(self._address)

    @property
    def ended(self) -> bool:
        """Whether all was played and felt."""
        return self._player is not None and self._player.ended

    @property
    def name(self) -> str | None:
        """What is played, while it is."""
        playing = self._player is not None and self._pacer.is_doing(self._player)
        return str(self._address) if playing else None

    @property
    def warnings(self) -> list[str]:
        """What the source has found wrong so far."""
        return list(getattr(self._tap, "warnings", ()))

    def locate(self, snapshot: ServerSnapshot | None, device: str | None) -> _Sound:
        """It is there."""
        return _Sound(str(self._address), self.samplerate, self.channels)

    def players(self, snapshot: ServerSnapshot | None) -> frozenset[int]:
        """No application plays it."""
        return frozenset()

    def listen(self, connection: PulseConnection | None, now_s: float) -> bool:
        """It does not rest."""
        return False

    def keep(self, connection: PulseConnection | None, now_s: float) -> None:
        """Play, or go on playing. Raises what has ended it, for good."""
        player, engine = self._player, self._feed.engine
        if player is None:
            assert engine is not None
            player = self._player = _Player(self._tap, self._feed, engine)
        if player.error is not None:
            raise player.error
        if not player.ended and not self._pacer.is_doing(player):
            player.lead_in()
            self._pacer.begin(player, now_s)

    def close(self) -> None:
        """Pause."""
        if self._player is not None:
            self._pacer.end(self._player)

    def end(self, *, keep: bool) -> None:
        """Let go of the source."""
        self.close()
        self._tap.close()


@dataclass(frozen=True)
class _Sound:
    """What is played, as a place."""

    name: str
    samplerate: int
    channels: int


class _Player:
    """The job: silence until the delay line plays, the sound, what is owed then, silence again."""

    def __init__(self, tap: Tap, feed: Feed, engine: Engine) -> None:
        self.error: Exception | None = None
        self.ended = False
        self._tap = tap
        self._feed = feed
        self._engine = engine
        self._played = FrameTime(engine.samplerate)
        self._silence = np.zeros((BLOCK_FRAMES, engine.drive.outputs), np.float32)
        self._owed: Float32Array | None = None
        self._led_in_s = 0.0
        self._leads_in = True
        self._run_out_s = 0.0
        self._next = tap.read()

    @property
    def due_s(self) -> float:
        """When the last frame of the next block has been played."""
        if self._leads_in or self._next is None:
            return self._played.after(BLOCK_FRAMES, self._engine.samplerate)
        return self._played.after(len(self._next), self._tap.samplerate)

    def lead_in(self) -> None:
        """Begin, or go on, with silence; call it while the job is not done."""
        self._leads_in = True
        self._led_in_s = 0.0

    def run(self, now_s: float) -> bool:
        """Deliver the next block."""
        if self._leads_in:
            self._be_silent(now_s)
            self._led_in_s += BLOCK_FRAMES / self._engine.samplerate
            plays = self._engine.delay_line.status.state in PLAYING
            self._leads_in = self._led_in_s < (LEAD_IN_S if plays else LEAD_IN_MAX_S)
        elif self._next is not None:
            self._deliver(self._next, now_s)
        elif self._owed is None or len(self._owed):
            self._pay(now_s)
        else:
            self._be_silent(now_s)
            self._run_out_s -= BLOCK_FRAMES / self._engine.samplerate
            self.ended = self._run_out_s <= 0.0
        return not self.ended

    def _deliver(self, frames: Float32Array, now_s: float) -> None:
        tap = self._tap
        self._feed.follow(tap.samplerate, tap.channels, discontinuity=tap.discontinuity)
        self._feed.push(frames, now_s)
        self._played.add(len(frames), tap.samplerate)
        self._next = tap.read()

    def _pay(self, now_s: float) -> None:
        """Send a block of what the effect owes at the end of the sound."""
        owed = self._feed.finish(now_s) if self._owed is None else self._owed
        block = self._silence.copy()
        part = owed[:BLOCK_FRAMES]
        block[: len(part)] = part
        self._owed = owed[BLOCK_FRAMES:]
        self._run_out_s = self._engine.delay_line.status.delay_s + RUN_OUT_S
        self._send(block, now_s)

    def _be_silent(self, now_s: float) -> None:
        self._send(self._silence, now_s)

    def _send(self, block: Float32Array, now_s: float) -> None:
        self._engine.send(block, now_s)
        self._played.add(len(block), self._engine.samplerate)
