"""The configuration of one run of the daemon, and the difference between two of them."""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace
from operator import attrgetter

from audioflinger_hook.config.settings import LiveSettings, Settings
from audioflinger_hook.daemon.recording import RunRecording
from audioflinger_hook.sources import TapAddress, parse_tap
from device.address import DeviceAddress
from device.errors import UsageError
from device.server import AppRules

# Kinds of taps and devices; a thread of the daemon paces those that are not live.
LIVE_TAPS = ("default", "sink", "app")
PACED_TAPS = ("file", "capture", "scene")
SERVER_DEVICES = ("sink", "usb")
CARD_DEVICES = ("hw",)

# Settings of the vibration whose change interrupts nothing.
LEVELS = tuple(name for name, key in Settings.DESCRIPTIONS.items() if key.change == "nothing")


@dataclass(frozen=True)
class RunConfig:
    """Everything that the config file and the options request.

    settings: how vibration is made from sound. live: all other settings; its device is not used
    here, and its tap only for applications. recording: the code that made it begins and closes it.
    past_server: whether a USB device is opened as a card, because no sound server answers.
    """

    tap: TapAddress
    device: DeviceAddress
    settings: Settings
    live: LiveSettings
    recording: RunRecording | None = None
    past_server: bool = False
    muted: bool = False

    @property
    def tap_is_live(self) -> bool:
        """Whether the sound server provides the sound."""
        return self.tap.kind in LIVE_TAPS

    @property
    def device_is_live(self) -> bool:
        """Whether a sink or card paces the output."""
        return self.device.kind in SERVER_DEVICES + CARD_DEVICES

    @property
    def device_is_a_card(self) -> bool:
        """Whether the vibration goes to a card without the sound server."""
        return self.device.kind in CARD_DEVICES or (self.past_server and self.device.kind == "usb")

    @property
    def needs_server(self) -> bool:
        """Whether the sound server provides the sound or takes the vibration."""
        return self.tap_is_live or self._plays_to_server

    @property
    def needs_plugin(self) -> bool:
        """Whether the Python engine reaches the sound server through ALSA's plugin."""
        return self._plays_to_server or (self.tap_is_live and self.rules is None)

    @property
    def _plays_to_server(self) -> bool:
        return self.device.kind in SERVER_DEVICES and not self.device_is_a_card

    @property
    def rules(self) -> AppRules | None:
        """The rules that select single applications, None for all. UsageError: they are invalid."""
        include, exclude = self.live.include, self.live.exclude
        if self.tap.kind == "app":
            return AppRules((*(parse_tap(tap).name for tap in self.live.tap), *include), exclude)
        if not include and not exclude:
            return None
        if self.tap.kind == "default":
            return AppRules(include, exclude)
        raise UsageError(
            f"applications cannot be chosen from the tap {str(self.tap)!r}; to use include or "
            "exclude in [applications], set tap to default or app:NAME"
        )


@dataclass(frozen=True)
class ConfigDiff:
    """The differences of two configs, grouped by what the change interrupts.

    These interrupt nothing: level (and mute), volume (of the device), priority (of later streams),
    actuators (faded) and offset (the delay jumps, faded over 5 ms). transform fades out and
    restarts after its latency. tap and device reopen one stream, drop_in the virtual sink, blocks
    both streams, engine everything but the connection. way: the native or the Python engine.
    """

    level: bool = False
    actuators: bool = False
    volume: bool = False
    offset: bool = False
    priority: bool = False
    transform: bool = False
    tap: bool = False
    device: bool = False
    drop_in: bool = False
    blocks: bool = False
    way: bool = False
    engine: bool = False

    @classmethod
    def between(cls, old: RunConfig, new: RunConfig) -> ConfigDiff:
        """Return the difference from `old` to `new`."""
        before, after = old.settings, new.settings
        # A running effect accepts another level and other parameters; a profile is a set of
        # parameters.
        levels = {name: getattr(before, name) for name in LEVELS}
        kept = {name: getattr(before, name) for name in ("profile", "parameters", "said")}
        unaffected = replace(after, **levels, **kept)
        actuators_change = _can_change(before, after)
        if actuators_change:
            unaffected = replace(unaffected, actuators=before.actuators)
        return cls(
            level=old.muted != new.muted
            or any(getattr(after, name) != value for name, value in levels.items()),
            actuators=actuators_change and before.actuators != after.actuators,
            volume=old.live.device_volume_db != new.live.device_volume_db,
            offset=old.live.offset_ms != new.live.offset_ms,
            priority=old.live.realtime != new.live.realtime,
            transform=before.parameters != after.parameters,
            tap=_selected_sound(old) != _selected_sound(new),
            device=old.device != new.device,
            drop_in=old.live.drop_in != new.live.drop_in,
            way=old.live.engine != new.live.engine,
            blocks=old.live.block_frames != new.live.block_frames,
            engine=before != unaffected,
        )

    @property
    def concerns_engine(self) -> bool:
        """Whether another engine may be needed, or one that failed may work now."""
        slight = dict.fromkeys(("level", "volume", "offset", "priority"), False)
        return replace(self, **slight).any

    @property
    def any(self) -> bool:
        """Whether anything differs."""
        return any(astuple(self))

    def __str__(self) -> str:
        """Return one line that lists the changes."""
        words = {
            "the level": self.level,
            "the actuators": self.actuators,
            "the device's volume": self.volume,
            "the offset": self.offset,
            "the audio threads' priority": self.priority,
            "the transform, which restarts": self.transform and not self.engine,
            "the tap": self.tap,
            "the device": self.device,
            "the virtual sink": self.drop_in,
            "the engine": self.way,
            "the block length, which reopens both streams": self.blocks and not self.engine,
            "the effects, which restart everything": self.engine,
        }
        changed = [text for text, is_so in words.items() if is_so]
        return ", ".join(changed) or "nothing"


def _can_change(before: Settings, after: Settings) -> bool:
    """Whether the actuators can change while they play: equal number, rigs and sources."""
    fixed = attrgetter("rig", "damping", "protection", "exposure_cap")
    were, are = map(fixed, before.actuators), map(fixed, after.actuators)
    return before.sources == after.sources and [*were] == [*are]


def _selected_sound(config: RunConfig) -> tuple[object, ...]:
    live = config.live
    apps = live.tap if config.tap.kind == "app" else ()
    return config.tap, apps, live.include, live.exclude
