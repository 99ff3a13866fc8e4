"""Keeps vibration and sound together: finds the offset, and applies it to engines and drop-in."""

from collections.abc import Callable

from audioflinger_hook.daemon.declared import DeclaredDelays
from audioflinger_hook.daemon.engines import Engines
from audioflinger_hook.daemon.inputs.applications import Applications
from audioflinger_hook.daemon.inputs.base import AudioNode
from audioflinger_hook.daemon.latency import parts_of_native, parts_of_python
from audioflinger_hook.daemon.offset import Declared, Offset
from audioflinger_hook.daemon.offset_store import OffsetStore, SinkPair
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.daemon.server_link import DropInControl
from device.clock.delay_control import PLAYING
from device.server import PulseConnection
from device.server.snapshot import Source


class Alignment:
    """Follows the pair of sinks and their delays while the daemon runs. For the main thread.

    store: delays that users have measured. on_change: another thread calls it when the graph
    changes. offset: the offset in use.
    """

    def __init__(
        self,
        config: RunConfig,
        engines: Engines,
        drop_in: DropInControl,
        store: OffsetStore,
        on_change: Callable[[], None],
    ) -> None:
        self._config, self._engines, self._drop_in, self._store = config, engines, drop_in, store
        self.offset = Offset(config, store)
        self._declared = DeclaredDelays(on_change)
        self._pair: SinkPair | None = None
        self._seen: Declared | None = None

    @property
    def offset_s(self) -> float:
        """Delay of the vibration, minus the delay of the sound in drop-in mode, in seconds."""
        return self.offset.vibration_s - self._drop_in.delay_s

    @property
    def warnings(self) -> list[str]:
        """Why stored or declared delays are not used, one line each."""
        declared = "" if self._config.live.offset_s is not None else self._declared.warning
        return [*filter(None, (self._store.warning, declared))]

    def follow(self, config: RunConfig) -> None:
        """Apply another config."""
        self._config = config
        self.offset.follow(config)

    def maintain(
        self,
        connection: PulseConnection | None,
        source: AudioNode,
        device: AudioNode,
        stream_latencies_s: tuple[float, float],
        now_s: float,
        *,
        runs: bool,
    ) -> None:
        """Find the offset and apply it. LostError: the connection to the server is lost.

        stream_latencies_s: of tap and output with the Python engine. runs: the daemon is not idle.
        """
        pair = self._pair_of(source, device)
        if pair != self._pair:
            self._pair, self._seen = pair, None
        native, python = self._engines.native.engine, self._engines.python
        parts_ms, watch, plays = None, None, False
        cycle = self._config.live.block_frames, source.samplerate
        if native is not None and native.chain is not None:
            chain, watch, plays = native.chain, native.watch, native.is_fed
            parts_ms = parts_of_native(native, chain)
            cycle = chain.page.cycle_frames, chain.plan.samplerate
        elif python is not None and python.delay_line.status.state in PLAYING:
            parts_ms, plays = parts_of_python(python, *stream_latencies_s), runs
        own_s = 1e-3 * sum(parts_ms.values()) if parts_ms else None
        if pair is None or connection is None or self._config.live.offset_s is not None:
            self._seen = None
            self._declared.close()
        elif own_s is not None and (plays or self._seen is None):  # idle sinks may declare nothing
            self._seen = self._declared.read(
                pair, connection, watch, cycle, now_s, forwards=self._config.live.drop_in
            )
        self.offset.update(pair, self._seen or Declared(), own_s, now_s)
        self._engines.set_offset(self.offset.vibration_s)
        self._drop_in.set_delay(self.offset.sound_s)

    def close(self) -> None:
        """End the connection to PipeWire's graph until the next `maintain`. May be repeated."""
        self._declared.close()

    def _pair_of(self, source: AudioNode, device: AudioNode) -> SinkPair | None:
        """Return the sinks of sound and vibration, None if a part is no sink and no sound card."""
        if not (self._config.tap_is_live and self._config.device_is_live):
            return None
        if self._config.live.drop_in:
            heard = self._drop_in.target_name
        elif isinstance(source, Source):
            heard = source.monitor_of or ""
        else:
            assert isinstance(source, Applications)
            playing = [stream for stream in source.streams if not stream.corked]
            sinks = {stream.device_name for stream in playing or source.streams}
            heard = source.sink or (sinks.pop() if len(sinks) == 1 else "")
            if not source.streams and not heard:
                return self._pair
        return SinkPair(heard, device.name) if heard else None
