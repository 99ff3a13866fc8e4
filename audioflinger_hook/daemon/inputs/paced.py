"""An input that plays a file, a capture or a scene in real time."""

from pathlib import Path

import numpy as np

from audioflinger_hook.daemon.capture_queue import Feed
from audioflinger_hook.daemon.engine import Engine
from audioflinger_hook.daemon.inputs.base import FixedNode, Input
from audioflinger_hook.daemon.pacing import FrameTime, Pacer
from audioflinger_hook.sources import FileTap, Tap, TapAddress, open_tap
from device.clock import DelayState
from device.server import PulseConnection, ServerSnapshot
from device.units import Float32Array

BLOCK_FRAMES = 256  # buffer length for a file; a capture keeps its own buffers
LEAD_IN_S = 0.2  # shortest silence before the sound, in which the delay line starts
LEAD_IN_MAX_S = 5.0  # longest silence before the sound, while no output reads the delay line
RUN_OUT_S = 0.3  # silence after the vibration, in which the server plays its buffers

PLAYING = (DelayState.SETTLING, DelayState.LOCKED)


class PacedInput(Input):
    """Sound of a file, capture or scene. UsageError, NotFoundError: see `open_tap`."""

    def __init__(self, address: TapAddress, pacer: Pacer, feed: Feed) -> None:
        super().__init__(str(address))
        self._pacer, self._feed = pacer, feed
        self._player: _Player | None = None
        is_file = address.kind == "file"
        self._tap = FileTap(Path(address.name), BLOCK_FRAMES) if is_file else open_tap(address)
        self._node = FixedNode(str(address), self._tap.samplerate, self._tap.channels)

    @property
    def ended(self) -> bool:
        """See `Input`."""
        return self._player is not None and self._player.ended

    @property
    def name(self) -> str | None:
        """The address while the sound is played, else None."""
        playing = self._player is not None and self._pacer.is_doing(self._player)
        return self.address if playing else None

    @property
    def warnings(self) -> list[str]:
        """Warnings of the file, capture or scene, one line each."""
        return list(getattr(self._tap, "warnings", ()))

    def locate(self, snapshot: ServerSnapshot | None, device: str | None) -> FixedNode:
        """Return the source, which is always available."""
        return self._node

    def maintain(self, connection: PulseConnection | None, now_s: float) -> None:
        """Start or continue the sound; raise the error that ended the sound, if any."""
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
        """Pause the sound until the next `maintain`."""
        if self._player is not None:
            self._pacer.end(self._player)

    def end(self) -> None:
        """Close the source."""
        self.close()
        self._tap.close()


class _Player:
    """Job of the pacer's thread: play silence, the sound, the remaining vibration, and silence."""

    def __init__(self, tap: Tap, feed: Feed, engine: Engine) -> None:
        self.error: Exception | None = None
        self.ended = False
        self._tap, self._feed, self._engine = tap, feed, engine
        self._played = FrameTime()
        self._silence = np.zeros((BLOCK_FRAMES, engine.drive.outputs), np.float32)
        self._tail: Float32Array | None = None
        self._in_lead_in = True
        self._led_in_s = self._run_out_s = 0.0
        self._next = tap.read()

    @property
    def due_s(self) -> float:
        if self._in_lead_in or self._next is None:
            return self._played.after(BLOCK_FRAMES, self._engine.samplerate)
        return self._played.after(len(self._next), self._tap.samplerate)

    def lead_in(self) -> None:
        """Let the job begin with silence. Call it only while the job does not run."""
        self._in_lead_in = True
        self._led_in_s = 0.0

    def run(self, now_s: float) -> bool:
        if self._in_lead_in:
            self._send(self._silence, now_s)
            self._led_in_s += BLOCK_FRAMES / self._engine.samplerate
            plays = self._engine.delay_line.status.state in PLAYING
            self._in_lead_in = self._led_in_s < (LEAD_IN_S if plays else LEAD_IN_MAX_S)
        elif self._next is not None:
            tap = self._tap
            self._feed.opened(tap.samplerate, tap.channels, discontinuity=tap.discontinuity)
            self._feed.push(self._next, now_s)
            self._played.add(len(self._next), tap.samplerate)
            self._next = tap.read()
        elif self._tail is None or len(self._tail):
            tail = self._feed.finish(now_s) if self._tail is None else self._tail
            part, self._tail = tail[:BLOCK_FRAMES], tail[BLOCK_FRAMES:]
            block = self._silence.copy()
            block[: len(part)] = part
            self._run_out_s = self._engine.delay_line.status.delay_s + RUN_OUT_S
            self._send(block, now_s)
        else:
            self._send(self._silence, now_s)
            self._run_out_s -= BLOCK_FRAMES / self._engine.samplerate
            self.ended = self._run_out_s <= 0.0
        return not self.ended

    def _send(self, block: Float32Array, now_s: float) -> None:
        self._engine.delay_line.write(block, now_s)
        self._played.add(len(block), self._engine.samplerate)
