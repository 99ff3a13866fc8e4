"""The volume that the server has applied to captured sound, in dB."""

import math
from collections.abc import Collection

from device.server.snapshot import NOWHERE, ServerSnapshot, Source, decibels

APART_DB = 20.0  # a stream that is louder by more than this would cause far too strong vibration


class TapVolume:
    """Determines the volume of the sound in one tap (capture). Only one thread may use it.

    If several streams play, the stream of the previous call still determines the volume. If it no
    longer plays, the oldest stream does. Therefore a short notification has no effect. If another
    stream's volume is higher by more than `APART_DB`, the highest volume is used.
    """

    def __init__(self) -> None:
        self._stream, self._stream_db = NOWHERE, 0.0

    def follow(
        self, snapshot: ServerSnapshot, players: Collection[int], monitor: Source | None = None
    ) -> float:
        """Return the volume in dB. While no stream plays, the last stream's volume is used.

        players: indices of the streams that play into the tap. monitor: the captured monitor; None
        if streams are captured directly.
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
            if (sink := snapshot.sink(stream.device_name)) is not None and sink.flat_volumes:
                self._stream_db -= sink.volume_db
        return self._stream_db + (monitor_volume_db(snapshot, monitor) if monitor else 0.0)


def monitor_volume_db(snapshot: ServerSnapshot, monitor: Source) -> float:
    """Return the volume in dB that a monitor adds to the volume of its streams."""
    sink = snapshot.sink(monitor.monitor_of)
    carried_db = sink.volume_db if sink is not None and sink.volume_in_monitor else 0.0
    return carried_db + decibels(monitor.volume)


def muted_sink(snapshot: ServerSnapshot, sink_name: str | None) -> str:
    """Return the name of the sink if it is muted or at 0 %; else ""."""
    sink = snapshot.sink(sink_name)
    return sink.name if sink and (sink.mute or sink.volume_db == -math.inf) else ""
