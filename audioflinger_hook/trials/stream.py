"""The stream of trials, with sound and vibration, so that one audio clock has both.

It plays to a null sink of this process. From there, the sound is linked to the default output.
While the sink exists, the native engine of the daemon plays its rear channel in place of the tap.
The sink ends with this process.
"""

import math
import time
from collections.abc import Callable, Mapping, Set
from contextlib import ExitStack, closing

import numpy as np

from audioflinger_hook.daemon.native import taps
from device.errors import UsageError
from device.server import PulseConnection
from device.server.graph import Graph, LinkPair
from device.server.graph_watch import GraphWatch
from device.server.guard import StreamGuard
from device.stream.pcms import PcmConfig, ServerDevice
from device.stream.streams import PlaybackStream
from device.units import Float32Array

RATE_HZ = 48_000
COLUMNS, CHANNELS = 3, 4  # left and right sound and vibration of a trial; the sink has one more
BLOCK_FRAMES = 2_048
FADE_S = 0.05
FADE = 0.5 - 0.5 * np.cos(np.pi * (np.arange(round(FADE_S * RATE_HZ)) + 0.5) / (FADE_S * RATE_HZ))
HEARD = ("FL", "FR")
GONE_LOOKS, GONE_LOOK_S = 10, 0.05
FADED_S = 0.3  # longest time from the end of a trial to the end of its fade
PCM = "cushion_trials"
SINK = (
    f"create-node adapter {{ factory.name=support.null-audio-sink node.name={taps.TRIALS} "
    'node.description="Haptic Cushion (trials)" media.class=Audio/Sink '
    "audio.position=[FL FR RL RR] priority.session=0 object.linger=false }}"
)


class TrialFrames:
    """The frames of a trial, which the audio thread plays. `stops` begins a fade; any thread.

    frames: (frames, COLUMNS) within ±1. lead_s: how much later the vibration begins than the sound.
    began_s, ends_s: when the first frame is played, and the last has been. played: frames so far.
    """

    def __init__(self, frames: Float32Array, lead_s: float) -> None:
        ends = np.minimum(np.arange(len(frames)), np.arange(len(frames))[::-1])
        faded = frames * FADE[np.minimum(ends, len(FADE) - 1), None]
        shift = round(lead_s * RATE_HZ)
        self._frames = np.zeros((len(frames) + abs(shift), CHANNELS), np.float32)
        for columns, begin in ((slice(0, 2), max(0, -shift)), (slice(2, 3), max(0, shift))):
            self._frames[begin : begin + len(frames), columns] = faded[:, columns]
        self.began_s, self.ends_s = math.inf, math.inf
        self.played, self.stops, self._fades_out = 0, False, False

    def fill(self, out: Float32Array, plays_s: float) -> None:
        """Write the next frames. plays_s: when the first of them is played."""
        self.began_s = min(self.began_s, plays_s)
        if self.stops and not self._fades_out:
            self._fades_out = True
            self._frames = self._frames[: self.played + len(FADE)]
            rest = self._frames[self.played :]
            rest *= FADE[::-1][: len(rest), None]
        part = self._frames[self.played : self.played + len(out)]
        out[: len(part)] = part
        self.played += len(part)
        if len(part) < len(out):
            self.ends_s = min(self.ends_s, plays_s + len(part) / RATE_HZ)


class TrialStream:
    """Sink, links and stream of trials until `close`; implements `Wiring`.

    trial: what plays. LostError, NotFoundError: the server was lost, or cannot play trials.
    UsageError: another program plays trials.
    """

    def __init__(self, pcms: PcmConfig, device: str | None) -> None:
        self.trial: TrialFrames | None = None
        self._stream: PlaybackStream | None = None
        self._pcm = pcms.pcms[PCM]
        with ExitStack() as stack:
            self._connection = stack.enter_context(closing(PulseConnection()))
            self._heard = self._connection.latest.default_sink or ""
            if self._heard in ("", device):
                where = self._heard or "no sink"
                raise UsageError(f"the sound would go to {where}; choose another output")
            for _ in range(GONE_LOOKS):  # an earlier sink of this process may not have ended yet
                if self._connection.snapshot().sink(taps.TRIALS) is None:
                    break
                time.sleep(GONE_LOOK_S)
            else:
                raise UsageError("another program plays trials; end it first")
            self._watch = stack.enter_context(closing(GraphWatch(lambda: None)))
            self._watch.keeper.wiring = self
            self._stack = stack.pop_all()

    def is_ready(self, now_s: float) -> bool:
        """Whether a trial is heard if it plays now; call it often. Errors: as of the class."""
        with self._watch.lock:
            self._watch.keeper.update(now_s)
            wanted = self._of_sound(self._watch.graph)
            is_linked = bool(wanted) and not self._watch.keeper.missing(wanted)
        if self._stream is None and is_linked and self._connection.latest.sink(taps.TRIALS):
            self._pcm.target = ServerDevice(taps.TRIALS)
            stream = PlaybackStream(
                self._pcm, RATE_HZ, CHANNELS, self._fill, block_frames=BLOCK_FRAMES
            )
            self._stack.callback(stream.close)
            guard = StreamGuard(self._connection, stream, taps.TRIALS)
            self._stack.callback(guard.release)
            self._stream = stream
        return is_linked and self._stream is not None and self._stream.audible

    def is_lost(self, now_s: float) -> bool:
        """Whether the server was lost, or the sound goes elsewhere: make another object."""
        has_moved = self._connection.latest.default_sink != self._heard
        is_lost = self._connection.lost or self._watch.lost or has_moved
        return bool(is_lost or (self._stream and self._stream.is_lost(now_s)))

    @property
    def lost_blocks(self) -> int:
        """Number of blocks that came too late or were silenced."""
        stream = self._stream
        return stream.xruns + stream.silenced + stream.errors.total() if stream else 0

    def fade(self, clock: Callable[[], float]) -> None:
        """End the trial that plays with a fade; return after it."""
        if self.trial is not None:
            self.trial.stops, end_s = True, clock() + FADED_S
            while clock() < min(end_s, self.trial.ends_s):
                time.sleep(FADE_S)

    def close(self) -> None:
        """End the stream and its sink. May be repeated."""
        self._stack.close()

    def _fill(self, out: Float32Array, now_s: float) -> None:
        trial, stream = self.trial, self._stream
        if trial is not None and stream is not None:
            trial.fill(out, now_s + stream.delay_s)

    def made_nodes(self) -> Mapping[str, str]:  # noqa: D102
        return {taps.TRIALS: SINK}

    def nodes(self, graph: Graph) -> Set[int]:  # noqa: D102
        return {node.id for node in graph.nodes_named(taps.TRIALS)}

    def links(self, graph: Graph) -> Set[LinkPair]:  # noqa: D102
        others = {one.pair for node in self.nodes(graph) for one in graph.links_of(node)}
        return self._of_sound(graph) | others  # others made those

    def _of_sound(self, graph: Graph) -> Set[LinkPair]:
        node, sink = graph.sink(taps.TRIALS), graph.sink(self._heard)
        outputs = graph.ports_of(node.id, taps.MONITOR) if node else {}
        inputs = graph.ports_of(sink.id, taps.PLAYBACK) if sink else {}
        return {
            (outputs[position], inputs[[*inputs][index]])
            for position in HEARD
            for index in taps.channels_of(position, tuple(inputs))
            if outputs.keys() >= set(HEARD)
        }
