"""`cushion run --record`: what was delivered, what was made of it, and what was sent, kept."""

from __future__ import annotations

import os
from contextlib import suppress
from types import TracebackType

import numpy as np

from audioflinger_hook.capture import STREAMS, CaptureRecorder, CaptureWriter
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon.capture_settings import facts_of
from audioflinger_hook.daemon.engine import OnMix, OnStep
from device.errors import CushionError
from device.units import Float32Array


class RunRecording:
    """A capture of one run: streams `tap`, `effect` and `device`, from the first buffer on.

    Nothing is written before `begin`. folder: new or empty; settings: of the run, kept among the
    capture's facts so that a replay needs no other; tap, device: their addresses. A replay of
    `tap` gives `effect` bit for bit.

    `delivered` and `felt` are called by the thread that mixes, `sent` by the output's, `reopened`
    while that one rests; none of them waits or raises. Where writing fails, the capture ends as it
    is and the run goes on: `problem` says so, and `close` raises it.
    """

    def __init__(
        self, folder: str | os.PathLike[str], settings: Settings, tap: str, device: str
    ) -> None:
        self._mix: tuple[int, int] | None = None
        self._begun = False
        self._broken = {"effect": False, "device": False}
        self._device_begun = False
        self._ended = ""
        self._folder = folder
        self._facts = {"tap": tap, "device": device, **facts_of(settings)}
        self._recorder: CaptureRecorder | None = None

    def begin(self) -> None:
        """Make the folder; call it before the first buffer. Raises as `CaptureWriter` does."""
        writer = CaptureWriter(self._folder, streams=STREAMS, facts=self._facts)
        self._recorder = CaptureRecorder(writer)

    @property
    def problem(self) -> str:
        """Why nothing is recorded any more, one line; empty while all goes well. Any thread."""
        error = self._recorder.error if self._recorder else None
        return f"the recording has ended: {error}" if error else self._ended

    @property
    def warnings(self) -> list[str]:
        """What a user should know about the recording, a line each. Any thread."""
        if self.problem:
            return [self.problem]
        if self._recorder is None:
            return []
        dropped = {name: self._recorder.dropped(name)[0] for name in STREAMS}
        return [
            f"{count} buffers of stream {name} could not be recorded: the disk was too slow"
            for name, count in dropped.items()
            if count
        ]

    def mix_is(self, samplerate: int, channels: int) -> None:
        """Be told the format of the mix, Hz, before the first buffer."""
        self._mix = (samplerate, channels)

    def hooks(self, samplerate: int, *, of_mix: bool) -> tuple[OnStep, OnMix | None]:
        """Return what an engine has to call, for a mix of this rate, Hz.

        of_mix: whether the mix is what was delivered: of many sounds, which no replay could mix
        again as they came.
        """

        def felt(_: Float32Array, vibration: Float32Array, now_s: float) -> None:
            self.felt(vibration, samplerate, now_s)

        def mixed(sound: Float32Array, now_s: float) -> None:
            self.delivered(sound, samplerate, now_s, discontinuity=False)

        return felt, mixed if of_mix else None

    def delivered(
        self, frames: Float32Array, samplerate: int, now_s: float, discontinuity: bool
    ) -> None:
        """Keep a buffer of the tap; discontinuity: frames are missing before it."""
        recorder = self._recorder
        if self._ended or recorder is None:
            return
        if not self._begun and self._mix not in (None, (samplerate, frames.shape[1])):
            # A replay takes the first buffer's format for the mix: an empty one tells it.
            mix_samplerate, mix_channels = self._mix or (samplerate, 1)
            nothing = np.zeros((0, mix_channels), np.float32)
            recorder.offer("tap", nothing, mix_samplerate, now_s)
        self._begun = True
        self._broken["effect"] = self._broken["effect"] or discontinuity
        recorder.offer("tap", frames, samplerate, now_s, discontinuity=discontinuity)

    def felt(self, vibration: Float32Array, samplerate: int, now_s: float) -> None:
        """Keep the effect's output, before the delay line."""
        self._offer("effect", vibration, samplerate, now_s)

    def reopened(self) -> None:
        """Be told that a new stream leads to the device."""
        self._broken["device"] = self._device_begun

    def sent(self, frames: Float32Array, samplerate: int, now_s: float) -> None:
        """Keep what went to the device, as it went."""
        self._device_begun = True
        self._offer("device", frames, samplerate, now_s)

    def end(self, why: str) -> None:
        """Record nothing more, because of `why`: what follows would not be what a replay gives."""
        self._ended = self._ended or f"the recording {self._folder} has ended: {why}"

    def close(self) -> None:
        """Complete the capture, and raise what made it end before its time. Waits for the disk.

        Called when nobody feeds it any more; harmless a second time.
        """
        if self._recorder:
            self._recorder.close()

    def __enter__(self) -> RunRecording:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None or not issubclass(kind, CushionError):
            self.close()
            return
        with suppress(CushionError):  # what ended the run comes first
            self.close()

    def _offer(self, stream: str, frames: Float32Array, samplerate: int, now_s: float) -> None:
        if self._ended or self._recorder is None:
            return
        broken = self._broken[stream]
        self._broken[stream] = False
        self._recorder.offer(stream, frames, samplerate, now_s, discontinuity=broken)
