"""What the audio threads run: sound through the chain into the delay line, and out."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.pipeline.drive_factory import drive_of
from audioflinger_hook.pipeline.framework import Framework
from audioflinger_hook.pipeline.step import Pipeline
from audioflinger_hook.service.meters import BufferClock, BufferedLevelMeter
from audioflinger_hook.sources import Client
from device.clock import DelayLine
from device.clock.frame_clock import STALLED_S
from device.errors import UsageError
from device.units import Float32Array, FloatArray

LATENESS_LEAST_S = 0.0125
"""An idle machine's callbacks are some ms late now and then: the delay is not to follow that. With
blocks of 256 frames four of them are then mostly there to be read in one go."""

CYCLE_BLOCKS = 8
"""Blocks that are mixed in one cycle, if so many came since the last one."""

READ_BLOCKS = 4
"""Blocks that are read from the delay line in one go, if they are there."""

FADED = 1e-6
"""Vibration below this, of full scale, is none: -120 dB."""


@dataclass(frozen=True)
class Clocks:
    """Where time comes from, in seconds: now_s goes on, used_s is the calling thread's CPU time.

    slept_s: how long the machine has slept since it was started, in which now_s stands still.
    """

    now_s: Callable[[], float]
    used_s: Callable[[], float]
    slept_s: Callable[[], float] = float


OnStep = Callable[[Float32Array, Float32Array, float], None]
"""(sound as mixed, vibration as sent, when): what one cycle of the chain moved."""

OnMix = Callable[[Float32Array, float], None]
"""(sound before all effects, when)."""


class Engine:
    """One mix of sound on its way to one device.

    client: plays into the mix, which has its samplerate (Hz) and channels. output_samplerate: of
    the device, Hz; offset_s: what the user adds to the delay; block_frames: of the streams on
    both sides; clocks: what time it is, and what the thread has used. bypass_late: whether an
    effect that uses too much time is passed by: for sound that plays elsewhere meanwhile. on_step:
    told of every cycle, on the thread that calls `advance`; the arrays are its own. on_mix: told
    the sound before that, as no effect has changed it yet; the array is the mixer's. `advance` is
    called by one thread at a time, the capture's or the output's, `fill` by the output's; neither
    waits for the other. Any thread may read the rest.

    buffers, frames: how many were mixed; frames_max: of a cycle. last_sound_s: when they were not
    silent. faded: whether the vibration last looked at was none. sound, vibration: their levels.
    before_fill: called by `fill` before it reads; set it before that. filled_s:
    when `fill` was called last. drive: from the vibration that `vibration` measures to what the
    actuators play; driven: the level of each named actuator.

    Raises
    ------
    UsageError
        The settings cannot be used with this mix.
    """

    def __init__(
        self,
        client: Client,
        output_samplerate: int,
        settings: Settings | None = None,
        *,
        clocks: Clocks,
        offset_s: float = 0.0,
        block_frames: int = 256,
        now_s: float = 0.0,
        bypass_late: bool = True,
        on_step: OnStep | None = None,
        on_mix: OnMix | None = None,
    ) -> None:
        self._client = client
        self._clocks = clocks
        self._on_step = on_step
        self.block_frames = block_frames
        self.samplerate = client.samplerate
        self.channels = client.channels
        self.framework = Framework(
            self.samplerate,
            self.channels,
            settings,
            hal_frames=CYCLE_BLOCKS * block_frames,
            # Its own time: what the machine spends on others is no fault of an effect.
            clock=clocks.used_s if bypass_late else None,
        )
        chosen = self.framework.settings
        self.drive = drive_of(chosen, self.samplerate, self.framework.haptic_channels)
        self.driven = [BufferedLevelMeter(self.samplerate) for _ in chosen.actuators]
        self.delay_line = self._line(output_samplerate, offset_s)
        self.sound = BufferedLevelMeter(self.samplerate)
        self.vibration = BufferedLevelMeter(self.samplerate)
        self.buffer_times = BufferClock()
        self.buffers = 0
        self.frames = 0
        self.frames_max = self.framework.mixer.frames
        self.before_fill: Callable[[], None] = _nothing
        self.filled_s = -math.inf
        self.faded = True
        self.last_sound_s = now_s
        self._into_line = _IntoLine(self)
        self._chain = Pipeline(client, self.framework, [self._into_line])
        if on_mix is not None:
            self.framework.mixer.on_mix = lambda sound: on_mix(sound, self._into_line.now_s)
        self._read = np.zeros((0, self.drive.outputs), np.float32)
        self._start = self._end = 0

    def _line(self, samplerate: int, offset_s: float) -> DelayLine:
        return DelayLine(
            self.drive.outputs,
            self.samplerate,
            samplerate,
            capture_block=self.block_frames,
            output_block=self.block_frames,
            offset_s=offset_s,
            lateness_least_s=LATENESS_LEAST_S,
        )

    def lead_to(self, samplerate: int, block_frames: int | None = None) -> None:
        """Go on to an output of another samplerate, Hz, or with other blocks on both sides.

        Call it while nobody calls `fill`, and for other blocks nobody `advance` either.
        """
        blocks = block_frames or self.block_frames
        rate = round(self.delay_line.samplerate_out)
        if (samplerate, blocks) != (rate, self.block_frames):
            self.block_frames = blocks
            self.delay_line = self._line(samplerate, self.delay_line.offset_s)
            self._drop_ahead()

    def follow(self, settings: Settings, offset_s: float) -> None:
        """Take another level, other parameters and another offset while it runs.

        Of actuators level, polarity, delay and source, if their sources stay the same together.
        For the thread that made it. UsageError: they cannot be had, and nothing has changed.
        """
        before_s = self.delay_line.offset_s
        self.delay_line.offset_s = offset_s
        try:
            self.framework.change(settings)
        except UsageError:
            self.delay_line.offset_s = before_s
            raise
        self.drive.change(settings.actuators)

    def advance(self, now_s: float, earlier: Sequence[tuple[float, int]] = ()) -> bool:
        """Do one cycle with what the client has; False once it has come to its end.

        now_s: when the sound came, in seconds of time.monotonic(); earlier: see `DelayLine.write`,
        for a client that hands over all of it at once.
        """
        began_s = self._clocks.used_s()
        self._into_line.now_s = now_s
        self._into_line.earlier = earlier
        step = self._chain.step(now_s)
        if step is None:
            return False
        audio, vibration = step.audio, step.vibration
        if not len(vibration):  # too little for a cycle
            return True
        self.sound.add(audio)
        self.vibration.add(vibration)
        if self.sound.measured and self.sound.loudest > 0.0:
            self.last_sound_s = now_s
        if self.vibration.measured:
            self.faded = self.vibration.loudest < FADED
        if self._on_step is not None:
            self._on_step(audio, vibration, now_s)
        self.buffers += 1
        self.frames += len(audio)
        self.buffer_times.add(self._clocks.used_s() - began_s, len(vibration) / self.samplerate)
        return True

    def finish(self, now_s: float) -> Float32Array:
        """Let the client come to its end; return the vibration still owed, for `send`.

        On the thread that calls `advance`, which then has nothing left to do.
        """
        held = self._into_line.held = []
        while self.advance(now_s):
            pass
        held.append(self.drive.drain())
        return np.concatenate([self._read[:0], *held])

    def send(self, vibration: Float32Array, now_s: float) -> None:
        """Put vibration that is in no cycle into the delay line; on the thread of `advance`."""
        self.delay_line.write(vibration, now_s)

    def rest(self) -> None:
        """Forget what was to be played, and what levels were; call it while no stream runs.

        The next sound then goes out as soon as both streams run.
        """
        self.delay_line.flush()
        self.drive.flush()
        for gathered in self.driven:
            gathered.reset()
        self._drop_ahead()
        self.sound.reset()
        self.vibration.reset()

    @property
    def read_ahead(self) -> Float32Array:
        """The vibration that was read and is not played yet; for the thread of `fill`.

        A view, until the next `fill`.
        """
        return self._read[self._start : self._end]

    def fill(self, out: Float32Array, now_s: float) -> None:
        """Write what is played next into `out`, (frames, actuators)."""
        if now_s - self.filled_s > STALLED_S:  # of before a gap
            self._drop_ahead()
        self.filled_s = now_s
        frames = len(out)
        if self._end - self._start < frames:
            self._read_on(frames, now_s)
        start = self._start
        self._start = min(start + frames, self._end)
        out[:] = self._read[start : self._start]

    def _read_on(self, frames: int, now_s: float) -> None:
        """Have `frames` or more read; more only where the delay line has them already."""
        kept = self.read_ahead
        held = len(kept)
        missing = frames - held
        self.before_fill()
        line = self.delay_line
        ahead = (line.readable - missing) // frames
        ahead = frames * max(0, min(READ_BLOCKS - 1, ahead))
        needed = frames + ahead
        if len(self._read) < needed:
            self._read = np.zeros((frames * READ_BLOCKS, kept.shape[1]), np.float32)
        self._read[:held] = kept
        playing_s = now_s + held / line.samplerate_out
        read = line.read(self._read[held:needed], playing_s, ahead)
        self._start, self._end = 0, held + read

    def _drop_ahead(self) -> None:
        self._start = self._end = 0


class _IntoLine:
    """The delay line as an output of the chain; now_s, earlier: when the frames being treated came.

    held: takes the blocks instead, where it is not None.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self.now_s = 0.0
        self.earlier: Sequence[tuple[float, int]] = ()
        self.held: list[Float32Array] | None = None
        self.samplerate = engine.samplerate
        self.channels = engine.framework.haptic_channels

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Take one block."""
        engine = self._engine
        vibration = engine.drive.process(np.asarray(vibration, np.float32))
        for index, gathered in enumerate(engine.driven):
            gathered.add(vibration[:, index : index + 1])
        if self.held is not None:
            self.held.append(np.array(vibration, np.float32))
            return
        engine.delay_line.write(vibration, self.now_s, self.earlier)

    def close(self) -> None:
        """Nothing is held."""

    def abort(self) -> None:
        """Drop what is waiting."""
        self._engine.delay_line.flush()


def _nothing() -> None:
    """What is to be done where nothing is."""
