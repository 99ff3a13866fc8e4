"""The stream of trials, with sound and vibration, so that one audio clock has both.

It plays to a null sink of this process, and ends with it. From there, the sound is linked to the
default output. While the sink exists, the daemon plays its rear channel in place of the tap.
"""

import math
import threading
from collections.abc import Mapping, Set
from contextlib import ExitStack, closing

import numpy as np
from scipy.signal.windows import tukey

from audioflinger_hook.daemon.native.taps import MONITOR, PLAYBACK, TRIALS, channels_of
from device.errors import LostError, UsageError
from device.server import PulseConnection
from device.server.graph import Graph, LinkPair
from device.server.graph_watch import GraphWatch
from device.server.guard import StreamGuard
from device.stream.pcms import Pcm, ServerDevice
from device.stream.streams import PlaybackStream
from device.units import Float32Array

RATE_HZ, BLOCK_FRAMES = 48_000, 4_096
COLUMNS, CHANNELS = 3, 4  # left and right sound and vibration of a trial; the sink has one more
FADE = np.hanning(round(0.1 * RATE_HZ))[round(0.05 * RATE_HZ) :, None]  # 50 ms
GONE_LOOKS, GONE_LOOK_S = 20, 0.2  # for the end of an earlier sink
NODE = (
    f"create-node adapter {{ factory.name=support.null-audio-sink node.name={TRIALS} "
    'node.description="Haptic Cushion (trials)" media.class=Audio/Sink '
    "audio.position=[FL FR RL RR] priority.session=0 object.linger=false }"
)


class Trial:
    """A trial that the audio thread plays. Any thread may set `stops`, which begins a fade.

    frames: (frames, COLUMNS) within ±1; both ends are faded. lead_s: how much later the vibration
    begins than the sound. began_s, ends_s: when the first frame is played, and the last one has
    been. played: number of frames until now.
    """

    def __init__(self, frames: Float32Array, lead_s: float) -> None:
        count, later = len(frames), round(lead_s * RATE_HZ)
        faded = frames * tukey(count, min(1.0, 2.0 * len(FADE) / count))[:, None]
        self._frames = np.zeros((count + abs(later), CHANNELS), np.float32)
        self._frames[max(0, -later) :][:count, :2] = faded[:, :2]
        self._frames[max(0, later) :][:count, 2] = faded[:, 2]
        self.began_s, self.ends_s = math.inf, math.inf
        self.played, self.stops, self._fades_out = 0, False, False

    def fill(self, out: Float32Array, plays_s: float) -> None:
        """Write the next frames. plays_s: when the first of them is played."""
        self.began_s = min(self.began_s, plays_s)
        if self.stops and not self._fades_out:
            rest = self._frames[self.played :][: len(FADE)]
            self._frames = np.concatenate((self._frames[: self.played], rest * FADE[: len(rest)]))
            self._fades_out = True
        part = self._frames[self.played :][: len(out)]
        out[: len(part)] = part
        self.played += len(part)
        if len(part) < len(out):
            self.ends_s = min(self.ends_s, plays_s + len(part) / RATE_HZ)


class TrialStream:
    """Sink, links and stream of trials until `close`; implements `Wiring`.

    pcm: plays the stream. device: name of the haptic sink. why_silent: why sound is not heard, or
    "". LostError, NotFoundError: the server was lost. UsageError: another program plays trials.
    """

    def __init__(self, pcm: Pcm, device: str | None) -> None:
        self._pcm, self._lost_blocks = pcm, 0
        self._trial: Trial | None = None
        self._stream: PlaybackStream | None = None
        with ExitStack() as stack:
            self._connection = stack.enter_context(closing(PulseConnection()))
            self._heard = self._connection.latest.default_sink
            goes = f"the sound would go to {self._heard or 'no sink'}; choose another output"
            self.why_silent = goes * (self._heard in (None, device))
            looks = 0
            while self._connection.snapshot().sink(TRIALS):
                if (looks := looks + 1) > GONE_LOOKS:
                    raise UsageError("another program plays trials; end it first")
                threading.Event().wait(GONE_LOOK_S)
            self._watch = stack.enter_context(closing(GraphWatch(lambda: None)))
            self._watch.keeper.wiring = self
            self._open = stack.pop_all()

    def play(self, trial: Trial) -> None:
        """Begin a trial."""
        self._lost_blocks, self._trial = self._count_lost(), trial

    def why_not(self, now_s: float) -> str:
        """Return why the trial is not heard, or ""; call it often. LostError: make a new object."""
        stream = self._stream
        if self._connection.lost or self._watch.lost or (stream and stream.is_lost(now_s)):
            raise LostError("the sound server was lost")
        if self._connection.latest.default_sink != self._heard:
            raise LostError("the default output has changed")
        with self._watch.lock:
            self._watch.keeper.update(now_s)
            wanted = self._of_sound(self._watch.graph)
            is_linked = bool(wanted or self.why_silent) and not self._watch.keeper.missing(wanted)
        if stream is None and is_linked and self._connection.latest.sink(TRIALS):
            self._pcm.target = ServerDevice(TRIALS)
            stream = self._stream = PlaybackStream(
                self._pcm, RATE_HZ, CHANNELS, self._fill, block_frames=BLOCK_FRAMES
            )
            self._open.callback(stream.close)
            self._open.callback(StreamGuard(self._connection, stream, TRIALS).release)
        if not (is_linked and stream and stream.audible):
            return "the stream of trials is not linked yet"
        plays = self._trial is not None and math.isinf(self._trial.ends_s)
        is_late = plays and self._count_lost() != self._lost_blocks
        return "a block came too late; close other programs" if is_late else ""

    def close(self) -> None:
        """End the stream and its sink. May be repeated."""
        self._open.close()

    def _count_lost(self) -> int:
        stream = self._stream
        return stream.xruns + stream.silenced + stream.errors.total() if stream else 0

    def _fill(self, out: Float32Array, now_s: float) -> None:
        if self._trial is not None and self._stream is not None:
            self._trial.fill(out, now_s + self._stream.delay_s)

    def made_nodes(self) -> Mapping[str, str]:  # noqa: D102
        return {TRIALS: NODE}

    def nodes(self, graph: Graph) -> Set[int]:  # noqa: D102
        return {node.id for node in graph.nodes_named(TRIALS)}

    def links(self, graph: Graph) -> Set[LinkPair]:  # noqa: D102
        made = {link.pair for node in self.nodes(graph) for link in graph.links_of(node)}
        return self._of_sound(graph) | made  # by the session manager and the daemon

    def _of_sound(self, graph: Graph) -> Set[LinkPair]:
        node, sink = graph.sink(TRIALS), None if self.why_silent else graph.sink(self._heard or "")
        outputs = graph.ports_of(node.id, MONITOR) if node else {}
        inputs = graph.ports_of(sink.id, PLAYBACK) if sink else {}
        return {
            (outputs[position], inputs[[*inputs][index]])
            for position in ("FL", "FR")
            for index in channels_of(position, tuple(inputs))
            if len(outputs) == CHANNELS
        }
