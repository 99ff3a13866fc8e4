"""The configuration of one run of the daemon, and the difference between two configurations."""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace
from operator import attrgetter

from audioflinger_hook.config.settings import LiveSettings, Settings
from audioflinger_hook.daemon.recording import RunRecording
from audioflinger_hook.sources import TapAddress, parse_tap
from device.address import DeviceAddress
from device.errors import UsageError
from device.server import AppRules
from device.server.left_out import LeftOut

# Kinds of taps and devices. A thread of the daemon paces the kinds that are not live.
LIVE_TAPS = ("default", "sink", "app")
PACED_TAPS = ("file", "capture", "scene")
SERVER_DEVICES = ("sink", "usb")
CARD_DEVICES = ("hw",)

# Settings of the vibration that change without an interruption.
LEVELS = tuple(name for name, key in Settings.DESCRIPTIONS.items() if key.change == "nothing")


@dataclass(frozen=True)
class RunConfig:
    """All settings from the config file and the command line.

    settings: how sound becomes vibration. recording: the caller begins and closes the recording.
    live: other settings. `live.device` is ignored, and `live.tap` is used only for applications.
    past_server: whether a USB device is opened as a sound card, because no sound server responds.
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
        """Whether the vibration goes to a sink or a sound card."""
        return self.device.kind in SERVER_DEVICES + CARD_DEVICES

    @property
    def device_is_a_card(self) -> bool:
        """Whether the vibration goes to a sound card without the sound server."""
        return self.device.kind in CARD_DEVICES or (self.past_server and self.device.kind == "usb")

    @property
    def needs_server(self) -> bool:
        """Whether the sound server provides the sound or receives the vibration."""
        return self.tap_is_live or self._plays_to_server

    @property
    def needs_plugin(self) -> bool:
        """Whether the Python engine would need ALSA's plugin for sound servers."""
        return self._plays_to_server or (self.tap_is_live and self.rules is None)

    @property
    def _plays_to_server(self) -> bool:
        return self.device.kind in SERVER_DEVICES and not self.device_is_a_card

    @property
    def rules(self) -> AppRules | None:
        """Rules that select applications, None for all. UsageError: the rules are invalid."""
        include, exclude = self.live.include, self.live.exclude
        if self.tap.kind == "app":
            named = (parse_tap(tap).name for tap in self.live.tap)
            return AppRules((*named, *include), exclude, self.left_out.rules)
        if not include and not exclude:
            return None
        if self.tap.kind == "default":
            return AppRules(include, exclude, self.left_out.rules)
        raise UsageError(
            f"applications cannot be chosen from the tap {str(self.tap)!r}; to use include or "
            "exclude in [applications], set tap to default or app:NAME"
        )

    @property
    def left_out(self) -> LeftOut:
        """Which streams cause no vibration, apart from `rules`."""
        rules = self.live.application_rules
        feels = tuple((one.rule, one.feel) for one in rules if one.feel is not None)
        return LeftOut(feels, self.live.feel_calls_and_alerts)


@dataclass(frozen=True)
class ConfigDiff:
    """The groups of settings that differ between two configs.

    A change of level, actuators, volume, offset, priority, left_out interrupts nothing. A change of
    transform fades the vibration out and in again. A change of device reopens its stream. A change
    of tap moves or reopens its stream, or reopens both streams for a new engine. A change of blocks
    reopens both streams. A change of drop_in creates or removes the virtual sink. A change of
    engine restarts the engine and both streams. After a change of way (the key `engine`), the
    daemon chooses again between the native and the Python engine.
    """

    level: bool = False
    actuators: bool = False
    volume: bool = False
    offset: bool = False
    priority: bool = False
    transform: bool = False
    tap: bool = False
    device: bool = False
    left_out: bool = False
    drop_in: bool = False
    blocks: bool = False
    way: bool = False
    engine: bool = False

    @classmethod
    def between(cls, old: RunConfig, new: RunConfig) -> ConfigDiff:
        """Return the difference from `old` to `new`."""
        before, after = old.settings, new.settings
        # A running effect accepts another gain and other parameters, so also another profile.
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
            left_out=old.left_out != new.left_out
            or old.live.application_rules != new.live.application_rules,
            drop_in=old.live.drop_in != new.live.drop_in,
            way=old.live.engine != new.live.engine,
            blocks=old.live.block_frames != new.live.block_frames,
            engine=before != unaffected,
        )

    @property
    def concerns_engine(self) -> bool:
        """Whether to choose again between the native and the Python engine."""
        slight = dict.fromkeys(("level", "volume", "offset", "priority", "left_out"), False)
        return replace(self, **slight).any

    @property
    def any(self) -> bool:
        """Whether anything differs."""
        return any(astuple(self))

    def __str__(self) -> str:
        words = {
            "the level": self.level,
            "the actuators": self.actuators,
            "the device's volume": self.volume,
            "the offset": self.offset,
            "the audio threads' priority": self.priority,
            "the transform": self.transform and not self.engine,
            "the tap": self.tap,
            "the applications' rules": self.left_out,
            "the device": self.device,
            "the virtual sink": self.drop_in,
            "the engine": self.way,
            "the block length, which reopens both streams": self.blocks and not self.engine,
            "the effects": self.engine,
        }
        changed = [text for text, is_so in words.items() if is_so]
        return ", ".join(changed) or "nothing"


def _can_change(before: Settings, after: Settings) -> bool:
    """Whether actuators can change while they play.

    The sources and each actuator's rig, damping, protection and exposure cap must not change.
    """
    fixed = attrgetter("rig", "damping", "protection", "exposure_cap")
    were, are = map(fixed, before.actuators), map(fixed, after.actuators)
    return before.sources == after.sources and [*were] == [*are]


def _selected_sound(config: RunConfig) -> tuple[object, ...]:
    live = config.live
    apps = live.tap if config.tap.kind == "app" else ()
    left_out = config.left_out if apps or live.include or live.exclude else None
    return config.tap, apps, live.include, live.exclude, left_out
