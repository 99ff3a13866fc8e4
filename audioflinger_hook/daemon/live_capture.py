"""Records the buffers of a live tap, for `cushion capture`."""

from audioflinger_hook.capture import CaptureRecorder
from audioflinger_hook.daemon.inputs.sink import SinkInput
from audioflinger_hook.daemon.server_link import ServerLink
from audioflinger_hook.daemon.timing import Wake
from audioflinger_hook.service.state import StateKeeper
from audioflinger_hook.sources import PushTap, TapAddress
from device.errors import LostError, NotFoundError
from device.stream import PcmConfig
from device.units import Float32Array

TICK_S = 0.05  # longest time between ticks
LOST_LIMIT_S = 10.0  # longest time without recorded sound


class LiveCapture:
    """Records the monitor of a named sink or of the default sink.

    One thread calls `tick` when `wake` rings, and at least every TICK_S seconds. While the server
    connects the stream to a wrong source, such as a microphone, nothing is recorded. heard_s:
    seconds of recorded sound. format: sample rate in Hz and number of channels.
    """

    def __init__(self, address: TapAddress, wake: Wake, now_s: float) -> None:
        self.heard_s, self.format = 0.0, (0, 0)
        self._tap = PushTap(0, 0)
        self._recorder: CaptureRecorder | None = None
        self._pcms = PcmConfig("cushion_tap")
        self._input = SinkInput(address, self._pcms.pcms["cushion_tap"], StateKeeper(now_s), self)
        self._link = ServerLink(wake.ring, fallback=False)
        self._well_s, self._well_heard_s = now_s, 0.0
        self._reason = ""

    def look(self) -> None:
        """Connect, and find the tap. LostError, NotFoundError: server or tap is not available."""
        self._link.open(self._well_s)
        self._input.locate(self._link.latest, None)

    def begin(self, recorder: CaptureRecorder) -> None:
        """Record the sound as stream `tap` from now on. Call it before the first `tick`."""
        self._recorder = recorder

    def tick(self, now_s: float) -> None:
        """Open, check or reopen the tap. LostError: no buffer came for LOST_LIMIT_S seconds."""
        if self.heard_s > self._well_heard_s:
            self._well_heard_s, self._well_s, self._reason = self.heard_s, now_s, ""
        try:
            if self._link.lost:
                self._input.close()
                self._link.close()
            self._link.open(now_s)
            if self._link.connection is not None:
                self._input.locate(self._link.connection.latest, None)
                self._input.maintain(self._link.connection, now_s)
        except (LostError, NotFoundError) as error:
            self._input.close()
            self._reason = f" ({error})"
        if now_s - self._well_s > LOST_LIMIT_S:
            raise LostError(
                f"the tap {str(self._input)!r} was lost and did not come back within "
                f"{LOST_LIMIT_S:g} s{self._reason}"
            )

    def close(self) -> None:
        """Close the stream and the connection. Repeated calls do nothing."""
        self._input.close()
        self._link.close()
        self._pcms.close()

    def opened(self, samplerate: int, channels: int) -> bool:
        """See `FrameReceiver`."""
        self._tap.interrupt()
        return self._tap.change(samplerate, channels)

    def moved(self) -> None:
        """See `FrameReceiver`."""
        self._tap.interrupt()

    def push(self, frames: Float32Array, now_s: float) -> None:
        """See `FrameReceiver`."""
        recorder, tap = self._recorder, self._tap
        if recorder is None:
            return
        discontinuity = tap.push(frames)
        tap.read()
        self.format = (tap.samplerate, tap.channels)
        recorder.offer("tap", frames, tap.samplerate, now_s, discontinuity=discontinuity)
        self.heard_s += len(frames) / tap.samplerate
