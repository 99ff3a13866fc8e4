"""The configuration of one run of the daemon, and the difference between two configurations."""

from collections.abc import Callable, Set
from dataclasses import dataclass, replace
from enum import Enum
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


class Change(Enum):
    """A group of settings that differ between two configs; the value is its name for users.

    Only these interrupt anything: TRANSFORM fades the vibration out and in again, DEVICE reopens
    its stream, TAP moves or reopens its stream or reopens both for a new engine, and BLOCKS reopens
    both streams. DROP_IN creates or removes the virtual sink. ENGINE restarts the engine and both
    streams. After WAY (the key `engine`), the daemon chooses again between native and Python.
    """

    LEVEL = "the level"
    ACTUATORS = "the actuators"
    VOLUME = "the device's volume"
    OFFSET = "the offset"
    PRIORITY = "the audio threads' priority"
    TRANSFORM = "the transform"
    TAP = "the tap"
    LEFT_OUT = "the applications' rules"
    DEVICE = "the device"
    DROP_IN = "the virtual sink"
    WAY = "the engine"
    BLOCKS = "the block length, which reopens both streams"
    ENGINE = "the effects"


# After these changes, the daemon does not choose again between the native and the Python engine.
SLIGHT = {
    *(Change.LEVEL, Change.ACTUATORS, Change.VOLUME, Change.OFFSET, Change.PRIORITY),
    *(Change.TRANSFORM, Change.LEFT_OUT),
}


def changes_between(old: RunConfig, new: RunConfig) -> set[Change]:
    """Return the groups of settings that differ."""
    found = {change for change, read in _READ.items() if read(old) != read(new)}
    before, after = old.settings, new.settings
    # A running effect accepts another gain and other parameters, so also another profile.
    names = (*LEVELS, "profile", "parameters", "said")
    unaffected = replace(after, **{name: getattr(before, name) for name in names})
    # Actuators can change while they play, but neither the sources nor these keys of an actuator.
    fixed = attrgetter("rig", "damping", "protection", "exposure_cap")
    were, are = ([*map(fixed, one.actuators)] for one in (before, after))
    if before.sources == after.sources and were == are:
        unaffected = replace(unaffected, actuators=before.actuators)
        found |= {Change.ACTUATORS} if before.actuators != after.actuators else set()
    return found | {Change.ENGINE} if before != unaffected else found


def words_of(changes: Set[Change]) -> str:
    """Return the changes for the user, "nothing" for none."""
    hidden = {Change.TRANSFORM, Change.BLOCKS} if Change.ENGINE in changes else set()
    return ", ".join(one.value for one in Change if one in changes - hidden) or "nothing"


def _selected_sound(config: RunConfig) -> tuple[object, ...]:
    live = config.live
    apps = live.tap if config.tap.kind == "app" else ()
    left_out = config.left_out if apps or live.include or live.exclude else None
    return config.tap, apps, live.include, live.exclude, left_out


_READ: dict[Change, Callable[[RunConfig], object]] = {
    Change.LEVEL: attrgetter("muted", *(f"settings.{name}" for name in LEVELS)),
    Change.VOLUME: attrgetter("live.device_volume_db"),
    Change.OFFSET: attrgetter("live.offset_ms"),
    Change.PRIORITY: attrgetter("live.realtime"),
    Change.TRANSFORM: attrgetter("settings.parameters"),
    Change.TAP: _selected_sound,
    Change.LEFT_OUT: attrgetter("left_out", "live.application_rules"),
    Change.DEVICE: attrgetter("device"),
    Change.DROP_IN: attrgetter("live.drop_in"),
    Change.WAY: attrgetter("live.engine"),
    Change.BLOCKS: attrgetter("live.block_frames"),
}
