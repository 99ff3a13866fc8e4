"""Both sides of an order, and what they share."""

from __future__ import annotations

from collections.abc import Callable

from audioflinger_hook.daemon.capture_queue import CaptureQueue, Feed
from audioflinger_hook.daemon.device_volume import DeviceVolume
from audioflinger_hook.daemon.engine import Clocks
from audioflinger_hook.daemon.inputs.applications import ApplicationsFeed, ApplicationsInput
from audioflinger_hook.daemon.inputs.paced import PacedInput
from audioflinger_hook.daemon.inputs.sink import SinkInput
from audioflinger_hook.daemon.outputs.card import CardOutput
from audioflinger_hook.daemon.outputs.paced import PacedOutput
from audioflinger_hook.daemon.outputs.sink import SinkOutput
from audioflinger_hook.daemon.pacing import Pacer
from audioflinger_hook.daemon.run_config import ConfigDiff, RunConfig
from audioflinger_hook.daemon.sides import InputSide, OutputSide
from audioflinger_hook.service.state import StateKeeper
from device.errors import UsageError
from device.rig import rig_by_name
from device.stream import AudioPriority, PcmConfig


class Endpoints:
    """Both sides of an order. For the supervising thread alone.

    needs_server: whether one of them does; no server is asked for anything otherwise. feed: what
    the input delivers into. priority: of the audio threads.

    Raises
    ------
    UsageError, NotFoundError
        A file to play, or to write, cannot be used; a rule for applications has a mistake.
    """

    def __init__(
        self,
        order: RunConfig,
        clocks: Clocks,
        states: StateKeeper,
        priority: AudioPriority,
        on_heard: Callable[[], None],
    ) -> None:
        self.needs_server = order.needs_server
        self._states = states
        self._priority = priority
        self._on_heard = on_heard
        is_live = order.tap_is_live or order.device_is_live
        self._pacer = Pacer(clocks.now_s, exact=not is_live)
        self._pcms: PcmConfig | None = None
        self.output: OutputSide
        if not order.device_is_live:
            chosen = order.settings
            self.output = PacedOutput(order.device, self._pacer, chosen, order.recording)
        self.feed: Feed | ApplicationsFeed
        self.input: InputSide
        if not order.tap_is_live:
            feed = self.feed = Feed(order.recording)
            self.input = PacedInput(order.tap, self._pacer, feed)
            if order.live.include or order.live.exclude:
                _ = order.rules  # raises: a file has no applications
        if is_live:
            self._pcms = PcmConfig("cushion_tap", "cushion_output")
            if order.tap_is_live:
                self.input = self._live_input(order)
            if order.device_is_live:
                self.output = self._live_output(order)

    def _live_output(self, order: RunConfig) -> SinkOutput | CardOutput:
        assert self._pcms is not None
        kind = CardOutput if order.device_is_a_card else SinkOutput
        return kind(
            order.device,
            self._pcms.pcms["cushion_output"],
            self._states,
            order.recording,
            block_frames=order.live.block_frames,
            priority=self._priority,
            volume=_volume_of(order),
            actuators=order.settings.actuators,
        )

    def _live_input(self, order: RunConfig) -> SinkInput | ApplicationsInput:
        rules = order.rules
        if rules is not None:
            apps = self.feed = ApplicationsFeed(order.recording, self._priority)
            return ApplicationsInput(_address(order), rules, self._states, apps)
        feed = self.feed = CaptureQueue(order.recording)
        assert self._pcms is not None
        return SinkInput(
            order.tap,
            self._pcms.pcms["cushion_tap"],
            self._states,
            feed,
            block_frames=order.live.block_frames,
            priority=self._priority,
            on_heard=self._on_heard,
        )

    def refuse(self, old: RunConfig, new: RunConfig) -> None:
        """Raise UsageError if what runs cannot go over from one order to the other."""
        for what, before, after, live in (
            ("tap", old.tap, new.tap, old.tap_is_live and new.tap_is_live),
            ("device", old.device, new.device, old.device_is_live and new.device_is_live),
        ):
            if before != after and not live:
                raise UsageError(
                    f"the {what} {str(before)!r} cannot become {str(after)!r} while it runs; start "
                    "it anew"
                )
        if old.needs_server != new.needs_server:
            raise UsageError(
                f"the device {str(old.device)!r} cannot become {str(new.device)!r} while "
                f"{str(old.tap)!r} plays: one is the sound server's, the other is not; start it "
                "anew"
            )
        paced = [old.tap] * (not old.tap_is_live) + [old.device] * (not old.device_is_live)
        if paced and ConfigDiff.between(old, new).engine:
            raise UsageError(
                "form, channels, effects_file, rig, damping, protection, and which actuators there "
                f"are, stay as they are while {str(paced[0])!r} is in use; start it anew"
            )
        if old.device == new.device and old.settings.actuators != new.settings.actuators:
            self.output.refuse(new.settings.actuators)
        if old.recording and old.settings != new.settings:
            raise UsageError(
                "settings cannot change while --record keeps what they make; start it anew"
            )
        _ = new.rules

    def lead_input(self, order: RunConfig) -> bool:
        """Listen elsewhere; whether that takes another engine."""
        rules = order.rules
        if isinstance(self.input, SinkInput) and rules is None:
            self.input.lead(order.tap)
            return False
        if isinstance(self.input, ApplicationsInput) and rules is not None:
            self.input.lead(_address(order), rules)
            return False
        self.input.close()
        self.input = self._live_input(order)
        return True

    def lead_output(self, order: RunConfig) -> None:
        """Play elsewhere; `suit` is to be called anew."""
        kind = CardOutput if order.device_is_a_card else SinkOutput
        if isinstance(self.output, CardOutput | SinkOutput) and isinstance(self.output, kind):
            self.output.lead(order.device)
            return
        self.output.close()
        self.output = self._live_output(order)

    def take(self, order: RunConfig) -> None:
        """Open streams with so many frames a callback from now on; set the device's volume.

        And take what hangs at its channels.
        """
        for side in (self.input, self.output):
            if isinstance(side, SinkInput | SinkOutput | CardOutput):
                side.block_frames = order.live.block_frames
        if isinstance(self.output, SinkOutput | CardOutput):
            self.output.volume.want(_volume_of(order))
        self.output.wire(order.settings.actuators)

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


def _volume_of(order: RunConfig) -> DeviceVolume:
    settings = order.settings
    rigs = {actuator.rig or settings.rig for actuator in settings.actuators} or {settings.rig}
    # One volume for all channels: that of the rig which bears least.
    limit_db = min(rig_by_name(rig).dac.volume_limit_db for rig in rigs)
    return DeviceVolume(order.live.device_volume_db, limit_db)


def _address(order: RunConfig) -> str:
    """What the user asked to hear, for people."""
    live = order.live
    if order.tap.kind == "app":
        return ", ".join(live.tap)
    words = [f"only {', '.join(live.include)}"] if live.include else []
    words += [f"not {', '.join(live.exclude)}"] if live.exclude else []
    return f"{order.tap} ({'; '.join(words)})"
