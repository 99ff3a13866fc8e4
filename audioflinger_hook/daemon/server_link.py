"""The connection to the sound server, and the virtual sinks that the daemon creates there."""

from collections.abc import Callable

from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.daemon.timing import LONGEST_S, Backoff
from device.errors import CushionError, LostError
from device.server import DropIn, FallbackSink, PulseConnection, ServerSnapshot
from device.server.snapshot import Listener


class ServerLink(Listener):
    """Connection to the server, with a silent fallback sink if `fallback` is True.

    ring: another thread calls it when the server changes or is lost. connection: None if absent.
    """

    def __init__(self, ring: Callable[[], None], *, fallback: bool = True) -> None:
        self.connection: PulseConnection | None = None
        self._ring, self._has_fallback = ring, fallback
        self._fallback: FallbackSink | None = None
        self._backoff = Backoff()

    def on_snapshot(self, snapshot: ServerSnapshot) -> None:
        """Wake the main thread after a change of the server."""
        self._ring()

    def on_lost(self, error: LostError) -> None:
        """Wake the main thread after the loss of the server."""
        self._ring()

    @property
    def latest(self) -> ServerSnapshot | None:
        """Latest snapshot of the server, None if not connected. Any thread may read it."""
        connection = self.connection  # the main thread may set it to None meanwhile
        return connection.latest if connection else None

    @property
    def lost(self) -> str:
        """Why the connection was lost, or ""."""
        return str((self.connection and self.connection.lost) or "")

    @property
    def warning(self) -> str:
        """Why the fallback sink is not ready, in one line; "" on PipeWire, which needs none."""
        return self._fallback.reason if self._fallback else ""

    def open(self, now_s: float) -> bool:
        """Connect if an attempt is due; return whether it did. CushionError: the attempt failed."""
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
        """Remove the fallback sink and disconnect. Repeated calls do nothing."""
        if self._fallback:
            self._fallback.close()
        if self.connection:
            self.connection.close()
        self.connection = self._fallback = None


class DropInControl:
    """The virtual sink to which applications play in drop-in mode."""

    def __init__(self, config: RunConfig) -> None:
        self._config = config
        self._drop_in: DropIn | None = None
        self._target: str | None = None
        self._refusal, self._wanted_delay_s = "", 0.0
        self._backoff = Backoff(longest_s=10.0 * LONGEST_S)

    def follow(self, config: RunConfig) -> None:
        """Apply another config."""
        if config.live.drop_in != self._config.live.drop_in:
            self.close()
            self._target, self._refusal = None, ""
            self._backoff.succeeded()
        self._config = config

    def set_delay(self, delay_s: float) -> None:
        """Delay the sound by `delay_s` in drop-in mode, at least by `forwarding.MIN_DELAY_S`."""
        if delay_s != self._wanted_delay_s and self._drop_in is not None:
            self._drop_in.delay_s = delay_s
        self._wanted_delay_s = delay_s

    @property
    def target_name(self) -> str:
        """Name of the sink to which the virtual sink's sound is forwarded, "" for none."""
        return self._drop_in.target_name if self._drop_in else ""

    @property
    def delay_s(self) -> float:
        """Delay of the sound in seconds, 0 while there is no virtual sink."""
        return self._drop_in.delay_s if self._drop_in else 0.0

    @property
    def warnings(self) -> list[str]:
        """Why the sink's sound is not forwarded as configured, at most one line."""
        reason = self._drop_in.reason if self._drop_in else self._refusal
        return [f"drop-in: {reason}"] if reason else []

    def maintain(self, connection: PulseConnection, haptic_sink: str | None, now_s: float) -> None:
        """In drop-in mode, create the sink. Its sound is never sent to `haptic_sink`."""
        if not self._config.live.drop_in:
            return
        if self._drop_in is not None:
            self._drop_in.spare(haptic_sink)
            self._target = self._drop_in.target_name or self._target
            return
        if self._backoff.wait_s(now_s) > 0.0:
            return
        try:
            names = [sink.name for sink in connection.latest.sinks]
            target = self._target if self._target in names else None  # the previous target
            self._drop_in = DropIn(
                connection, target, self._wanted_delay_s, haptic_sink=haptic_sink
            )
            self._refusal = ""
            self._backoff.succeeded()
        except CushionError as error:
            self._refusal = str(error)
            self._backoff.failed(now_s)

    def close(self) -> None:
        """Remove the sink, so that applications play to other sinks. Repeated calls do nothing."""
        if self._drop_in is not None:
            self._drop_in.close()
        self._drop_in = None
