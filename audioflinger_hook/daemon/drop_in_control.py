"""Drop-in mode: a virtual sink in front of the speakers while the daemon runs."""

from __future__ import annotations

from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.daemon.timing import LONGEST_S, Backoff
from device.errors import CushionError
from device.server import DropIn, PulseConnection


class DropInControl:
    """The virtual sink that applications play to, in drop-in mode. For the supervising thread.

    config: says whether the mode is on.
    """

    def __init__(self, config: RunConfig) -> None:
        self._drop_in: DropIn | None = None
        self._restart(config)

    def _restart(self, config: RunConfig) -> None:
        self._config = config
        self._backoff = Backoff(longest_s=10.0 * LONGEST_S)
        self._target: str | None = None
        self._refusal = ""

    def follow(self, config: RunConfig) -> None:
        """Apply another config."""
        if config.live.drop_in != self._config.live.drop_in:
            self.close()
            self._restart(config)
        self._config = config
        if self._drop_in is not None:
            self._drop_in.delay_s = self._wanted_delay_s

    @property
    def delay_s(self) -> float:
        """Delay of the sound in seconds, 0 while there is no virtual sink."""
        return self._drop_in.delay_s if self._drop_in else 0.0

    @property
    def warnings(self) -> list[str]:
        """Why the sound is not forwarded as configured; at most one line."""
        reason = self._drop_in.reason if self._drop_in else self._refusal
        return [f"drop-in: {reason}"] if reason else []

    def maintain(self, connection: PulseConnection, haptic_sink: str | None, now_s: float) -> None:
        """Make the sink if it is missing and wanted; raises nothing.

        haptic_sink: gets no forwarded sound.
        """
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
            target = self._target if self._target in names else None  # the former one
            delay_s = self._wanted_delay_s
            self._drop_in = DropIn(connection, target, delay_s, haptic_sink=haptic_sink)
        except CushionError as error:
            self._refusal = str(error)
            self._backoff.failed(now_s)
        else:
            self._refusal = ""
            self._backoff.succeeded()

    def close(self) -> None:
        """Remove the sink; the sound continues without it. May be repeated; raises nothing."""
        drop_in, self._drop_in = self._drop_in, None
        if drop_in is not None:
            drop_in.close()

    @property
    def _wanted_delay_s(self) -> float:
        return max(0.0, -self._config.live.offset_s)
