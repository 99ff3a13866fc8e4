"""The two streams of a measurement: one plays, the other records.

A measurement cannot recover frames that it misses. So a lost device, a moved stream or a late block
ends the measurement with the reason.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass

from device.errors import CushionError, InternalError, LostError
from device.identification.live.exchange import Exchange
from device.server.guard import FallbackSink, StreamGuard
from device.server.pulse import PulseConnection
from device.stream.pcms import PcmConfig, ServerDevice, Target
from device.stream.sample_format import SampleFormat
from device.stream.streams import CaptureStream, PlaybackStream

OUTPUT, INPUT = "cushion_output", "cushion_input"
"""Names of the two PCMs that the caller must configure."""

SETTLE_S = 5.0  # time until both streams must run on their devices

BLOCK_FRAMES = 1024
"""Four times the default: latency does not matter, but a late block would be lost."""

_POLL_S = 0.02


@dataclass(frozen=True)
class StreamEndpoint:
    """The device of one stream."""

    target: Target
    name: str  # for messages
    channels: int
    sample_format: SampleFormat = SampleFormat.FLOAT32

    @property
    def guarded(self) -> bool:
        """Whether a sound server could move the stream."""
        return isinstance(self.target, ServerDevice)


@dataclass
class MeasurementStreams:
    """A `Transport` of real devices. One thread uses it."""

    pcms: PcmConfig  # OUTPUT and INPUT
    output: StreamEndpoint
    source: StreamEndpoint
    samplerate: int
    connection: PulseConnection | None  # None if neither stream is on a server
    progress: Callable[[float], None] = lambda share: None  # called while a measurement runs

    def run(self, exchange: Exchange) -> None:
        """Run both streams until the measurement ends; `exchange` keeps the reason."""
        with ExitStack() as stack:
            rate, out, source = self.samplerate, self.output, self.source
            # closed last, so that every exit, also Ctrl+C, leaves silence
            if out.guarded and self.connection is not None:
                stack.callback(FallbackSink(self.connection).close)
            outward, inward = self.pcms.pcms[OUTPUT], self.pcms.pcms[INPUT]
            outward.target, inward.target = out.target, source.target
            playback = PlaybackStream(
                outward,
                rate,
                out.channels,
                exchange.fill,
                block_frames=BLOCK_FRAMES,
                sample_format=out.sample_format,
            )
            stack.callback(playback.close)
            capture = CaptureStream(
                inward, rate, source.channels, exchange.on_frames, block_frames=BLOCK_FRAMES
            )
            stack.callback(capture.close)
            guards = []
            for stream, endpoint in ((playback, out), (capture, source)):
                if endpoint.guarded and self.connection is not None:
                    guard = StreamGuard(self.connection, stream, endpoint.name, any_source=True)
                    stack.callback(guard.release)
                    guards.append(guard)
                else:
                    stream.audible = True
            stack.callback(exchange.abort, LostError("the measurement was aborted"))
            watch = _Watch((playback, capture), guards, (out.name, source.name))
            watch.settle(exchange)
            while not exchange.ended.wait(_POLL_S):
                if error := watch.problem(time.monotonic()):
                    exchange.abort(error)
                self.progress(exchange.share_recorded)


@dataclass
class _Watch:
    streams: tuple[PlaybackStream, CaptureStream]
    guards: list[StreamGuard]
    names: tuple[str, str]

    def settle(self, exchange: Exchange) -> None:
        """Start the measurement when both run; LostError if that takes too long."""
        limit_s = time.monotonic() + SETTLE_S
        while not (
            all(guard.hold.audible for guard in self.guards)
            and all(stream.callbacks > 3 for stream in self.streams)
        ):
            if time.monotonic() > limit_s:
                held = [guard.hold.value for guard in self.guards if not guard.hold.audible]
                raise LostError(
                    f"{' and '.join(self.names)} do not run after {SETTLE_S:g} s "
                    f"({', '.join(held) or 'a device delivers nothing'}); check both, and try again"
                )
            exchange.ended.wait(_POLL_S)
        self._before = self._counts()
        exchange.begin()

    def _counts(self) -> list[tuple[int, int, int]]:
        return [(s.xruns, s.silenced, sum(s.errors.values())) for s in self.streams]

    def problem(self, now_s: float) -> CushionError | None:
        """Return the error that ends the measurement, or None."""
        for guard in self.guards:
            if not guard.hold.audible:
                return LostError(
                    f"the measurement ended: {guard.hold.value}; plug it in, and repeat"
                )
        each = zip(self.streams, self.names, self._before, self._counts(), strict=True)
        for stream, name, before, now in each:
            if stream.is_lost(now_s):
                return LostError(f"{name} went away during the sweep; plug it in again, and repeat")
            if now[0] > before[0] or now[1] > before[1]:
                late = "a block came too late during the sweep"
                return LostError(f"{name}: {late}; close other programs, and repeat")
            if now[2] > before[2]:
                kinds = ", ".join(stream.errors)
                return InternalError(f"{name}: {kinds} in a callback; please report it")
        return None
