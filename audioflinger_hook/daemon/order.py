"""What the daemon was asked for, and what it takes: the two sides, and what they share."""

from __future__ import annotations

from dataclasses import dataclass

from audioflinger_hook.clients import TapAddress
from audioflinger_hook.daemon.engine import Clocks
from audioflinger_hook.daemon.feed import Feed
from audioflinger_hook.daemon.live_input import LiveInput
from audioflinger_hook.daemon.live_output import LiveOutput
from audioflinger_hook.daemon.paced_input import PacedInput
from audioflinger_hook.daemon.paced_output import PacedOutput
from audioflinger_hook.daemon.pacing import Pacer
from audioflinger_hook.daemon.recording import RunRecording
from audioflinger_hook.daemon.sides import InputSide, OutputSide
from audioflinger_hook.service.state import StateKeeper
from audioflinger_hook.settings import Settings
from device.address import DeviceAddress
from device.server import PcmConfig

LIVE_TAPS = ("default", "sink")
PACED_TAPS = ("file", "capture", "scene")
LIVE_DEVICES = ("sink", "usb")
PACED_DEVICES = ("wav", "twin")
"""Kinds of taps and devices: the sound server brings the live ones, we pace the others."""


@dataclass(frozen=True)
class Order:
    """What the daemon was asked for.

    tap, device: of one of the kinds above. offset_s: delay on top of what is needed, in seconds.
    recording: takes what runs; whoever made it begins and closes it.
    """

    tap: TapAddress
    device: DeviceAddress
    settings: Settings
    offset_s: float = 0.0
    recording: RunRecording | None = None


class Sides:
    """Both sides of an order. For the supervising thread alone.

    needs_server: whether one of them does; no server is asked for anything otherwise. feed: what
    the input delivers into.

    Raises
    ------
    UsageError, NotFoundError
        A file to play, or to write, cannot be used.
    """

    def __init__(self, order: Order, clocks: Clocks, states: StateKeeper) -> None:
        live_tap, live_device = order.tap.kind in LIVE_TAPS, order.device.kind in LIVE_DEVICES
        self.needs_server = live_tap or live_device
        self.feed = Feed(order.recording)
        self.input: InputSide
        self.output: OutputSide
        self._pacer = Pacer(clocks.now_s, exact=not self.needs_server)
        if not live_tap:
            self.input = PacedInput(order.tap, self._pacer, self.feed)
        if not live_device:
            rig = order.settings.rig
            self.output = PacedOutput(order.device, self._pacer, rig, order.recording)
        self._pcms: PcmConfig | None = None
        if self.needs_server:
            self._pcms = PcmConfig("cushion_tap", "cushion_output")
            pcms = self._pcms.pcms
            if live_tap:
                self.input = LiveInput(order.tap, pcms["cushion_tap"], states, self.feed)
            if live_device:
                pcm = pcms["cushion_output"]
                self.output = LiveOutput(order.device, pcm, states, order.recording)

    def close(self) -> None:
        """Let both fall silent; they go on when they are kept again. Again too."""
        self.output.close()
        self.input.close()

    def end(self, *, keep: bool) -> None:
        """Let go of both; keep: a file that was written stays. WriteError: it cannot."""
        self.close()
        self._pacer.close()
        if self._pcms:
            self._pcms.close()
        self.input.end(keep=keep)
        self.output.end(keep=keep)
