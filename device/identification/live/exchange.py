"""One measurement in the streams' callbacks: listen, play once, record, and stop on any problem.

The threads of two streams call `fill` and `on_frames`, which neither wait nor raise an error, and
allocate one block at most. After the first problem, the output is silent from the next block on.
"""

import math
import threading
from collections.abc import Sequence

import numpy as np

from device.errors import CushionError, LostError
from device.identification.recording import IdentificationError
from device.units import Float32Array, FloatArray

BACKGROUND_S = 0.4  # time without output, to measure the background
MOST_LATENCY_S = 0.8  # largest time from playing to recording of a frame
STALL_S = 0.5  # a stream without a callback for this long has stopped
LOUDEST_BACKGROUND = 0.02  # largest r.m.s. before the sweep, relative to full scale
NO_SIGNAL_S = 1.5  # longest digital silence after the start of playback
_CLIPPED = 0.999


class Exchange:
    """Plays samples on one channel, records all inputs, and checks inputs not named "-"."""

    def __init__(
        self, samples: FloatArray, samplerate: int, names: Sequence[str], output_channel: int = 0
    ) -> None:
        self.ended = threading.Event()  # set after the recording or an error
        self.error: CushionError | None = None
        # number of recorded frames before the playback
        self.background_frames = round(BACKGROUND_S * samplerate)
        self._names = tuple(names)
        self._used = [i for i, name in enumerate(self._names) if name != "-"]
        self._channel = output_channel
        self._samples = np.asarray(samples, np.float32)
        capacity = self.background_frames + len(samples) + round(MOST_LATENCY_S * samplerate)
        self._recorded = np.zeros((capacity, len(self._names)), np.float32)
        self._sum, self._squares = np.zeros((2, len(self._names)))
        self._heard = [False] * len(self._names)
        self._heard_by = self.background_frames + round(NO_SIGNAL_S * samplerate)
        self._got = self._played = 0
        self._begun = self._may_play = False
        self._heard_s = self._filled_s = -math.inf

    def begin(self) -> None:
        """Begin the measurement; both streams must be connected to the right devices."""
        self._begun = True

    def abort(self, error: CushionError) -> None:
        """Silence the output from the next block on, and keep the first error."""
        if self.error is None and not self.ended.is_set():
            self.error = error
        self.ended.set()

    @property
    def recorded(self) -> Float32Array:
        """The recording, (frames, channels), background first; valid once `ended` is set."""
        return self._recorded[: self._got]

    @property
    def played(self) -> bool:
        """Whether anything was played. Any thread may read it."""
        return self._played > 0

    @property
    def share_recorded(self) -> float:
        """The finished share of the measurement, 0 to 1. Any thread may read it."""
        return self._got / len(self._recorded)

    def fill(self, out: Float32Array, now_s: float) -> None:
        """Write the next samples into `out`, a block of zeros. The output's thread calls it."""
        self._filled_s = now_s
        if not self._may_play or self.ended.is_set():
            return
        if now_s - self._heard_s > STALL_S:
            self.abort(LostError("the input stopped during the sweep; check it, and sweep again"))
            return
        part = self._samples[self._played : self._played + len(out)]
        self._played += len(part)
        out[: len(part), self._channel] = part

    def on_frames(self, frames: Float32Array, now_s: float) -> None:
        """Record the next block, (frames, channels). Only the input's thread calls it."""
        self._heard_s = now_s
        if not self._begun or self.ended.is_set():
            return
        if self._may_play and now_s - self._filled_s > STALL_S:
            self.abort(LostError("the output stopped during the sweep; check it, and sweep again"))
            return
        self._check_peaks(frames)
        take = min(len(frames), len(self._recorded) - self._got)
        self._recorded[self._got : self._got + take] = frames[:take]
        self._got += take
        if self.ended.is_set():
            return
        if not self._may_play:
            self._listen(frames[:take])
        elif self._got >= self._heard_by and not all(self._heard[i] for i in self._used):
            self._refuse(
                next(i for i in self._used if not self._heard[i]),
                f"no signal, nothing but zeros for {NO_SIGNAL_S:g} s; check power, cables and that "
                "channel, that the input is not muted, and that the loop's delay is at most "
                f"{MOST_LATENCY_S:g} s",
            )
        if self._got == len(self._recorded):
            self.ended.set()

    def _refuse(self, channel: int, words: str) -> None:
        self.abort(IdentificationError(f"{self._names[channel]}: {words}"))

    def _check_peaks(self, frames: Float32Array) -> None:
        for channel in self._used:
            peak = float(np.abs(frames[:, channel]).max(initial=0.0))
            self._heard[channel] |= peak > 0.0
            if not peak < _CLIPPED:
                what = "is not a number" if math.isnan(peak) else f"clips at {peak:.4g}"
                advice = "lower the level, or the gain of that input"
                self._refuse(channel, f"the input {what} of its full scale; {advice}")
                return

    def _listen(self, frames: Float32Array) -> None:
        """Measure the background, and begin to play if it is quiet."""
        self._sum += frames.sum(axis=0, dtype=np.float64)
        self._squares += np.square(frames, dtype=np.float64).sum(axis=0)
        if self._got < self.background_frames:
            return
        self.background_frames = self._got
        variance = self._squares / self._got - (self._sum / self._got) ** 2
        for channel in self._used:
            if (rms := math.sqrt(max(float(variance[channel]), 0.0))) > LOUDEST_BACKGROUND:
                self._refuse(
                    channel,
                    f"{rms:.3g} r.m.s. of full scale before anything was played, at most "
                    f"{LOUDEST_BACKGROUND} is allowed: something else plays or moves the cushion, "
                    "or the input is noisy; stop it, or lower the gain of that input",
                )
                return
        self._may_play = True
