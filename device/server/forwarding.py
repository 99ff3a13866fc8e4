"""Drop-in mode's virtual sink and loopback on the server. Pure functions.

A later process reads the loopback's parameters from the properties of its two streams.
"""

from collections.abc import Collection
from dataclasses import dataclass

from device.errors import UsageError
from device.server.identity import identity_of, is_ours
from device.server.snapshot import ServerSnapshot, Sink, Stream
from device.stream.pcms import APPLICATION_NAME, FALLBACK_SINK

SINK = "cushion"  # name of the virtual sink
MIN_DELAY_S, MAX_DELAY_S = 0.02, 0.5  # at the shortest delay, both servers still play without gaps
MARK = "cushion.drop_in"  # property of the sink that this program makes
_TARGET, _RESTORE, _DELAY = "cushion.target", "cushion.restore", "cushion.delay_ms"


@dataclass(frozen=True)
class Route:
    """Parameters of a loopback. target: sink that plays its sound.

    restore: sink that becomes the default again when the loopback ends.
    """

    target: str
    restore: str
    delay_ms: int


@dataclass(frozen=True)
class Loopback:
    """A loopback of this program. complete: whether it links virtual sink and target."""

    module: int
    route: Route
    complete: bool


def round_delay_ms(delay_s: float | None) -> int:
    """Return a delay in whole ms, at least MIN_DELAY_S. UsageError: delay_s is out of range."""
    delay_s = MIN_DELAY_S if delay_s is None else delay_s
    if not 0.0 <= delay_s <= MAX_DELAY_S:
        raise UsageError(f"delay_s={delay_s!r} is out of range; choose 0 to {MAX_DELAY_S} s")
    return round(1e3 * max(delay_s, MIN_DELAY_S))


def loopbacks(snapshot: ServerSnapshot) -> list[Loopback]:
    """Return this program's loopbacks, including those of earlier processes, the newest last."""
    monitors = {source.index for source in snapshot.sources if source.monitor_of == SINK}
    taps, outs = (
        {one.module: one for one in streams if one.module is not None and _TARGET in one.properties}
        for streams in (snapshot.source_outputs, snapshot.sink_inputs)
    )
    found = []
    for module in sorted({*taps, *outs}):
        tap, out = taps.get(module), outs.get(module)
        known = (out or taps[module]).properties
        delay = known.get(_DELAY, "")
        delay_ms = int(delay) if delay.isdecimal() else 0
        route = Route(known[_TARGET], known.get(_RESTORE, ""), delay_ms)
        taps_us = tap is not None and tap.device_index in monitors
        plays = out is not None and out.device_name == route.target
        found.append(Loopback(module, route, taps_us and plays))
    return found


def is_application(stream: Stream) -> bool:
    """Whether a playing stream belongs neither to this program nor to one of its loopbacks."""
    return _TARGET not in stream.properties and not is_ours(stream)


def real_sinks(snapshot: ServerSnapshot, haptic_sink: str | None) -> list[str]:
    """Return the names of all possible targets; sinks of sound cards precede virtual sinks."""
    sinks = [sink for sink in snapshot.sinks if sink.name not in (SINK, FALLBACK_SINK, haptic_sink)]
    return [sink.name for sink in sorted(sinks, key=lambda sink: not identity_of(sink).bus)]


def reachable_sinks(snapshot: ServerSnapshot, target: str) -> set[str]:
    """Return the target, and all sinks but `SINK` to which modules forward the target's sound."""
    names = {target}
    while more := {
        stream.device_name
        for stream in snapshot.sink_inputs
        if stream.device_name not in (*names, SINK, "")
        and carries_sound_of(snapshot, stream, names)
    }:
        names |= more
    return names


def sinks_heard_on(snapshot: ServerSnapshot, target: str) -> set[str]:
    """Return the target, and all sinks whose sound modules forward to the target."""
    names = {sink.name for sink in snapshot.sinks}
    return {target} | {name for name in names if target in reachable_sinks(snapshot, name)}


def carries_sound_of(snapshot: ServerSnapshot, stream: Stream, sinks: Collection[str]) -> bool:
    """Whether a playing stream belongs to a module that forwards the sound of these sinks."""
    monitors = {source.index for source in snapshot.sources if source.monitor_of in sinks}
    inputs: list[Sink | Stream] = [sink for sink in snapshot.sinks if sink.name in sinks]
    inputs += [tap for tap in snapshot.source_outputs if tap.device_index in monitors]
    group = stream.properties.get("node.link-group")
    return any(
        (one.module is not None and one.module == stream.module)
        or (group is not None and one.properties.get("node.link-group") == group)
        for one in inputs
    )


def sink_arguments(snapshot: ServerSnapshot, target: Sink) -> list[str]:
    """Return the arguments of module-null-sink for a virtual sink with the target's format.

    Without norewinds=1 an idle PulseAudio would render 2 s ahead; a capture would be 2 s late.
    """
    own = ["format=float32le", "norewinds=1"] if snapshot.kind == "PulseAudio" else []
    properties = f"device.description='{APPLICATION_NAME}' {MARK}=1"
    return [f"sink_name={SINK}", *_format(target), *own, f'sink_properties="{properties}"']


def loopback_arguments(snapshot: ServerSnapshot, route: Route, sink: Sink) -> list[str]:
    """Return the arguments of module-loopback. sink: the virtual sink.

    The loopback's streams may not move, so that PulseAudio and PipeWire unload it when its target
    vanishes. If the streams could move, PipeWire would connect the loopback's output to the virtual
    sink, which is its input. After every few underruns, PulseAudio permanently adds 5 ms of delay;
    max_latency_msec limits this to 20 ms in all. UsageError: the name of a sink has a character
    that a module's arguments cannot contain.
    """
    for name in (route.target, route.restore):
        if not name.isprintable() or set(name) & set("\"'\\"):
            raise UsageError(
                f"sound cannot be forwarded to a sink called {name!r}: quotes, backslashes and "
                "control characters are not allowed; choose another sink"
            )
    bounds = [f"max_latency_msec={route.delay_ms + 20}", "fast_adjust_threshold_msec=100"]
    properties = (
        f"media.name='{APPLICATION_NAME}' {_TARGET}='{route.target}' {_RESTORE}='{route.restore}' "
        f"{_DELAY}={route.delay_ms}"
    )
    return [
        f"source={sink.monitor}",
        f'sink="{route.target}"',
        *_format(sink),
        f"latency_msec={route.delay_ms}",
        *(bounds if snapshot.kind == "PulseAudio" else []),
        "source_dont_move=true",
        "sink_dont_move=true",
        f'sink_input_properties="{properties}"',
        f'source_output_properties="{properties}"',
    ]


def _format(sink: Sink) -> list[str]:
    names = [f"channel_map={sink.channel_map}"] if sink.channel_map else []
    return [f"rate={sink.samplerate}", f"channels={sink.channels}", *names]
