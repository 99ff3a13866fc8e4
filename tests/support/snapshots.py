"""Sinks, sources, streams and snapshots of a sound server, with usual values for the rest."""

from typing import Any

from device.server.snapshot import ServerSnapshot, Sink, Source, Stream


def sink(index: int, name: str, properties: dict[str, str] | None = None, **more: Any) -> Sink:
    """Return a stereo sink at 48 kHz that no module made."""
    known: dict[str, Any] = {"module": None, "properties": properties or {}}
    return Sink(index, name, name, f"{name}.monitor", 48_000, 2, **(known | more))


def source(index: int, name: str, monitor_of: str | None = None, **more: Any) -> Source:
    """Return a stereo source at 48 kHz: a microphone, or the monitor of a sink."""
    return Source(index, name, name, monitor_of, 48_000, 2, {}, **more)


def monitor(one: Sink, index: int | None = None) -> Source:
    return source(one.index if index is None else index, one.monitor, one.name)


def stream(index: int, on: int | None = None, device_name: str = "", **more: Any) -> Stream:
    """Return a stream without names on the device with the index `on`."""
    known: dict[str, Any] = dict.fromkeys(("application", "binary", "role", "media"), "")
    known |= {"process_id": None, "corked": False, "mute": False, "properties": {}}
    return Stream(index, on, device_name, **(known | more))


def snapshot(kind: str = "PulseAudio", **more: Any) -> ServerSnapshot:
    """Return a snapshot that is empty but for `more`."""
    known: dict[str, Any] = {"version": "", "default_sink": "", "default_source": "", "events": 0}
    known |= dict.fromkeys(("sinks", "sources", "sink_inputs", "source_outputs"), ())
    return ServerSnapshot(kind, **(known | more))
