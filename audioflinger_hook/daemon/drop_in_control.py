"""Drop-in mode, kept: a virtual sink in front of the speakers, for as long as the daemon runs."""

from __future__ import annotations

from audioflinger_hook.daemon.reconnecting_stream import LONGEST_WAIT_S
from audioflinger_hook.service.backoff import Backoff
from device.errors import CushionError
from device.server import DropIn, PulseConnection


class DropInControl:
    """The virtual sink that applications play to, made when there is a server. For the supervisor.

    delay_s: by how much the sound is to come later, 0 or more; `lead` sets another.
    """

    def __init__(self, delay_s: float) -> None:
        self._delay_s = delay_s
        self._drop_in: DropIn | None = None
        self._backoff = Backoff(longest_s=10.0 * LONGEST_WAIT_S)
        self._target: str | None = None
        self._refusal = ""

    @property
    def delay_s(self) -> float:
        """By how much the sound is later than without us, in seconds; 0 while it is not."""
        return self._drop_in.delay_s if self._drop_in else 0.0

    @property
    def warnings(self) -> list[str]:
        """Why the sound does not pass as it should, one line at most."""
        reason = self._drop_in.reason if self._drop_in else self._refusal
        return [f"drop-in: {reason}"] if reason else []

    def keep(self, connection: PulseConnection, haptic_sink: str | None, now_s: float) -> None:
        """See that it is there. haptic_sink: never forwarded to. It raises nothing."""
        if self._drop_in is not None:
            if self._drop_in.haptic_sink != haptic_sink:
                self._drop_in.haptic_sink = haptic_sink
            self._target = self._drop_in.target_name or self._target
            return
        if self._backoff.wait_s(now_s) > 0.0:
            return
        try:
            self._drop_in = self._made(connection, haptic_sink)
        except CushionError as error:
            self._refusal = str(error)
            self._backoff.failed(now_s)
        else:
            self._refusal = ""
            self._backoff.succeeded()

    def lead(self, delay_s: float) -> None:
        """Let the sound come later by this much from now on."""
        self._delay_s = delay_s
        if self._drop_in is not None:
            self._drop_in.delay_s = delay_s

    def close(self) -> None:
        """Let the user's sound go on without us. Again too; it raises nothing."""
        drop_in, self._drop_in = self._drop_in, None
        if drop_in is not None:
            drop_in.close()

    def _made(self, connection: PulseConnection, haptic_sink: str | None) -> DropIn:
        """A new one; to the sink of before, if it is there: a new server may choose any other."""
        names = [sink.name for sink in connection.latest.sinks]
        target = self._target if self._target in names else None
        return DropIn(connection, target, self._delay_s, haptic_sink=haptic_sink)
