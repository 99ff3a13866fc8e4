"""Single applications before the mix, each on a track of its own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from audioflinger_hook.clients import VoicesClient
from audioflinger_hook.clients.voices import Voice
from audioflinger_hook.daemon.engine import Engine
from audioflinger_hook.daemon.kept import LONGEST_WAIT_S
from audioflinger_hook.service.backoff import Backoff
from audioflinger_hook.service.state import Cause, StateKeeper
from device.errors import CushionError, LostError, NotFoundError
from device.server import AppCapture, AppCaptures, AppRules, PulseConnection, ServerSnapshot, Sink
from device.server.app_capture import Ended
from device.server.applications import name_of
from device.server.snapshot import Stream
from device.units import Float32Array

CAPTURES_MAX = 32
"""More applications than anybody listens to at once; each capture costs its share of CPU."""

USUAL_SAMPLERATE = 48_000
USUAL_CHANNELS = 2


@dataclass(frozen=True)
class Applications:
    """What is captured at one moment; samplerate (Hz) and channels are those of the mix.

    left_out: how many applications were too many.
    """

    streams: tuple[Stream, ...]
    samplerate: int
    channels: int
    left_out: int = 0

    @property
    def name(self) -> str | None:
        """The applications' names, None for none."""
        names = dict.fromkeys(name_of(stream) for stream in self.streams)
        return ", ".join(names) or None


class AppInput:
    """Sound of the applications that some rules select. For the supervisor alone.

    address: as the user wrote it. They may come and go: none at all is no failure.
    """

    hears_while_resting = False

    def __init__(self, address: str, rules: AppRules, states: StateKeeper) -> None:
        self._address = address
        self._rules = rules
        self._states = states
        self._captures: AppCaptures | None = None
        self._open: dict[int, tuple[AppCapture, Voice]] = {}
        self._backoff = Backoff(longest_s=LONGEST_WAIT_S)
        self._client: VoicesClient | None = None
        self._engine: Engine | None = None
        self._xruns_before = 0

    def __str__(self) -> str:
        return self._address

    @property
    def is_open(self) -> bool:
        """Whether it listens; there may be no application to listen to."""
        return self._captures is not None

    @property
    def xruns(self) -> int:
        """How often frames were missing."""
        return self._xruns_before + sum(capture.xruns for capture, _ in self._open.values())

    @property
    def sounds(self) -> bool:
        """Whether anything is captured at present."""
        return bool(self._open)

    def locate(self, snapshot: ServerSnapshot, device: Sink | None) -> Applications:
        """Return the applications to capture now. device: where the vibration goes.

        The mix has the default sink's format, so that the server need not convert much.
        """
        streams = self._rules.select(snapshot, device.name if device else None)
        default = next((s for s in snapshot.sinks if s.name == snapshot.default_sink), None)
        return Applications(
            streams[:CAPTURES_MAX],
            default.samplerate if default else USUAL_SAMPLERATE,
            default.channels if default else USUAL_CHANNELS,
            max(0, len(streams) - CAPTURES_MAX),
        )

    def players(self, snapshot: ServerSnapshot, place: Applications) -> frozenset[int]:
        """Return the streams that may sound at any moment."""
        return frozenset(stream.index for stream in place.streams if not stream.corked)

    def client(self, place: Applications) -> VoicesClient:
        """Return what plays into the mix."""
        self._client = VoicesClient(place.samplerate, place.channels)
        return self._client

    def keep(
        self, connection: PulseConnection, place: Applications, engine: Engine, now_s: float
    ) -> None:
        """Capture what plays, and nothing else.

        Raises LostError or NotFoundError where libpulse gives no second connection.
        """
        self._engine = engine
        captures = self._captures
        if captures is not None and captures.lost is not None:
            self._states.recover(Cause.TAP_LOST, now_s, str(captures.lost))
            self.close()
            captures = None
        if self._backoff.wait_s(now_s) > 0.0:
            return
        try:
            if captures is None:
                captures = self._captures = AppCaptures()
            self._follow(captures, place, now_s)
        except CushionError:
            self._backoff.failed(now_s)
            raise
        self._backoff.succeeded()

    def close(self) -> None:
        """End all captures. Again too; it raises nothing."""
        for index in tuple(self._open):
            self._end(index)
        captures, self._captures = self._captures, None
        if captures is not None:
            captures.close()

    def _follow(self, captures: AppCaptures, place: Applications, now_s: float) -> None:
        wanted = {stream.index: stream for stream in place.streams}
        for index, (capture, _) in tuple(self._open.items()):
            if capture.ended is Ended.TAKEN:
                self._states.recover(Cause.TAP_MOVED, now_s, str(capture.ended))
            if capture.ended is not None or index not in wanted:
                self._end(index)
        for index, stream in wanted.items():
            if index not in self._open:
                self._begin(captures, stream)

    def _begin(self, captures: AppCaptures, stream: Stream) -> None:
        client = self._client
        assert client is not None
        voice = client.add(name_of(stream) or f"stream {stream.index}")
        try:
            capture = captures.open(
                stream.index, client.samplerate, client.channels, partial(self._on_frames, voice)
            )
        except NotFoundError:  # it has ended meanwhile
            client.remove(voice)
            return
        except LostError:
            client.remove(voice)
            raise
        self._open[stream.index] = capture, voice

    def _end(self, index: int) -> None:
        capture, voice = self._open.pop(index)
        capture.close()
        self._xruns_before += capture.xruns
        assert self._client is not None
        self._client.remove(voice)

    def _on_frames(self, voice: Voice, frames: Float32Array, now_s: float) -> None:
        """Take captured frames; on the thread of all captures."""
        client, engine = self._client, self._engine
        if client is None or engine is None or not len(frames):
            return
        client.push(voice, frames, now_s)
        while client.pending_frames:
            engine.advance(now_s)
