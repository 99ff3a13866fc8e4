"""`cushion capture` of live sound: records the buffers of a live tap."""

from __future__ import annotations

from audioflinger_hook.capture import CaptureRecorder
from audioflinger_hook.daemon.inputs.sink import SinkInput
from audioflinger_hook.daemon.server_link import ServerLink
from audioflinger_hook.daemon.wake import Wake
from audioflinger_hook.service.state import StateKeeper
from audioflinger_hook.sources import PushTap, TapAddress
from device.errors import LostError, NotFoundError
from device.stream import PcmConfig
from device.units import Float32Array

TICK_S = 0.05  # between ticks, unless an event comes sooner
LOST_LIMIT_S = 10.0  # longest wait for a lost server or sink


class LiveCapture:
    """Records the monitor of one sink, or of the present default sink.

    Its thread calls `tick` whenever `wake` rings, and at least every TICK_S. The stream is guarded,
    so that it never captures a microphone. After it was lost or moved, the capture has a
    discontinuity. heard_s: so far. format: rate in Hz and channels of the latest buffer.
    """

    def __init__(self, address: TapAddress, wake: Wake, now_s: float) -> None:
        self.heard_s = 0.0
        self.format = (0, 0)
        self._tap = PushTap(0, 0)
        self._recorder: CaptureRecorder | None = None
        self._pcms = PcmConfig("cushion_tap")
        self._input = SinkInput(address, self._pcms.pcms["cushion_tap"], StateKeeper(now_s), self)
        self._link = ServerLink(wake.ring, fallback=False)
        self._well_s, self._well_heard_s = now_s, 0.0
        self._reason = ""

    def look(self) -> None:
        """Raise LostError or NotFoundError if the server or the tap is not available."""
        self._link.open(self._well_s)
        self._input.locate(self._link.latest, None)

    def begin(self, recorder: CaptureRecorder) -> None:
        """Record stream `tap` from now on; call it before the first `tick`."""
        self._recorder = recorder

    def tick(self, now_s: float) -> None:
        """Open, check or reopen the tap. LostError: it stayed lost for LOST_LIMIT_S."""
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
        """End the capture's stream. May be repeated; raises nothing."""
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
