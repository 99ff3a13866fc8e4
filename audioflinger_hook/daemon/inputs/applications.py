"""Single applications before the mix, each on a track of its own."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import partial

from audioflinger_hook.daemon.engine import Engine
from audioflinger_hook.daemon.reconnecting_stream import LONGEST_WAIT_S
from audioflinger_hook.daemon.recording import RunRecording
from audioflinger_hook.service.backoff import Backoff
from audioflinger_hook.service.state import Cause, StateKeeper
from audioflinger_hook.sources import VoicesClient
from audioflinger_hook.sources.applications import Voice
from device.errors import CushionError, LostError, NotFoundError
from device.server import AppCaptures, AppRules, PulseConnection, ServerSnapshot
from device.server.app_capture import AppCapture, EndReason
from device.server.app_rules import app_name
from device.server.snapshot import Stream
from device.stream import AudioPriority
from device.units import Float32Array

CAPTURES_MAX = 32
"""More applications than anybody listens to at once; each capture costs its share of CPU."""

NOBODY = "no application plays"

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
    def name(self) -> str:
        """The applications' names."""
        names = dict.fromkeys(app_name(stream) for stream in self.streams)
        return ", ".join(names) or NOBODY


class ApplicationsFeed:
    """Buffers of several applications through one engine, mixed first.

    recording: takes the mix for what was delivered, since that is what the effect gets. priority:
    what the thread of all captures asks for. The supervising thread makes the client, and calls
    `serve` before the first buffer.
    """

    records_mix = True

    def __init__(
        self, recording: RunRecording | None = None, priority: AudioPriority | None = None
    ) -> None:
        self._priority = priority
        self._thread: int | None = None
        self.engine: Engine | None = None
        self.voices: VoicesClient | None = None
        self._recording = recording

    def client(self, samplerate: int, channels: int) -> VoicesClient:
        """Return what plays into the mix, which has this format."""
        self.voices = VoicesClient(samplerate, channels)
        if self._recording:
            self._recording.mix_is(samplerate, channels)
        return self.voices

    def serve(self, engine: Engine) -> None:
        """Bring the buffers to this engine, which was made with `client`."""
        self.engine = engine

    def push(self, voice: Voice, frames: Float32Array, now_s: float) -> None:
        """Take frames of one application; on the thread of all captures."""
        thread = threading.get_ident()
        if self._priority is not None and thread != self._thread:
            self._thread = thread  # another one with every connection
            self._priority.claim()
        voices, engine = self.voices, self.engine
        if voices is None or engine is None or not len(frames):
            return
        voices.push(voice, frames, now_s)
        while voices.pending_frames and engine.advance(now_s):
            pass


class ApplicationsInput:
    """Sound of the applications that some rules select. For the supervising thread alone.

    address: as the user wrote it. They may come and go: none at all is no failure. feed: what
    their buffers go through, on the thread of all captures.
    """

    needs_server = True
    ended = False

    def __init__(
        self, address: str, rules: AppRules, states: StateKeeper, feed: ApplicationsFeed
    ) -> None:
        self._address = address
        self._rules = rules
        self._states = states
        self._feed = feed
        self._captures: AppCaptures | None = None
        self._open: dict[int, tuple[AppCapture, Voice]] = {}
        self._backoff = Backoff(longest_s=LONGEST_WAIT_S)
        self._found = Applications((), USUAL_SAMPLERATE, USUAL_CHANNELS)
        self._xruns_before = 0

    def __str__(self) -> str:
        return self._address

    @property
    def may_rest(self) -> bool:
        """While none of them plays; what is silent now may sound at any moment."""
        return all(stream.corked for stream in self._found.streams)

    @property
    def name(self) -> str | None:
        """What is listened to, None while it is not."""
        return self._found.name if self._captures else None

    @property
    def xruns(self) -> int:
        """How often frames were missing."""
        return self._xruns_before + sum(capture.xruns for capture, _ in self._open.values())

    @property
    def warnings(self) -> list[str]:
        """That some are left out, if so."""
        if not self._found.left_out:
            return []
        return [
            f"{self._found.left_out} applications are not felt: {CAPTURES_MAX} at once are; "
            "name fewer of them"
        ]

    def lead(self, address: str, rules: AppRules) -> None:
        """Listen to others from now on."""
        self._address, self._rules = address, rules

    def locate(self, snapshot: ServerSnapshot | None, device: str | None) -> Applications:
        """Find the applications to capture now, and return them.

        device: the sink that the vibration goes to, whose sound is never captured. The mix has
        the default sink's format, so that the server need not convert much.
        """
        assert snapshot is not None
        streams = self._rules.select(snapshot, device)
        default = next((s for s in snapshot.sinks if s.name == snapshot.default_sink), None)
        self._found = Applications(
            streams[:CAPTURES_MAX],
            default.samplerate if default else USUAL_SAMPLERATE,
            default.channels if default else USUAL_CHANNELS,
            max(0, len(streams) - CAPTURES_MAX),
        )
        return self._found

    def players(self, snapshot: ServerSnapshot | None) -> frozenset[int]:
        """Return the streams that may sound at any moment."""
        return frozenset(stream.index for stream in self._found.streams if not stream.corked)

    def listen(self, connection: PulseConnection | None, now_s: float) -> bool:
        """It does not rest while there is anything to hear."""
        return False

    def keep(self, connection: PulseConnection | None, now_s: float) -> None:
        """Capture what was located, and nothing else.

        Raises LostError or NotFoundError where libpulse gives no second connection.
        """
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
            self._follow(captures, now_s)
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

    def end(self, *, keep: bool) -> None:
        """End all captures."""
        self.close()

    def _follow(self, captures: AppCaptures, now_s: float) -> None:
        wanted = {stream.index: stream for stream in self._found.streams}
        for index, (capture, _) in tuple(self._open.items()):
            if capture.ended is EndReason.TAKEN:
                self._states.recover(Cause.TAP_MOVED, now_s, str(capture.ended))
            if capture.ended is not None or index not in wanted:
                self._end(index)
        for index, stream in wanted.items():
            if index not in self._open:
                self._begin(captures, stream)

    def _begin(self, captures: AppCaptures, stream: Stream) -> None:
        voices = self._feed.voices
        assert voices is not None
        voice = voices.add(app_name(stream) or f"stream {stream.index}")
        try:
            capture = captures.open(
                stream.index, voices.samplerate, voices.channels, partial(self._feed.push, voice)
            )
        except NotFoundError:  # it has ended meanwhile
            voices.remove(voice)
            return
        except LostError:
            voices.remove(voice)
            raise
        self._open[stream.index] = capture, voice

    def _end(self, index: int) -> None:
        capture, voice = self._open.pop(index)
        capture.close()
        self._xruns_before += capture.xruns
        if self._feed.voices:
            self._feed.voices.remove(voice)
