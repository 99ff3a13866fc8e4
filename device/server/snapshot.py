"""The state of a sound server at one moment, and the events that change it.

All values are immutable: any thread may keep and read them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from device.errors import LostError

NOWHERE = 0xFFFF_FFFF  # the index that servers give for "none"
STREAMS = frozenset({"sink_input", "source_output"})  # events about them change no device
HARDWARE_VOLUME, FLAT_VOLUMES = 0x01, 0x40  # flags of sinks, as in pulse/def.h
DEFAULT_SETTLES_S = 0.2  # how long a new default sink must persist until it is reported


@dataclass(frozen=True)
class Sink:
    """A device to play to. monitor: name of its monitor source.

    index: the server's, never reused. module: index of the module that made it, or None.
    channel_map: such as "front-left,front-right". volume_db: 0 for 100 %. volume_in_monitor:
    whether its monitor carries this volume. flat_volumes: whether the volumes of streams that play
    to it contain its own.
    """

    index: int
    name: str
    description: str
    monitor: str
    samplerate: int
    channels: int
    module: int | None
    properties: Mapping[str, str]
    channel_map: str = ""
    volume_db: float = 0.0
    volume_in_monitor: bool = False
    flat_volumes: bool = False
    mute: bool = False

    @property
    def weakened(self) -> str:
        """What makes it softer: "muted", or such as "volume 30 %"; "" for neither."""
        percent = round(100.0 * 10.0 ** (self.volume_db / 60.0))
        return "muted" if self.mute else f"volume {percent} %" if percent < 100 else ""

    @property
    def positions(self) -> tuple[str, ...]:
        """The names of its channels, in order; empty if unknown."""
        return tuple(self.channel_map.split(",")) if self.channel_map else ()


@dataclass(frozen=True)
class Source:
    """A device to record from. monitor_of: name of its sink, or None. volume: 1.0 for 100 %."""

    index: int
    name: str
    description: str
    monitor_of: str | None
    samplerate: int
    channels: int
    properties: Mapping[str, str]
    channel_map: str = ""
    volume: float = 1.0
    mute: bool = False


@dataclass(frozen=True)
class Stream:
    """A sink input, which plays, or a source output, which records. Unknown text is "".

    device_index, device_name: None and "" while it has no device. corked: paused by the
    application. module: that made it; None for an application's. volume_db: 0 for 100 %.
    """

    index: int
    device_index: int | None
    device_name: str
    application: str
    binary: str
    role: str
    media: str
    process_id: int | None
    corked: bool
    mute: bool
    properties: Mapping[str, str]
    module: int | None = None
    volume_db: float = 0.0


@dataclass(frozen=True)
class ServerSnapshot:
    """Everything that a server holds at one moment.

    kind, version: "PulseAudio" or "PipeWire", and its version. default_sink, default_source: their
    names, "" for none. sinks, sources: devices to play to, and to record from, monitors included.
    sink_inputs, source_outputs: streams that play, and that record. events: of the connection
    before the snapshot began; later ones may not be included.
    """

    kind: str
    version: str
    default_sink: str
    default_source: str
    sinks: tuple[Sink, ...]
    sources: tuple[Source, ...]
    sink_inputs: tuple[Stream, ...]
    source_outputs: tuple[Stream, ...]
    events: int

    def sink(self, name: str | None) -> Sink | None:
        """Return the sink with exactly this name, or None."""
        return next((sink for sink in self.sinks if sink.name == name), None)


def patch_samplerates(pulsectl: Any) -> None:
    """Make pulsectl keep sample rates: its field for them points into memory that is freed."""

    def keep(item: Any, struct: Any) -> None:
        item.samplerate = int(struct.sample_spec.rate) if struct else 0

    pulsectl.PulseSinkInfo._init_from_struct = keep
    pulsectl.PulseSourceInfo._init_from_struct = keep


def take_snapshot(pulse: Any, events: int, known: ServerSnapshot | None = None) -> ServerSnapshot:
    """Query a connected pulsectl.Pulse, on its thread; `known` if only streams have changed since.

    Streams come first: one that moves in the meantime then appears on a device that exists.
    """
    sink_inputs, source_outputs = pulse.sink_input_list(), pulse.source_output_list()
    info = pulse.server_info()
    kind, version = _kind(info.server_name or "", info.server_version or "")
    defaults = default_name(info.default_sink_name), default_name(info.default_source_name)
    if known is not None and (known.default_sink, known.default_source) == defaults:
        sinks, sources = known.sinks, known.sources
    else:
        sinks = tuple(_sink(sink, kind) for sink in pulse.sink_list())
        names = {sink.index: sink.name for sink in sinks}
        sources = tuple(_source(source, names) for source in pulse.source_list())
    sink_names = {sink.index: sink.name for sink in sinks}
    source_names = {source.index: source.name for source in sources}
    return ServerSnapshot(
        kind,
        version,
        *defaults,
        sinks,
        sources,
        sink_inputs=tuple(_stream(item, item.sink, sink_names) for item in sink_inputs),
        source_outputs=tuple(_stream(item, item.source, source_names) for item in source_outputs),
        events=events,
    )


def _kind(name: str, version: str) -> tuple[str, str]:
    """Parse "pulseaudio" and "16.1", or "PulseAudio (on PipeWire 0.3.65)"."""
    _, on, pipewire = name.partition("(on PipeWire")
    return ("PipeWire", pipewire.strip(" )")) if on else ("PulseAudio", version)


def default_name(name: str | None) -> str:
    """Return a default's name; PipeWire gives names like "@DEFAULT_SINK@" for none."""
    return "" if name is None or name.startswith("@") else name


def _sink(item: Any, kind: str) -> Sink:
    if kind == "PipeWire":
        volume_in_monitor = item.proplist.get("monitor.channel-volumes") == "true"
    else:
        volume_in_monitor = not item.flags & HARDWARE_VOLUME
    return Sink(
        monitor=item.monitor_source_name or "",
        module=_known(item.owner_module),
        volume_db=decibels(_loudest(item)),
        volume_in_monitor=volume_in_monitor,
        flat_volumes=bool(item.flags & FLAT_VOLUMES),
        **_device(item),
    )


def _source(item: Any, sink_names: Mapping[int, str]) -> Source:
    return Source(
        monitor_of=sink_names.get(item.monitor_of_sink),
        volume=_loudest(item),
        **_device(item),
    )


def _device(item: Any) -> dict[str, Any]:
    return {
        "index": item.index,
        "name": item.name,
        "description": item.description or "",
        "samplerate": item.samplerate,
        "channels": item.channel_count,
        "properties": dict(item.proplist),
        "channel_map": ",".join(item.channel_list),
        "mute": bool(item.mute),
    }


def _stream(item: Any, device: int, names: Mapping[int, str]) -> Stream:
    properties = dict(item.proplist)
    process_id = properties.get("application.process.id", "")
    return Stream(
        index=item.index,
        device_index=_known(device),
        device_name=names.get(device, ""),
        application=properties.get("application.name", ""),
        binary=properties.get("application.process.binary", ""),
        role=properties.get("media.role", ""),
        media=properties.get("media.name", item.name or ""),
        process_id=int(process_id) if process_id.isdecimal() else None,
        corked=item.corked,
        mute=bool(item.mute),
        properties=properties,
        # for PulseAudio, an application's owner is the module of its connection
        module=_known(item.owner_module) if _known(item.client) is None else None,
        volume_db=decibels(_loudest(item)),
    )


def _loudest(item: Any) -> float:
    return float(max(item.volume.values, default=1.0))


def _known(index: int) -> int | None:
    return None if index == NOWHERE else index


def decibels(volume: float) -> float:
    """Return the dB of a server's volume, which is 1.0 at 0 dB: 60 log10 of it."""
    return 60.0 * math.log10(volume) if volume > 0.0 else -math.inf


@dataclass(frozen=True)
class Event:
    """A change on the server. number: counts this connection's events, from 1.

    facility: such as "sink_input" or "server". kind: "new", "change" or "remove".
    """

    facility: str
    kind: str
    index: int
    number: int


class Listener:
    """Receives the reports of a `PulseConnection`, on the connection's thread.

    The methods must return at once, must not query the connection and must not raise.
    """

    def on_event(self, event: Event) -> bool:
        """Handle an event at once; True asks for a snapshot now instead of a few ms later."""
        return False

    def on_snapshot(self, snapshot: ServerSnapshot) -> None:
        """Handle a new snapshot, which follows events."""

    def on_default_sink(self, name: str) -> None:
        """Handle a default sink that has been a new one for DEFAULT_SETTLES_S; "" is none."""

    def on_lost(self, error: LostError) -> None:
        """Handle the loss of the server, which is the last call."""


_BLOCKS = {"PulseAudio": (0.0, 1.0), "PipeWire": (1.0, 2.0)}
"""Kind of server: measured blocks of latency in tap and output. PipeWire itself reports 0."""


def tap_latency_s(snapshot: ServerSnapshot, block_frames: int, samplerate: int) -> float:
    """Return the seconds from a frame's mixing until a capture stream delivers it."""
    return _BLOCKS.get(snapshot.kind, (0.0, 0.0))[0] * block_frames / samplerate


def output_latency_s(snapshot: ServerSnapshot, block_frames: int, samplerate: int) -> float:
    """Return the seconds from a playback stream's request for a frame until its mixing."""
    return _BLOCKS.get(snapshot.kind, (0.0, 0.0))[1] * block_frames / samplerate
