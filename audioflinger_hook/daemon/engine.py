"""The Python engine: sound passes through mixer, effect and drive into a delay line."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon.live_memory import LiveMemory
from audioflinger_hook.pipeline.framework import Framework, drive_of
from audioflinger_hook.pipeline.step import Pipeline
from audioflinger_hook.service.meters import BufferClock, BufferedLevelMeter, LevelMeter
from audioflinger_hook.sources import Client
from device.clock import DelayLine
from device.clock.frame_clock import STALLED_S
from device.units import Float32Array, FloatArray

# Smallest assumed lateness of callbacks. Lateness up to this value does not change the delay.
LATENESS_LEAST_S = 0.0125
CYCLE_BLOCKS = 8  # largest number of blocks that one cycle mixes
READ_BLOCKS = 4  # largest number of blocks that one call reads from the delay line
FADED = 1e-6  # vibration with a smaller peak counts as silent; full scale is 1

FADE_S = 0.04  # duration of a fade, as in the plugin


@dataclass(frozen=True)
class Clocks:
    """Functions that return seconds: the time, the thread's CPU time, the time in suspend."""

    now_s: Callable[[], float]
    used_s: Callable[[], float]
    slept_s: Callable[[], float] = float


# Called with (mixed sound, vibration before the drive, time in s) of one cycle.
OnStep = Callable[[Float32Array, Float32Array, float], None]
# Called with (mixed sound before all effects, time in s).
OnMix = Callable[[Float32Array, float], None]


class Engine:
    """Passes a client's sound through mixer, effect and drive, then into a delay line.

    Either the capture thread or the output thread calls `advance`, never both at the same time. The
    output thread calls `fill`. No thread waits for another. Any thread may read the attributes.

    client: source of the sound; its format becomes the format of the mix. offset_s: delay that the
    user adds. block_frames: block length of input and output. bypass_late: whether to bypass an
    effect that uses too much CPU time. on_step, on_mix: called in each cycle of `advance`. `on_mix`
    may keep only a copy of the sound. last_sound_s: time of the latest cycle in which the mix was
    not silent. faded: whether the latest peak of the vibration is below FADED. sound, vibration:
    level meters of the mix, and of the vibration before the drive. driven: level meters of the
    drive's outputs, one per actuator. mute: fades the output in or out. before_fill: called before
    each read of the delay line. live: memory for the live page, or None.
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
        self._client, self._clocks, self._on_step = client, clocks, on_step
        self.block_frames = block_frames
        self.samplerate, self.channels = client.samplerate, client.channels
        self.framework = Framework(
            self.samplerate,
            self.channels,
            settings,
            hal_frames=CYCLE_BLOCKS * block_frames,
            # The load of other programs does not affect the thread's CPU time.
            clock=clocks.used_s if bypass_late else None,
        )
        chosen = self.framework.settings
        self.drive = drive_of(chosen, self.samplerate, self.framework.haptic_channels)
        self.driven = [BufferedLevelMeter(self.samplerate) for _ in chosen.actuators]
        self.delay_line = self._line(output_samplerate, offset_s)
        self.sound, self.vibration = (BufferedLevelMeter(self.samplerate) for _ in range(2))
        self.buffer_times = BufferClock()
        self.buffers = self.frames = 0
        self.frames_max = self.framework.mixer.frames
        self.before_fill: Callable[[], None] = lambda: None
        self.mute = SoftFade(output_samplerate)
        self.live: LiveMemory | None = None
        self.filled_s = -math.inf
        self.faded, self.last_sound_s = True, now_s
        self._drive_output = _DriveOutput(self)
        self._chain = Pipeline(client, self.framework, [self._drive_output])
        if on_mix is not None:
            self.framework.mixer.on_mix = lambda sound: on_mix(sound, self._drive_output.now_s)
        self._read = np.zeros((0, self.drive.outputs), np.float32)
        self._start = self._end = 0

    def _line(self, samplerate: int, offset_s: float) -> DelayLine:
        return DelayLine(
            self.drive.outputs,
            self.samplerate,
            samplerate,
            capacity_s=3.0,  # suffices for an offset of 2 s
            capture_block=self.block_frames,
            output_block=self.block_frames,
            offset_s=offset_s,
            lateness_least_s=LATENESS_LEAST_S,
        )

    def retarget(self, samplerate: int, block_frames: int | None = None) -> None:
        """Change the output's sample rate in Hz, or the block length of input and output.

        During this call, `fill` must not run, nor `advance` if the block length changes.
        """
        blocks = block_frames or self.block_frames
        if (samplerate, blocks) != (round(self.delay_line.samplerate_out), self.block_frames):
            self.block_frames = blocks
            self.delay_line = self._line(samplerate, self.delay_line.offset_s)
            self._drop_ahead()

    def follow(self, settings: Settings) -> None:
        """Change the settings; after a UsageError, nothing has changed. For the main thread."""
        self.framework.change(settings)
        self.drive.change(settings.actuators)

    def advance(self, now_s: float, earlier: Sequence[tuple[float, int]] = ()) -> bool:
        """Process one cycle: at most CYCLE_BLOCKS blocks. Return False after the end of the sound.

        now_s, earlier: arrival times of the frames; see `DelayLine.write`.
        """
        began_s = self._clocks.used_s()
        self._drive_output.now_s, self._drive_output.earlier = now_s, earlier
        step = self._chain.step(now_s)
        if step is None:
            return False
        audio, vibration = step.audio, step.vibration
        if not len(vibration):  # too few frames for a cycle
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
        if self.live is not None and self.live.is_due(self.frames):
            principal = self.framework.principal
            self.live.show(self.frames, self.sound.meter, self.driven_meters, principal)
        self.buffer_times.add(self._clocks.used_s() - began_s, len(vibration) / self.samplerate)
        return True

    def finish(self, now_s: float) -> Float32Array:
        """Process the rest of the sound; return its vibration, which bypasses the delay line.

        Only the thread that calls `advance` may call it.
        """
        held = self._drive_output.held = []
        while self.advance(now_s):
            pass
        held.append(self.drive.drain())
        return np.concatenate([self._read[:0], *held])

    def rest(self) -> None:
        """Clear the delay line, the drive and all levels. Call it only while no stream runs."""
        self.delay_line.flush()
        self.drive.flush()
        self._drop_ahead()
        for gathered in (self.sound, self.vibration, *self.driven):
            gathered.reset()

    @property
    def driven_meters(self) -> list[LevelMeter]:
        """Level meters of the config's actuators, or of the vibration if the config lists none."""
        return [gathered.meter for gathered in self.driven or (self.vibration,)]

    @property
    def read_ahead(self) -> Float32Array:
        """Frames that `fill` has read but not yet output; the next `fill` may overwrite them."""
        return self._read[self._start : self._end]

    def fill(self, out: Float32Array, now_s: float) -> None:
        """Write the next frames to `out`, (frames, drive outputs). The output thread calls it."""
        if now_s - self.filled_s > STALLED_S:  # the buffered vibration is outdated
            self._drop_ahead()
        self.filled_s = now_s
        frames = len(out)
        if self._end - self._start < frames:
            kept, line = self.read_ahead, self.delay_line
            held = len(kept)
            self.before_fill()
            blocks = (line.readable - (frames - held)) // frames
            ahead = frames * max(0, min(READ_BLOCKS - 1, blocks))
            needed = frames + ahead
            if len(self._read) < needed:
                self._read = np.zeros((frames * READ_BLOCKS, kept.shape[1]), np.float32)
            self._read[:held] = kept
            playing_s = now_s + held / line.samplerate_out
            self._start, self._end = 0, held + line.read(self._read[held:needed], playing_s, ahead)
        start = self._start
        self._start = min(start + frames, self._end)
        out[:] = self._read[start : self._start]
        if not (self.mute.audible and self.mute.position == 1.0):
            self.mute.apply(out)

    def _drop_ahead(self) -> None:
        self._start = self._end = 0


class SoftFade:
    """Fades the output in or out. A fade-in from silence waits for the first frame that is not 0.

    The output thread calls `apply`. Any thread may set `audible`, and read `position`: 0 to 1.
    """

    def __init__(self, samplerate: int) -> None:
        self.audible, self.position = True, 1.0
        self._step = 1.0 / (FADE_S * samplerate)

    def apply(self, out: Float32Array) -> None:
        """Multiply the next frames by the gain of the fade."""
        wanted = 1.0 if self.audible else 0.0
        if self.position == wanted:
            if not wanted:
                out[:] = 0.0
            return
        if self.position == 0.0:
            out = out[int(out.any(axis=1).argmax()) if out.any() else len(out) :]
        step = self._step if wanted else -self._step
        places = self.position + step * np.arange(1, len(out) + 1)
        places = np.clip(places, 0.0, 1.0, out=places)
        out *= (places * places * (3.0 - 2.0 * places))[:, None]
        if len(out):
            self.position = float(places[-1])


class _DriveOutput:
    """Passes vibration through the drive to the delay line, or to `held` if `held` is a list."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self.now_s = 0.0
        self.earlier: Sequence[tuple[float, int]] = ()
        self.held: list[Float32Array] | None = None
        self.samplerate, self.channels = engine.samplerate, engine.framework.haptic_channels

    def write(self, vibration: FloatArray | Float32Array) -> None:
        engine = self._engine
        vibration = engine.drive.process(np.asarray(vibration, np.float32))
        for index, gathered in enumerate(engine.driven):
            gathered.add(vibration[:, index : index + 1])
        if self.held is not None:
            self.held.append(np.array(vibration, np.float32))
        else:
            engine.delay_line.write(vibration, self.now_s, self.earlier)

    def close(self) -> None:
        """Do nothing: this output has no file or stream."""

    def abort(self) -> None:
        self._engine.delay_line.flush()
