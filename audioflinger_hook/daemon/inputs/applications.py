"""An input that captures the stream of each application before the server mixes the streams."""

import threading
from dataclasses import dataclass
from functools import partial

from audioflinger_hook.daemon.capture_queue import SoundGain
from audioflinger_hook.daemon.engine import Engine
from audioflinger_hook.daemon.inputs.base import NOTHING, Input
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.daemon.timing import Backoff
from audioflinger_hook.service.state import Cause, StateKeeper
from audioflinger_hook.sources import VoicesClient
from audioflinger_hook.sources.applications import Voice
from device.errors import CushionError, LostError, NotFoundError
from device.server import AppCaptures, PulseConnection, ServerSnapshot
from device.server.app_capture import AppCapture, EndReason
from device.server.app_rules import app_name
from device.server.identity import default_monitor
from device.server.left_out import LeftOut, microphones_of
from device.server.snapshot import Sink, Stream
from device.server.tap_volume import TapVolume, muted_sink
from device.stream import AudioPriority
from device.units import Float32Array

CAPTURES_MAX = 32  # largest number of captured streams, which limits the CPU load

NONE_SUCH = "no application that the tap names plays; `cushion devices` lists those that do"


@dataclass(frozen=True)
class Applications:
    """The streams to capture, and the format of their mix. samplerate: Hz.

    left_out: number of selected streams after the first CAPTURES_MAX. sink: only streams to this
    sink are captured, "" for all sinks.
    """

    streams: tuple[Stream, ...] = ()
    samplerate: int = 48_000
    channels: int = 2
    left_out: int = 0
    channel_map: str = "front-left,front-right"
    sink: str = ""

    @property
    def name(self) -> str:
        """Names of the applications, separated by commas."""
        names = dict.fromkeys(app_name(stream) for stream in self.streams)
        return ", ".join(names) or "no application plays"

    @property
    def why_silent(self) -> str:
        """Message for the user: why no sound arrives while the daemon is idle."""
        return NOTHING if self.streams else NONE_SUCH


class ApplicationsFeed:
    """Passes buffers of several applications to an engine, which mixes them. See `Feed`."""

    records_mix = True  # a recording stores the mix, not the buffers

    def __init__(self, priority: AudioPriority | None = None) -> None:
        self._priority = priority
        self._claimed: tuple[int, int] | None = None
        self.engine: Engine | None = None
        self.voices: VoicesClient | None = None
        self.gain = SoundGain()

    def client(self, samplerate: int, channels: int) -> VoicesClient:
        """Return the mixer's source of buffers. samplerate (Hz), channels: of the mix."""
        self.voices = VoicesClient(samplerate, channels)
        return self.voices

    def serve(self, engine: Engine) -> None:
        """Pass later buffers to this engine, whose client must be the result of `client`."""
        self.engine = engine

    def push(self, voice: Voice, frames: Float32Array, now_s: float) -> None:
        """Process samples (frames, channels) of one stream. The capture thread calls it."""
        if self._priority is not None:
            claim = threading.get_ident(), self._priority.round
            if claim != self._claimed:  # each `AppCaptures` has its own capture thread
                self._claimed = claim
                self._priority.claim()
        voices, engine = self.voices, self.engine
        if voices is None or engine is None or not len(frames):
            return
        voices.push(voice, self.gain.apply(frames), now_s)
        while voices.pending_frames and engine.advance(now_s):
            pass


class ApplicationsInput(Input):
    """Captures the applications that the config's rules select."""

    needs_server = may_rest = True
    why_silent = NONE_SUCH

    def __init__(self, config: RunConfig, states: StateKeeper, feed: ApplicationsFeed) -> None:
        super().__init__(_address(config))
        self.retarget(config)
        self._states, self._feed = states, feed
        self._captures: AppCaptures | None = None
        self._open: dict[int, tuple[AppCapture, Voice]] = {}
        self._backoff = Backoff()
        self._found = Applications()
        self._volume = TapVolume()
        self._xruns_before = 0

    @property
    def name(self) -> str | None:
        """Names of the captured applications, None while closed."""
        return self._found.name if self._captures else None

    @property
    def xruns(self) -> int:
        """Number of gaps in the captured sound."""
        return self._xruns_before + sum(capture.xruns for capture, _ in self._open.values())

    @property
    def warnings(self) -> list[str]:
        """One warning if more than CAPTURES_MAX streams are selected."""
        if not self._found.left_out:
            return []
        return [
            f"{self._found.left_out} applications have no vibration: at most {CAPTURES_MAX} are "
            "captured; name fewer of them"
        ]

    def retarget(self, config: RunConfig) -> bool:
        """Capture the applications of another config; return False if it has no rules for them."""
        if config.rules is None:
            return False
        self._rules, self.address = config.rules, _address(config)
        self._left_out = config.left_out
        self._of_default_sink = config.tap.kind == "default"
        return True

    def locate(self, snapshot: ServerSnapshot | None, device: str | None) -> Applications:
        """Return the streams to capture. device: sink of the vibration; streams to it are left out.

        The mix has the format of the default sink. With the tap `default`, only streams to the
        default sink are captured. NotFoundError: no default sink can be captured.
        """
        assert snapshot is not None
        microphones = microphones_of(snapshot)
        streams = tuple(
            stream
            for stream in self._rules.select(snapshot, device)
            if not self._left_out.why(stream, microphones)
        )
        sink = ""
        if self._of_default_sink:
            sink = default_monitor(snapshot, device).monitor_of or ""
            streams = tuple(stream for stream in streams if stream.device_name == sink)
        sinks = (one for one in snapshot.sinks if one.name == snapshot.default_sink)
        form: Sink | Applications = next(sinks, Applications())
        self._found = Applications(
            streams[:CAPTURES_MAX],
            form.samplerate,
            form.channels,
            max(0, len(streams) - CAPTURES_MAX),
            form.channel_map,
            sink,
        )
        self.may_rest = all(stream.corked for stream in self._found.streams)
        self.why_silent = self._found.why_silent
        return self._found

    def players(self, snapshot: ServerSnapshot | None) -> frozenset[int]:
        """See `Input`."""
        return frozenset(stream.index for stream in self._found.streams if not stream.corked)

    def volume_db(self, snapshot: ServerSnapshot, left_out: LeftOut | None = None) -> float:
        """Return the volume in dB of the captured streams; see `TapVolume`."""
        return self._volume.follow(snapshot, self.players(snapshot))

    def is_muted(self, snapshot: ServerSnapshot) -> bool:
        """Whether only streams to one sink are captured, and the sink is muted or at 0 %."""
        return bool(muted_sink(snapshot, self._found.sink))

    def maintain(self, connection: PulseConnection | None, now_s: float) -> None:
        """Capture the streams that `locate` found. LostError, NotFoundError: see `AppCaptures`."""
        if self._captures is not None and self._captures.lost is not None:
            self._states.recover(Cause.TAP_LOST, now_s, str(self._captures.lost))
            self.close()
        if self._backoff.wait_s(now_s) > 0.0:
            return
        try:
            captures = self._captures = self._captures or AppCaptures()
            wanted = {stream.index: stream for stream in self._found.streams}
            for index, (capture, _) in tuple(self._open.items()):
                if capture.ended is EndReason.TAKEN:
                    self._states.recover(Cause.TAP_MOVED, now_s, str(capture.ended))
                if capture.ended is not None or index not in wanted:
                    self._end(index)
            for index, stream in wanted.items():
                if index not in self._open:
                    self._begin(captures, stream)
        except CushionError:
            self._backoff.failed(now_s)
            raise
        self._backoff.succeeded()

    def close(self) -> None:
        """End all captures. Repeated calls do nothing."""
        for index in tuple(self._open):
            self._end(index)
        if self._captures is not None:
            self._captures.close()
        self._captures = None

    def _begin(self, captures: AppCaptures, stream: Stream) -> None:
        voices = self._feed.voices
        assert voices is not None
        voice = voices.add(app_name(stream) or f"stream {stream.index}")
        try:
            capture = captures.open(
                stream.index, voices.samplerate, voices.channels, partial(self._feed.push, voice)
            )
        except (LostError, NotFoundError) as error:
            voices.remove(voice)
            if isinstance(error, LostError):
                raise
            return  # the stream has ended meanwhile
        self._open[stream.index] = capture, voice

    def _end(self, index: int) -> None:
        capture, voice = self._open.pop(index)
        capture.close()
        self._xruns_before += capture.xruns
        if self._feed.voices:
            self._feed.voices.remove(voice)


def _address(config: RunConfig) -> str:
    live = config.live
    if config.tap.kind == "app":
        return ", ".join(live.tap)
    words = [f"only {', '.join(live.include)}"] if live.include else []
    words += [f"not {', '.join(live.exclude)}"] if live.exclude else []
    return f"{config.tap} ({'; '.join(words)})"
