"""Two simulated clocks around a delay line: rates, lateness, bursts and stalls, no sleeping.

What is written is a sawtooth of frame numbers, so what is read tells exactly which frame it is:
the true delay, without a look into the line.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from device.clock.delay_control import DelayState, DelayStatus
from device.clock.delay_line import DelayLine
from device.units import FloatArray

SAWTOOTH_FRAMES = 1 << 14
"""One frame is 2^-14 of full scale: float32 then tells 1/1000 of a frame."""


@dataclass
class Side:
    """The callbacks of one stream.

    ppm: its clock against true time. jitter_s: every callback is late by a uniform 0 to this.
    burst: callbacks delivered together, when the last of them is due. server_block: frames that the
    server delivers together, a callback for each whole block of ours. pauses: (from_s, to_s)
    during which no callback runs; they all come at the end of it. gaps: the same, but the stream
    itself stands: what would have been captured or played meanwhile never is.
    """

    samplerate: float = 48_000.0
    block: int = 256
    ppm: float = 0.0
    jitter_s: float = 0.0
    burst: int = 1
    server_block: int = 0
    start_s: float = 0.0
    pauses: tuple[tuple[float, float], ...] = ()
    gaps: tuple[tuple[float, float], ...] = ()
    seed: int = 0
    rate: float = field(init=False)

    def __post_init__(self) -> None:
        self.rate = self.samplerate * (1.0 + 1e-6 * self.ppm)

    def callbacks(self) -> Iterator[tuple[float, float]]:
        """Time of the callback and true time of the counter, for block after block, endlessly."""
        draw = np.random.default_rng(self.seed)
        last_s, shift_s, number = 0.0, 0.0, 0
        while True:
            for late in draw.uniform(0.0, self.jitter_s, 4096):
                true_s = self.start_s + shift_s + number * self.block / self.rate
                for begin_s, end_s in self.gaps:
                    if begin_s <= true_s < end_s:
                        shift_s += end_s - true_s
                        true_s = end_s
                waits = (self.burst - 1 - number % self.burst) * self.block
                if self.server_block:
                    waits = -(number * self.block) % self.server_block
                now_s = true_s + waits / self.rate + late
                for begin_s, end_s in self.pauses:
                    if begin_s <= now_s < end_s:
                        now_s = end_s
                last_s = max(last_s, now_s)
                yield last_s, true_s
                number += 1


@dataclass
class Course:
    """What happened, one entry for each read: times, true delay (nan: not to be told), status."""

    time_s: FloatArray
    delay_s: FloatArray
    target_s: FloatArray
    ppm: FloatArray
    states: list[DelayState]
    last: DelayStatus

    def after(self, time_s: float) -> FloatArray:
        """True delay minus target from a time on, where it can be told, in seconds."""
        error = (self.delay_s - self.target_s)[self.time_s >= time_s]
        return error[np.isfinite(error)]


def run(line: DelayLine, writer: Side, reader: Side, seconds: float, at_read=None) -> Course:
    """Play both sides against each other; both begin with the same true time, unless set.

    at_read: called after each read with its time, the line, and what was read.
    """
    assert SAWTOOTH_FRAMES % writer.block == 0
    ramp = np.arange(SAWTOOTH_FRAMES, dtype=np.float32) / np.float32(SAWTOOTH_FRAMES)
    sawtooth = np.repeat(ramp[:, np.newaxis], line.channels, axis=1)
    out = np.empty((reader.block, line.channels), np.float32)
    writes, reads = writer.callbacks(), reader.callbacks()
    (write_s, captured_s), (read_s, played_s) = next(writes), next(reads)
    written = 0
    rows: list[tuple[float, float, float, float]] = []
    states: list[DelayState] = []
    while read_s < seconds:
        if write_s <= read_s:
            first = written % SAWTOOTH_FRAMES
            line.write(sawtooth[first : first + writer.block], write_s)
            written += writer.block
            now = (written, captured_s)
            write_s, captured_s = next(writes)
            continue
        line.read(out, read_s)
        status, delay_s = line.status, np.nan
        if written and status.state in (DelayState.SETTLING, DelayState.LOCKED):
            # Straight only: no fade under way, no edge of the sawtooth.
            frames = out[:, 0].astype(np.float64) * SAWTOOTH_FRAMES
            steps = np.diff(frames[[0, 1, -1]]) / (1, max(1, len(frames) - 2))
            if np.abs(steps - line.samplerate_in / line.samplerate_out).max() < 0.003:
                held = (now[0] + (played_s - now[1]) * writer.rate - frames[0]) % SAWTOOTH_FRAMES
                delay_s = held / writer.samplerate
        rows.append((read_s, delay_s, status.target_s, status.ratio_ppm))
        states.append(status.state)
        if at_read:
            at_read(read_s, line, out)
        read_s, played_s = next(reads)
    time_s, delay_s, target_s, ppm = np.array(rows).T
    return Course(time_s, delay_s, target_s, ppm, states, line.status)
