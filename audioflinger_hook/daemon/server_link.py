"""The supervisor's connection to the sound server, made again after each loss."""

from __future__ import annotations

from collections.abc import Callable

from audioflinger_hook.daemon.timing import Backoff
from device.errors import CushionError, LostError
from device.server import FallbackSink, PulseConnection, ServerSnapshot
from device.server.snapshot import Listener


class ServerLink(Listener):
    """Connection to the server and its silent fallback sink. For the supervising thread alone.

    ring: called by another thread when the server changes or is lost. fallback: whether to make the
    sink. connection: None if not connected; it may be lost, see `lost`.
    """

    def __init__(self, ring: Callable[[], None], *, fallback: bool = True) -> None:
        self.connection: PulseConnection | None = None
        self._ring = ring
        self._has_fallback = fallback
        self._fallback: FallbackSink | None = None
        self._backoff = Backoff()

    def on_snapshot(self, snapshot: ServerSnapshot) -> None:
        """Wake the main thread for a change."""
        self._ring()

    def on_lost(self, error: LostError) -> None:
        """Wake the main thread for the loss of the server."""
        self._ring()

    @property
    def latest(self) -> ServerSnapshot | None:
        """The server as last seen, None if not connected."""
        return self.connection.latest if self.connection else None

    @property
    def lost(self) -> str:
        """Why the connection was lost; "" if it works, or if there is none."""
        return str((self.connection and self.connection.lost) or "")

    @property
    def warning(self) -> str:
        """One line on what would fail if the haptic device vanished; usually ""."""
        fallback, connection = self._fallback, self.connection
        if fallback is None or connection is None or fallback.active:
            return ""
        return "" if connection.latest.kind == "PipeWire" else fallback.reason

    def open(self, now_s: float) -> bool:
        """Connect if not connected and an attempt is due; return whether a connection was made.

        CushionError: the server cannot be reached.
        """
        if self.connection is not None or self._backoff.wait_s(now_s) > 0.0:
            return False
        try:
            self.connection = PulseConnection(self)
            if self._has_fallback:
                self._fallback = FallbackSink(self.connection)
        except CushionError:
            self._backoff.failed(now_s)
            raise
        self._backoff.succeeded()
        return True

    def close(self) -> None:
        """Remove the fallback sink and disconnect. May be repeated."""
        if self._fallback:
            self._fallback.close()
        if self.connection:
            self.connection.close()
        self.connection = self._fallback = None
