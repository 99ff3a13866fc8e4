"""Two streams for one measurement: it plays on one device and hears another, or ends in silence.

A measurement does not recover: what it missed cannot be made up for. So whatever happens to either
stream, a device that goes, another place, a late block, ends it with the reason.
"""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Protocol

from device.errors import CushionError, InternalError, LostError
from device.server.guard import FallbackSink, StreamGuard
from device.server.pulse import PulseConnection
from device.stream.pcms import PcmConfig, ServerDevice, Target
from device.stream.sample_format import SampleFormat
from device.stream.streams import CaptureStream, PlaybackStream
from device.units import Float32Array

OUTPUT, INPUT = "cushion_output", "cushion_input"
"""Names of the PCMs that are needed."""

SETTLE_S = 5.0
"""For so long streams may take until they run where they belong."""

BLOCK_FRAMES = 1024
"""Four times the usual: a measurement has time, and what comes late would be lost to it."""

_LOOK_S = 0.02


class MeasuredExchange(Protocol):
    """What is measured, from the streams' side; see `device.identification.live.exchange`."""

    @property
    def sounding(self) -> bool:
        """Whether something is being played."""
        ...

    def begin(self) -> None:
        """Both streams are where they belong."""
        ...

    def abort(self, error: CushionError) -> None:
        """Silence from the next block on."""
        ...

    def wait(self, seconds: float) -> bool:
        """Wait for the end so long; whether it has ended."""
        ...

    def fill(self, out: Float32Array, now_s: float) -> None:
        """For the output's thread."""
        ...

    def on_frames(self, frames: Float32Array, now_s: float) -> None:
        """For the input's thread."""
        ...


@dataclass(frozen=True)
class StreamEndpoint:
    """Where one stream leads. name: the server's or the card's; channels: as it is opened."""

    target: Target
    name: str
    channels: int
    sample_format: SampleFormat = SampleFormat.FLOAT32

    @property
    def guarded(self) -> bool:
        """Whether a server could lead it elsewhere."""
        return isinstance(self.target, ServerDevice)


class MeasurementStreams:
    """A `Transport` of real devices. One thread uses it.

    pcms: with PCMs OUTPUT and INPUT; samplerate: Hz, of both; connection: to the sound server,
    None where neither way leads there.
    """

    def __init__(
        self,
        pcms: PcmConfig,
        output: StreamEndpoint,
        source: StreamEndpoint,
        samplerate: int,
        connection: PulseConnection | None,
    ) -> None:
        self._pcms, self._connection = pcms, connection
        self._output, self._source = output, source
        self._samplerate = samplerate

    @property
    def samplerate(self) -> int:
        """Rate of both streams, Hz."""
        return self._samplerate

    def run(self, exchange: MeasuredExchange) -> None:
        """Both streams until the measurement has ended; what ended it is left with it.

        Raises
        ------
        LostError, NotFoundError, UsageError
            A stream cannot be opened.
        """
        with ExitStack() as stack:
            # last of all: whatever leaves this, Ctrl+C too, leaves silence
            if self._output.guarded and self._connection is not None:
                stack.callback(FallbackSink(self._connection).close)
            outward = self._pcms.pcms[OUTPUT]
            outward.target = self._output.target
            playback = PlaybackStream(
                outward,
                self._samplerate,
                self._output.channels,
                exchange.fill,
                block_frames=BLOCK_FRAMES,
                sample_format=self._output.sample_format,
            )
            stack.callback(playback.close)
            inward = self._pcms.pcms[INPUT]
            inward.target = self._source.target
            capture = CaptureStream(
                inward,
                self._samplerate,
                self._source.channels,
                exchange.on_frames,
                block_frames=BLOCK_FRAMES,
            )
            stack.callback(capture.close)
            guards = []
            for stream, way in ((playback, self._output), (capture, self._source)):
                if way.guarded and self._connection is not None:
                    guard = StreamGuard(self._connection, stream, way.name, any_source=True)
                    stack.callback(guard.release)
                    guards.append(guard)
                else:
                    stream.audible = True
            stack.callback(exchange.abort, LostError("the measurement was given up"))
            watch = _Watch(playback, capture, guards, (self._output.name, self._source.name))
            watch.settle(exchange)
            watch.until_the_end(exchange)


class _Watch:
    """Looks after both streams for the thread that waits."""

    def __init__(
        self,
        playback: PlaybackStream,
        capture: CaptureStream,
        guards: list[StreamGuard],
        names: tuple[str, str],
    ) -> None:
        self._streams = playback, capture
        self._guards = guards
        self._names = names

    def settle(self, exchange: MeasuredExchange) -> None:
        """Begin once both run where they belong; LostError if that takes too long."""
        limit_s = time.monotonic() + SETTLE_S
        while not (
            all(guard.hold.audible for guard in self._guards)
            and all(stream.callbacks > 3 for stream in self._streams)
        ):
            if time.monotonic() > limit_s:
                held = [guard.hold.value for guard in self._guards if not guard.hold.audible]
                raise LostError(
                    f"{' and '.join(self._names)} do not run after {SETTLE_S:g} s "
                    f"({', '.join(held) or 'a device delivers nothing'}); check both, and try again"
                )
            exchange.wait(_LOOK_S)
        self._before = self._counts()
        exchange.begin()

    def until_the_end(self, exchange: MeasuredExchange) -> None:
        """Wait for the end, or bring it about."""
        while not exchange.wait(_LOOK_S):
            error = self._wrong(time.monotonic())
            if error is not None:
                exchange.abort(error)

    def _counts(self) -> list[tuple[int, int, int]]:
        return [(s.xruns, s.silenced, sum(s.errors.values())) for s in self._streams]

    def _wrong(self, now_s: float) -> CushionError | None:
        for guard in self._guards:
            if not guard.hold.audible:
                return LostError(
                    f"the measurement has ended: {guard.hold.value}; plug it in again, and repeat"
                )
        counts = self._counts()
        for stream, name, before, now in zip(
            self._streams, self._names, self._before, counts, strict=True
        ):
            if stream.is_lost(now_s):
                return LostError(f"{name} went away during the sweep; plug it in again, and repeat")
            if now[0] > before[0] or now[1] > before[1]:
                return LostError(
                    f"{name}: a block came too late during the sweep; close other programs, and "
                    "repeat"
                )
            if now[2] > before[2]:
                kinds = ", ".join(stream.errors)
                return InternalError(f"{name}: {kinds} in a callback; please report it")
        return None
