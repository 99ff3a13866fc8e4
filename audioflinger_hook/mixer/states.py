"""The states of a track and how requests change them; no sound, no threads."""

from __future__ import annotations

from enum import Enum


class TrackState(Enum):
    """Where a track stands. Only the mixer's thread moves it on."""

    IDLE = "idle"
    """Made, never started."""
    ACTIVE = "active"
    """Playing, or filling up to the start threshold."""
    PAUSING = "pausing"
    """Its next buffer ramps down."""
    PAUSED = "paused"
    """Silent; what is left in the ring stays."""
    RESUMING = "resuming"
    """Its next buffer ramps up."""
    STOPPING = "stopping"
    """Playing what was written before the stop."""
    STOPPED = "stopped"
    """Played to the end."""
    FLUSHED = "flushed"
    """What was written before the flush has been dropped."""


class Request(Enum):
    """What a client asks of its track."""

    START = "start"
    PAUSE = "pause"
    STOP = "stop"
    FLUSH = "flush"
    REMOVE = "remove"


# No set: every look into one would run Enum's own hash function, in Python.
PLAYING = (TrackState.ACTIVE, TrackState.PAUSING, TrackState.RESUMING, TrackState.STOPPING)
"""The states in which a track may be part of the mix."""

_S, _R = TrackState, Request
_AFTER = {
    (_S.IDLE, _R.START): _S.ACTIVE,
    (_S.STOPPED, _R.START): _S.ACTIVE,
    (_S.FLUSHED, _R.START): _S.ACTIVE,
    (_S.STOPPING, _R.START): _S.ACTIVE,
    (_S.PAUSED, _R.START): _S.RESUMING,
    (_S.PAUSING, _R.START): _S.RESUMING,
    (_S.ACTIVE, _R.PAUSE): _S.PAUSING,
    (_S.RESUMING, _R.PAUSE): _S.PAUSING,
    (_S.ACTIVE, _R.STOP): _S.STOPPING,
    (_S.RESUMING, _R.STOP): _S.STOPPING,
    (_S.PAUSING, _R.STOP): _S.STOPPED,
    (_S.PAUSED, _R.STOP): _S.STOPPED,
    (_S.IDLE, _R.FLUSH): _S.FLUSHED,
    (_S.PAUSING, _R.FLUSH): _S.FLUSHED,
    (_S.PAUSED, _R.FLUSH): _S.FLUSHED,
    (_S.STOPPING, _R.FLUSH): _S.FLUSHED,
    (_S.STOPPED, _R.FLUSH): _S.FLUSHED,
    (_S.ACTIVE, _R.REMOVE): _S.PAUSING,
    (_S.RESUMING, _R.REMOVE): _S.PAUSING,
}


def after(state: TrackState, request: Request) -> TrackState:
    """The state that a request leads to; the same one where it means nothing.

    As in AudioFlinger: a playing track ignores a flush, a draining one ignores a pause. A stop
    from a pause drops what is left.
    """
    return _AFTER.get((state, request), state)
