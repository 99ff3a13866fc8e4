"""Creates the input and the output for a `RunConfig`."""

from collections.abc import Callable

from audioflinger_hook.daemon.capture_queue import CaptureQueue, Feed
from audioflinger_hook.daemon.engine import Clocks
from audioflinger_hook.daemon.inputs.applications import ApplicationsFeed, ApplicationsInput
from audioflinger_hook.daemon.inputs.base import Input
from audioflinger_hook.daemon.inputs.paced import PacedInput
from audioflinger_hook.daemon.inputs.sink import SinkInput
from audioflinger_hook.daemon.outputs.base import Output
from audioflinger_hook.daemon.outputs.card import CardOutput
from audioflinger_hook.daemon.outputs.paced import PacedOutput
from audioflinger_hook.daemon.outputs.sink import SinkOutput
from audioflinger_hook.daemon.pacing import Pacer
from audioflinger_hook.daemon.run_config import Change, RunConfig, changes_between
from audioflinger_hook.service.state import StateKeeper
from device.errors import UsageError
from device.stream import AudioPriority, PcmConfig


class Endpoints:
    """Input and output of one run. UsageError, NotFoundError: one of them cannot be created."""

    def __init__(
        self,
        config: RunConfig,
        clocks: Clocks,
        states: StateKeeper,
        priority: AudioPriority,
        on_heard: Callable[[], None],
    ) -> None:
        self.needs_server = config.needs_server
        self._states, self._priority, self._on_heard = states, priority, on_heard
        is_live = config.tap_is_live or config.device_is_live
        self._pacer = Pacer(clocks.now_s, exact=not is_live)
        self._pcms: PcmConfig | None = None
        self.feed: Feed | ApplicationsFeed
        # Open files first, so that an error of a file leaves no `PcmConfig` open.
        if not config.device_is_live:
            self.output = self._make_output(config)
        if not config.tap_is_live:
            self.input = self._make_input(config)
        if is_live:
            self._pcms = PcmConfig("cushion_tap", "cushion_output")
        if config.tap_is_live:
            self.input = self._make_input(config)
        if config.device_is_live:
            self.output = self._make_output(config)

    def check_change(self, old: RunConfig, new: RunConfig) -> None:
        """Raise UsageError if a running daemon cannot change from config `old` to `new`."""
        for what, before, after, live in (
            ("tap", old.tap, new.tap, old.tap_is_live and new.tap_is_live),
            ("device", old.device, new.device, old.device_is_live and new.device_is_live),
        ):
            if before != after and not live:
                raise UsageError(
                    f"the {what} {str(before)!r} cannot become {str(after)!r} while it runs; "
                    "restart the daemon"
                )
        if old.needs_server != new.needs_server:
            raise UsageError(
                f"the device {str(old.device)!r} cannot become {str(new.device)!r} while "
                f"{str(old.tap)!r} plays: only one of them uses the sound server; restart the "
                "daemon"
            )
        paced = [old.tap] * (not old.tap_is_live) + [old.device] * (not old.device_is_live)
        if paced and Change.ENGINE in changes_between(old, new):
            raise UsageError(
                "form, channels, effects_file, rig, damping, protection and the list of actuators "
                f"cannot change while {str(paced[0])!r} is in use; restart the daemon"
            )
        if old.device == new.device and old.settings.actuators != new.settings.actuators:
            self.output.check_actuators(new.settings.actuators)
        if old.recording and old.settings != new.settings:
            raise UsageError("settings cannot change during --record; restart the daemon")
        _ = new.rules  # raises if a rule is invalid

    def retarget_input(self, config: RunConfig) -> bool:
        """Change the input to the config's tap; return whether a new engine is necessary."""
        if self.input.retarget(config):
            return False
        self.input.close()
        self.input = self._make_input(config)
        return True

    def retarget_output(self, config: RunConfig) -> None:
        """Change to the config's device. The caller must then call the output's `set_format`."""
        if not self.output.retarget(config):
            self.output.close()
            self.output = self._make_output(config)

    def close(self) -> None:
        """Close input and output until their next `maintain`. Repeated calls do nothing."""
        self.output.close()
        self.input.close()

    def end(self, *, keep: bool) -> None:
        """End all streams. keep: whether to keep an output file. WriteError: writing it failed."""
        self.close()
        self._pacer.close()
        if self._pcms:
            self._pcms.close()
        self.input.end()
        self.output.end(keep=keep)

    def _make_input(self, config: RunConfig) -> Input:
        if not config.tap_is_live:
            feed = self.feed = Feed(config.recording)
            paced = PacedInput(config.tap, self._pacer, feed)
            if config.live.include or config.live.exclude:
                _ = config.rules  # raises, because a file has no applications
            return paced
        if config.rules is not None:
            apps = self.feed = ApplicationsFeed(self._priority)
            return ApplicationsInput(config, self._states, apps)
        assert self._pcms is not None
        queue = self.feed = CaptureQueue(config.recording)
        pcm = self._pcms.pcms["cushion_tap"]
        tap = SinkInput(config.tap, pcm, self._states, queue, self._priority, self._on_heard)
        tap.configure(config)
        return tap

    def _make_output(self, config: RunConfig) -> Output:
        if not config.device_is_live:
            return PacedOutput(config, self._pacer)
        assert self._pcms is not None
        kind = CardOutput if config.device_is_a_card else SinkOutput
        return kind(config, self._pcms.pcms["cushion_output"], self._states, self._priority)
