"""`cushion calibrate` on real devices: opens the devices, and limits the level of the sweeps."""

import argparse
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace

from audioflinger_hook.cli.calibrate import Progress
from audioflinger_hook.cli.terminal import warn
from audioflinger_hook.cli.test_tone import free_card
from device import errors
from device.address import DeviceAddress
from device.alsa import find_capture, find_playback
from device.errors import LostError, NotFoundError, UsageError
from device.identification.calibration import Calibration, calibrate
from device.identification.live.exchange import Exchange
from device.identification.live.laboratory import UNUSED, Devices, Inputs, LiveLaboratory
from device.identification.output_error import Estimate
from device.identification.recording import Sweep
from device.identification.simulated_laboratory import LARGEST_SHARE, sweep_at_excursion
from device.rig import Rig
from device.server import PulseConnection
from device.server.guard import FallbackSink, Hold, StreamGuard
from device.server.identity import find_source, is_cushion_stream
from device.server.snapshot import Sink, Source
from device.stream import PcmConfig, filter_stderr
from device.stream.pcms import ServerDevice, Target
from device.stream.sample_format import SampleFormat
from device.stream.streams import CaptureStream, PlaybackStream
from device.values import counted

OUTPUT, INPUT = "cushion_output", "cushion_input"  # ALSA PCMs that the caller must configure
SETTLE_S = 5.0  # longest time until both streams run

BLOCK_FRAMES = 1024  # long, because latency is irrelevant and a late block ends the measurement
_POLL_S = 0.02


@dataclass(frozen=True)
class StreamEndpoint:
    """The device and the format of one stream."""

    target: Target
    name: str  # name in messages
    channels: int
    connection: PulseConnection | None = None  # to a server, which could move the stream
    sample_format: SampleFormat = SampleFormat.FLOAT32


@dataclass
class MeasurementStreams:
    """Plays a sweep and records it. A late block or a lost device is an error."""

    pcms: PcmConfig  # OUTPUT and INPUT
    output: StreamEndpoint
    source: StreamEndpoint
    samplerate: int
    progress: Callable[[float], None] = lambda share: None  # called repeatedly during a measurement

    def run(self, exchange: Exchange) -> None:
        """Run both streams until the measurement ends. `exchange` stores any error of the sweep."""
        with ExitStack() as stack:
            rate, out, source = self.samplerate, self.output, self.source
            # The fallback sink closes last, so that every exit, including Ctrl+C, leaves silence.
            if out.connection:
                stack.callback(FallbackSink(out.connection).close)
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
                if endpoint.connection:
                    guard = StreamGuard(endpoint.connection, stream, endpoint.name, any_source=True)
                    stack.callback(guard.release)
                    guards.append(guard)
                else:
                    stream.audible = True
            stack.callback(exchange.abort, LostError("the measurement was aborted"))
            self._streams, self._guards = (playback, capture), guards
            self._settle(exchange)
            while not exchange.ended.wait(_POLL_S):
                if error := self._problem(time.monotonic()):
                    exchange.abort(error)
                self.progress(exchange.share_recorded)

    def _settle(self, exchange: Exchange) -> None:
        """Start the sweep when both streams run. LostError: one does not run within SETTLE_S."""
        limit_s = time.monotonic() + SETTLE_S
        while not (
            all(guard.hold.audible for guard in self._guards)
            and all(stream.callbacks > 3 for stream in self._streams)
        ):
            if time.monotonic() > limit_s:
                held = [guard.hold.value for guard in self._guards if not guard.hold.audible]
                raise LostError(
                    f"{self.output.name} and {self.source.name} do not run after {SETTLE_S:g} s "
                    f"({', '.join(held) or 'a device delivers nothing'}); check both, and try again"
                )
            exchange.ended.wait(_POLL_S)
        self._before = self._counts()
        exchange.begin()

    def _counts(self) -> list[tuple[int, int, int]]:
        return [(s.xruns, s.silenced, sum(s.errors.values())) for s in self._streams]

    def _problem(self, now_s: float) -> errors.CushionError | None:
        """Return the error that ends the measurement, or None."""
        for guard in self._guards:
            if guard.hold is Hold.NO_STREAM:  # for a moment after a late block, too
                why = f"{guard.hold.value}; plug the device in"
                return errors.BrokenStreamError(f"the sweep ended: {why}, and repeat")
            if not guard.hold.audible:
                return LostError(f"the sweep ended: {guard.hold.value}; plug it in, and repeat")
        names = self.output.name, self.source.name
        each = zip(self._streams, names, self._before, self._counts(), strict=True)
        for stream, name, before, now in each:
            if stream.is_lost(now_s):
                return LostError(f"{name} went away during the sweep; plug it in again, and repeat")
            if now[0] > before[0] or now[1] > before[1]:
                late = "a block came too late during the sweep"
                return errors.BrokenStreamError(f"{name}: {late}; close other programs, and repeat")
            if now[2] > before[2]:
                kinds = ", ".join(stream.errors)
                return errors.InternalError(f"{name}: {kinds} in a callback; please report it")
        return None


USUAL_LEVEL, MOST_LEVEL = 0.05, 0.25  # share of full scale: default, and limit without --loud
RATE_HZ = 48_000
WEIGHED_SHARE = 0.02  # half-width of a weighed mass's interval, as a share of the mass
INPUT_GRAMMAR = "source:NAME or hw:CARD[,DEVICE]"

_QUAD = "front-left,front-right,rear-left,rear-right"
PLAIN_MAPS = {
    1: "mono",
    2: "front-left,front-right",
    4: _QUAD,
    6: f"{_QUAD},front-center,lfe",
    8: f"{_QUAD},front-center,lfe,side-left,side-right",
}
"""Channel positions that ALSA's server plugin requests, keyed by channel count. If a device has
other positions, the server mixes its channels.
"""

_HAS_TO_BE_KNOWN = (
    *("dac.full_scale_v", "amplifier.gain", "actuator.moving_mass_kg", "actuator.resonance_hz"),
    *("actuator.q_mechanical", "actuator.force_factor_n_per_a", "actuator.resistance_ohm"),
    "actuator.x_max_m",
)


def calibrate_live(
    device: DeviceAddress, rig: Rig, sweep: Sweep, options: argparse.Namespace, progress: Progress
) -> tuple[Calibration, Devices]:
    """Identify the rig that is connected to this device. Record only the input of `--input`."""
    if device.kind not in ("sink", "usb", "hw"):
        allowed = "sink:NAME, usb:VID:PID, hw:CARD, twin"
        raise NotFoundError(f"device {str(device)!r} cannot be calibrated; allowed: {allowed}")
    if options.share is not None or options.seat:
        raise UsageError("--share and --seat are only for twin; choose --level of full scale")
    inputs = _inputs(options)
    sweep = levelled(rig, sweep, options)
    weighed, mass = None, options.moving_mass_kg
    if mass is not None:
        if not 0.0 < mass < 1e3:
            raise UsageError(f"moving-mass-kg={mass!r} must be above 0; weigh the moving part")
        weighed = Estimate(mass, mass, mass).widen(WEIGHED_SHARE)
    source = options.input
    with ExitStack() as stack:
        filter_stderr()
        pcms = stack.enter_context(closing(PcmConfig(OUTPUT, INPUT)))
        connection = None
        if device.kind != "hw" or source.startswith("source:"):
            connection = stack.enter_context(closing(PulseConnection()))
        output, rate = _output(device, connection)
        heard, rate = _input(source, connection, len(inputs.names), output, rate)
        channel = options.output_channel
        if not 1 <= channel <= output.channels:
            raise UsageError(f"output-channel={channel}: {output.name} has 1 to {output.channels}")
        unused = [UNUSED] * (heard.channels - len(inputs.names))
        inputs = replace(inputs, names=(*inputs.names, *unused))
        transport = MeasurementStreams(pcms, output, heard, rate, progress.within)
        laboratory = LiveLaboratory(transport, inputs, channel - 1, rig.amplifier)
        found = calibrate(
            laboratory,
            rig,
            replace(sweep, samplerate=rate),
            progress.begin,
            pairs=inputs.pairs,
            scaled=inputs.acceleration_scaled,
            weighed=weighed,
        )
    if laboratory.current_turned:
        warn("the current's sign was inverted, as a coil absorbs power; swap the shunt's two wires")
    if laboratory.repeated:
        warn(f"repeated for lost frames: {counted(laboratory.repeated, 'sweeps')}")
    drift = laboratory.drift.value if laboratory.drift else 0.0
    return found, Devices(output.name, heard.name, laboratory.delay_s, drift)


def _inputs(options: argparse.Namespace) -> Inputs:
    if not options.input or not options.channels:
        raise UsageError(
            f"no --input or --channels; give --input {INPUT_GRAMMAR}, and --channels such as "
            "acceleration,current,voltage; cushion never chooses an input itself"
        )
    kind, colon, name = options.input.partition(":")
    if kind not in ("source", "hw") or not colon or not name.strip():
        raise UsageError(f"input {options.input!r} is not known; allowed: {INPUT_GRAMMAR}")
    mv = options.acceleration_mv_per_m_s2
    return Inputs.parse(
        options.channels,
        full_scale_v=options.input_full_scale_v,
        acceleration_v_per_m_s2=None if mv is None else 1e-3 * mv,
        shunt_ohm=options.shunt_ohm,
        voltage_ratio=options.voltage_ratio,
    )


def levelled(rig: Rig, sweep: Sweep, options: argparse.Namespace) -> Sweep:
    """Return the sweep with the level of `--level`. UsageError: the level is out of range.

    If the rig's values are known, the excursion is limited to 0.15 of the rated excursion Xmax.
    """
    level = USUAL_LEVEL if options.level is None else options.level
    most = 1.0 if options.loud else MOST_LEVEL
    if not 0.0 < level <= most:
        hint = "" if options.loud else f"; above {MOST_LEVEL} only with --loud"
        raise UsageError(f"level={level!r} of full scale must be above 0, up to {most:g}{hint}")
    sweep = replace(sweep, level=level)
    if set(_HAS_TO_BE_KNOWN) & set(rig.assumed()):
        return sweep
    allowed = sweep_at_excursion(rig, sweep, LARGEST_SHARE)
    if allowed.level < level:
        warn(
            f"level {level:g} would move more than {LARGEST_SHARE} Xmax of rig {rig.name!r}; "
            f"{allowed.level:.4f} is taken"
        )
        return allowed
    return sweep


def _output(
    device: DeviceAddress, connection: PulseConnection | None
) -> tuple[StreamEndpoint, int]:
    """Return the device that plays the sweep, and its sample rate in Hz."""
    if device.kind == "hw":
        playback = find_playback(device.name)
        card, choice = free_card(playback, RATE_HZ, 1)
        name, sample_format = str(playback), choice.sample_format
        output = StreamEndpoint(card, name, choice.channels, sample_format=sample_format)
        return output, choice.samplerate
    assert connection is not None
    sink = device.sink(connection.latest)
    others = [
        "cushion run" if is_cushion_stream(stream) else stream.application or "another program"
        for stream in connection.latest.playing_to(sink.name)
    ]
    if others:
        raise UsageError(f"{', '.join(others)} plays to {sink.name!r}; end it first")
    return _on_server(sink, connection), RATE_HZ


def _on_server(device: Sink | Source, connection: PulseConnection) -> StreamEndpoint:
    return StreamEndpoint(ServerDevice(device.name), device.name, device.channels, connection)


def _input(
    source: str, connection: PulseConnection | None, needed: int, output: StreamEndpoint, rate: int
) -> tuple[StreamEndpoint, int]:
    """Return the device that records, and the sample rate of both devices in Hz."""
    kind, _, name = source.partition(":")
    if kind == "source":
        assert connection is not None
        found = find_source(connection.latest, name)
        if found.monitor_of == output.name:
            raise UsageError(
                f"input {source!r} is the monitor of the output itself, not of the cushion; "
                "name the input that the accelerometer or the shunt is connected to"
            )
        if needed > found.channels:
            raise UsageError(f"{needed} channels are named, input {source!r} has {found.channels}")
        if found.mute:
            raise UsageError(f"input {source!r} is muted; unmute it")
        if abs(found.volume - 1.0) > 0.005:
            warn(
                f"the volume of input {source!r} is {100 * found.volume:.0f} %, so voltages "
                "are correct only if the input's full scale was measured at this volume"
            )
        if found.channel_map != PLAIN_MAPS.get(found.channels):
            raise UsageError(
                f"the sound server mixes the channels {found.channel_map} of input {source!r}; "
                "name the card itself, as hw:CARD, or choose another profile of it"
            )
        return _on_server(found, connection), rate
    capture = find_capture(name)
    card, choice = free_card(capture, rate, needed, needed)
    if choice.samplerate != rate and output.connection is None:
        raise UsageError(
            f"{output.name} plays at {rate} Hz and {capture} records at {choice.samplerate} Hz; "
            "name the sound server's sink or source for one of them"
        )
    return StreamEndpoint(card, str(capture), choice.channels), choice.samplerate
