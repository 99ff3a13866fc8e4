"""The state of a sound server at one moment, and its events. Any thread may use the objects."""

import ctypes
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from device.errors import LostError

NOWHERE = 0xFFFF_FFFF  # index that servers give for "none"
STREAMS = frozenset({"sink_input", "source_output"})  # event facilities: streams, not devices
HARDWARE_VOLUME, FLAT_VOLUMES = 0x01, 0x40  # flags of sinks, as in pulse/def.h
DEFAULT_SETTLES_S = 0.2  # time for which a new default sink must persist before it is reported


@dataclass(frozen=True)
class Sink:
    """A playback device. monitor: name of its monitor source.

    index: on the server, never reused. module: index of the module that made the sink, or None.
    channel_map: such as "front-left,front-right". volume_db: relative to 100 %. volume_in_monitor:
    whether the volume acts on the monitor's sound. flat_volumes: whether the volumes of the sink's
    streams include the sink's volume.
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
    def volume_percent(self) -> int:
        """The volume as sound settings show it."""
        return round(100.0 * math.pow(10.0, self.volume_db / 60.0))

    @property
    def weakened(self) -> str:
        """What lowers the sink's level: "muted" or, for example, "volume 30 %"; "" for nothing."""
        percent = self.volume_percent
        return "muted" if self.mute else f"volume {percent} %" if percent < 100 else ""

    @property
    def positions(self) -> tuple[str, ...]:
        """The names of its channels, in order; empty if unknown."""
        return tuple(self.channel_map.split(",")) if self.channel_map else ()


@dataclass(frozen=True)
class Source:
    """A recording device. monitor_of: the monitored sink's name or None. volume: 1.0 for 100 %."""

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

    device_index, device_name: None and "" without a device. corked: paused by the application.
    module: index of the module that made the stream, or None. volume_db: relative to 100 %.
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
    """The state of a server at one moment.

    kind, version: "PulseAudio" or "PipeWire", and its version. default_sink, default_source: names,
    "" for none. sinks, sources: playback and recording devices, monitors included.
    sink_inputs, source_outputs: playing and recording streams. events: number of the connection's
    events before the snapshot began; the snapshot may miss later events.
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

    def playing_to(self, name: str | None) -> list[Stream]:
        """Return the streams that play to the sink with this name now."""
        return [one for one in self.sink_inputs if one.device_name == name and not one.corked]


def patch_pulsectl(pulsectl: Any) -> None:
    """Make pulsectl read sample rates and any text, such as names that are not UTF-8.

    Its own field of sample rates points into freed memory. Wrong bytes of text become U+FFFD.
    """
    c = pulsectl._pulsectl
    get = ctypes.PyDLL("libpulse.so.0").pa_proplist_get
    get.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p, ctypes.c_void_p]

    def read(properties: Any, key: str) -> bytes:
        start, size = ctypes.c_void_p(), ctypes.c_size_t()
        get(properties, key.encode(), ctypes.byref(start), ctypes.byref(size))
        found = ctypes.string_at(start.value, size.value) if start.value else b""
        return found[:-1] if found.endswith(b"\0") else b""  # without it, binary data

    def keep(item: Any, struct: Any) -> None:
        item.samplerate = int(struct.sample_spec.rate) if struct else 0

    pulsectl.PulseSinkInfo._init_from_struct = keep
    pulsectl.PulseSourceInfo._init_from_struct = keep
    c.pa.proplist_gets = read  # that of libpulse returns no text that is not UTF-8
    c.force_str = lambda s, _="": s.decode("utf-8", "replace") if isinstance(s, bytes) else s


def take_snapshot(pulse: Any, events: int, known: ServerSnapshot | None = None) -> ServerSnapshot:
    """Return a snapshot from a connected pulsectl.Pulse. Only its thread may call this.

    events: number of events so far. known: a snapshot whose devices are reused if the default
    devices are the same. Streams are queried before devices, so that each stream's device is known.
    """
    sink_inputs, source_outputs = pulse.sink_input_list(), pulse.source_output_list()
    info = pulse.server_info()
    kind, version = _kind(info.server_name or "", info.server_version or "")
    defaults = default_name(info.default_sink_name), default_name(info.default_source_name)
    if known is not None and (known.default_sink, known.default_source) != defaults:
        known = None
    sinks = known.sinks if known else tuple(_sink(one, kind) for one in pulse.sink_list())
    names = {sink.index: sink.name for sink in sinks}
    sources = known.sources if known else tuple(_source(one, names) for one in pulse.source_list())
    source_names = {source.index: source.name for source in sources}
    playing = tuple(_stream(item, item.sink, names) for item in sink_inputs)
    recording = tuple(_stream(item, item.source, source_names) for item in source_outputs)
    return ServerSnapshot(kind, version, *defaults, sinks, sources, playing, recording, events)


def _kind(name: str, version: str) -> tuple[str, str]:
    """Return kind and version. name: such as "pulseaudio" or "PulseAudio (on PipeWire 0.3.65)"."""
    _, on, pipewire = name.partition("(on PipeWire")
    return ("PipeWire", pipewire.strip(" )")) if on else ("PulseAudio", version)


def default_name(name: str | None) -> str:
    """Return the name of a default device; PipeWire reports "@DEFAULT_SINK@" for no sink."""
    return "" if name is None or name.startswith("@") else name


def _sink(item: Any, kind: str) -> Sink:
    by_property = item.proplist.get("monitor.channel-volumes") == "true"
    return Sink(
        monitor=item.monitor_source_name or "",
        module=_known(item.owner_module),
        volume_db=decibels(_loudest(item)),
        volume_in_monitor=by_property if kind == "PipeWire" else not item.flags & HARDWARE_VOLUME,
        flat_volumes=bool(item.flags & FLAT_VOLUMES),
        **_device(item),
    )


def _source(item: Any, names: Mapping[int, str]) -> Source:
    monitor_of = names.get(item.monitor_of_sink)
    return Source(monitor_of=monitor_of, volume=_loudest(item), **_device(item))


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
        # on PulseAudio, the owner module of an application's stream is that of its connection
        module=_known(item.owner_module) if _known(item.client) is None else None,
        volume_db=decibels(_loudest(item)),
    )


def _loudest(item: Any) -> float:
    return float(max(item.volume.values, default=1.0))


def _known(index: int) -> int | None:
    return None if index == NOWHERE else index


def decibels(volume: float) -> float:
    """Return a server's volume in dB: 60 log10 of the volume, which is 1.0 at 0 dB."""
    return 60.0 * math.log10(volume) if volume > 0.0 else -math.inf


@dataclass(frozen=True)
class Event:
    """A change on the server. number: position among this connection's events, from 1.

    facility: such as "sink_input" or "server". kind: "new", "change" or "remove".
    """

    facility: str
    kind: str
    index: int
    number: int


class Listener:
    """Receives the reports of a `PulseConnection`, on the connection's thread.

    The methods must return at once, query no server and raise no exceptions.
    """

    def on_event(self, event: Event) -> bool:
        """Handle an event at once; return True to request a snapshot now instead of later."""
        return False

    def on_snapshot(self, snapshot: ServerSnapshot) -> None:
        """Handle a new snapshot, taken after events or a request."""

    def on_default_sink(self, name: str) -> None:
        """Handle a default sink that has persisted for DEFAULT_SETTLES_S; "" for none."""

    def on_lost(self, error: LostError) -> None:
        """Handle the loss of the server; no other call follows."""


# Latency in blocks by kind of server, as measured; PipeWire itself reports 0.
_TAP_BLOCKS, _OUTPUT_BLOCKS = {"PipeWire": 1.0}, {"PulseAudio": 1.0, "PipeWire": 2.0}


def tap_latency_s(snapshot: ServerSnapshot, block_frames: int, samplerate: int) -> float:
    """Return the time in s from the server's mixing of a frame until a capture delivers it."""
    return _TAP_BLOCKS.get(snapshot.kind, 0.0) * block_frames / samplerate


def output_latency_s(snapshot: ServerSnapshot, block_frames: int, samplerate: int) -> float:
    """Return the time in s from a stream's request for a frame until the server mixes the frame."""
    return _OUTPUT_BLOCKS.get(snapshot.kind, 0.0) * block_frames / samplerate
