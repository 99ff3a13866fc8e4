"""The volume that a tap's sound carries, as far as the server knows it."""

from __future__ import annotations

import math
from collections.abc import Collection

from device.server.snapshot import NOWHERE, ServerSnapshot, Source, decibels

APART_DB = 20.0  # a stream that is turned up so much more would be far too strong


class TapVolume:
    """Follows the volumes that lower or raise the sound of one tap. For one thread.

    Volumes of several streams cannot be separated in their mix. The one that has played longest
    counts as long as it plays, so that a short notification changes nothing. While another one is
    turned up by over `APART_DB` more, that one counts.
    """

    def __init__(self) -> None:
        self._stream = NOWHERE
        self._stream_db = 0.0

    def follow(
        self, snapshot: ServerSnapshot, players: Collection[int], monitor: Source | None = None
    ) -> float:
        """Return the volume in dB; a stream's counts until another one plays.

        players: indices of the streams that play into the tap. monitor: the captured one; None for
        the streams themselves.
        """
        streams = {
            stream.index: stream
            for stream in snapshot.sink_inputs
            if stream.index in players and not stream.mute and math.isfinite(stream.volume_db)
        }
        if streams:
            self._stream = self._stream if self._stream in streams else min(streams)
            stream = streams[self._stream]
            loudest = max(streams.values(), key=lambda one: one.volume_db)
            if loudest.volume_db > stream.volume_db + APART_DB:
                stream = loudest
            self._stream_db = stream.volume_db
            sink = snapshot.sink(stream.device_name)
            if sink is not None and sink.flat_volumes:
                self._stream_db -= sink.volume_db
        return self._stream_db + (monitor_volume_db(snapshot, monitor) if monitor else 0.0)


def monitor_volume_db(snapshot: ServerSnapshot, monitor: Source) -> float:
    """Return the volume that a monitor's sound has beyond that of the streams, in dB."""
    sink = snapshot.sink(monitor.monitor_of)
    carried_db = sink.volume_db if sink is not None and sink.volume_in_monitor else 0.0
    return carried_db + decibels(monitor.volume)


def muted_sink(snapshot: ServerSnapshot, sink_name: str | None) -> str:
    """Return the name of the sink if it is muted or at 0 %; "" for others."""
    sink = snapshot.sink(sink_name)
    return sink.name if sink and (sink.mute or sink.volume_db == -math.inf) else ""
