"""What a sound server holds at one moment, in plain values that any thread may keep and read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from device.errors import LostError

NOWHERE = 0xFFFF_FFFF
"""The index that servers give for "none"."""


@dataclass(frozen=True)
class Sink:
    """A place to play to. index: the server's, never used twice; monitor: its monitor's name.

    properties: as the server has them, all text. module: index of the module that made it, None
    if none did. samplerate in Hz. channel_map: "front-left,front-right" and the like.
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

    @property
    def positions(self) -> tuple[str, ...]:
        """What its channels are called, in their order; nothing where that is not told."""
        return tuple(self.channel_map.split(",")) if self.channel_map else ()


@dataclass(frozen=True)
class Source:
    """A place to record from. monitor_of: the name of the sink that it monitors, None if none.

    channel_map: as of a `Sink`. volume: the server's number, 1.0 for 100 %; mute: whether it is.
    """

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
    """A stream of an application: a sink input (it plays) or a source output (it records).

    place: the index of its sink or source, None while it has none; device_name: the name, "" if
    that is unknown. application, binary, role, media: "" where the application does not say.
    process_id: None where it does not say. corked: paused by the application. module: index of the
    module that made it, None for an application's.
    """

    index: int
    place: int | None
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


@dataclass(frozen=True)
class ServerSnapshot:
    """Everything at one moment.

    kind: "PulseAudio" or "PipeWire"; version: of that. default_sink, default_source: names, ""
    if there is none. sink_inputs: what plays; source_outputs: what records. events: how many
    events the connection had had when it began to ask, so that whoever saw a later one knows that
    it may not be in here.
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

    def sink(self, index: int | None) -> Sink | None:
        """The sink with this index."""
        return next((sink for sink in self.sinks if sink.index == index), None)


def keep_samplerates(pulsectl: Any) -> None:
    """Let pulsectl keep the samplerates of sinks and sources; once, before the first snapshot.

    What it keeps of them by itself points into memory that libpulse frees at once.
    """

    def keep(item: Any, struct: Any) -> None:
        item.samplerate = int(struct.sample_spec.rate) if struct else 0

    pulsectl.PulseSinkInfo._init_from_struct = keep
    pulsectl.PulseSourceInfo._init_from_struct = keep


def take_snapshot(pulse: Any, events: int) -> ServerSnapshot:
    """Ask a connected pulsectl.Pulse for everything; on the thread that owns it, a few ms.

    Streams are asked for first: one that moves meanwhile then appears in a place that exists.
    """
    sink_inputs, source_outputs = pulse.sink_input_list(), pulse.source_output_list()
    sinks, sources = pulse.sink_list(), pulse.source_list()
    info = pulse.server_info()
    kind, version = _kind(info.server_name or "", info.server_version or "")
    sink_names = {sink.index: sink.name for sink in sinks}
    source_names = {source.index: source.name for source in sources}
    return ServerSnapshot(
        kind=kind,
        version=version,
        default_sink=default_name(info.default_sink_name),
        default_source=default_name(info.default_source_name),
        sinks=tuple(_sink(sink) for sink in sinks),
        sources=tuple(_source(source, sink_names) for source in sources),
        sink_inputs=tuple(_stream(item, item.sink, sink_names) for item in sink_inputs),
        source_outputs=tuple(_stream(item, item.source, source_names) for item in source_outputs),
        events=events,
    )


def _kind(name: str, version: str) -> tuple[str, str]:
    """Kind and version from "pulseaudio" and "16.1", or "PulseAudio (on PipeWire 0.3.65)"."""
    _, on, pipewire = name.partition("(on PipeWire")
    if on:
        return "PipeWire", pipewire.strip(" )")
    return "PulseAudio", version


def default_name(name: str | None) -> str:
    """A default's name; PipeWire gives names like "@DEFAULT_SINK@" where there is none."""
    return "" if name is None or name.startswith("@") else name


def _sink(item: Any) -> Sink:
    return Sink(
        index=item.index,
        name=item.name,
        description=item.description or "",
        monitor=item.monitor_source_name or "",
        samplerate=item.samplerate,
        channels=item.channel_count,
        module=_known(item.owner_module),
        properties=dict(item.proplist),
        channel_map=",".join(item.channel_list),
    )


def _source(item: Any, sink_names: Mapping[int, str]) -> Source:
    monitored = item.monitor_of_sink
    return Source(
        index=item.index,
        name=item.name,
        description=item.description or "",
        monitor_of=None if monitored == NOWHERE else sink_names.get(monitored),
        samplerate=item.samplerate,
        channels=item.channel_count,
        properties=dict(item.proplist),
        channel_map=",".join(item.channel_list),
        volume=float(item.volume.value_flat),
        mute=bool(item.mute),
    )


def _stream(item: Any, place: int, names: Mapping[int, str]) -> Stream:
    properties = dict(item.proplist)
    process_id = properties.get("application.process.id", "")
    return Stream(
        index=item.index,
        place=_known(place),
        device_name=names.get(place, ""),
        application=properties.get("application.name", ""),
        binary=properties.get("application.process.binary", ""),
        role=properties.get("media.role", ""),
        media=properties.get("media.name", item.name or ""),
        process_id=int(process_id) if process_id.isdecimal() else None,
        corked=item.corked,
        mute=bool(item.mute),
        properties=properties,
        # PulseAudio calls the module that an application is connected by its owner
        module=_known(item.owner_module) if _known(item.client) is None else None,
    )


def _known(index: int) -> int | None:
    return None if index == NOWHERE else index


DEFAULT_SETTLES_S = 0.2
"""How long the default sink must have stayed the same until that is told."""


@dataclass(frozen=True)
class Event:
    """Something of the server changed; number: counts the events of this connection, from 1.

    facility: "sink", "source", "sink_input", "source_output", "server" and others; kind: "new",
    "change" or "remove"; index: which one.
    """

    facility: str
    kind: str
    index: int
    number: int


class Listener:
    """What a `PulseConnection` tells; all methods do nothing here.

    The connection's own thread calls them: they must return at once, ask nothing of the
    connection, and not raise.
    """

    def on_event(self, event: Event) -> bool:
        """An event has come, this moment: nothing but its numbers is known yet.

        True asks for a snapshot at once; else one follows when the next ones have been gathered.
        """
        return False

    def on_snapshot(self, snapshot: ServerSnapshot) -> None:
        """Everything was asked for again, after events."""

    def on_default_sink(self, name: str) -> None:
        """The default sink is another one, and has stayed it for DEFAULT_SETTLES_S; "": none."""

    def on_lost(self, error: LostError) -> None:
        """The server is gone: the last that this connection tells."""


def backoff_s(attempt: int) -> float:
    """How long to wait before attempt 1, 2, 3 ... of connecting again: 0.1 s, doubling to 2 s."""
    return float(min(0.1 * 2 ** min(max(attempt - 1, 0), 10), 2.0))


_BLOCKS = {"PulseAudio": (0.0, 1.0), "PipeWire": (1.0, 2.0)}
"""Kind of server to blocks in the tap and in the output.

PipeWire hands over what it mixed one cycle ago, and takes from a queue of two blocks. PulseAudio
mixes ahead, and asks once one of two blocks is left.
"""


def tap_latency_s(snapshot: ServerSnapshot, block_frames: int, samplerate: int) -> float:
    """Seconds from a frame's mixing until a capture of such blocks can have it. Any thread."""
    return _BLOCKS.get(snapshot.kind, (0.0, 0.0))[0] * block_frames / samplerate


def output_latency_s(snapshot: ServerSnapshot, block_frames: int, samplerate: int) -> float:
    """Seconds from a playback's asking for a frame until it is mixed. Any thread."""
    return _BLOCKS.get(snapshot.kind, (0.0, 0.0))[1] * block_frames / samplerate
