"""What the daemon was asked for, and what another order changes."""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace

from audioflinger_hook.config.settings import LiveSettings, Settings
from audioflinger_hook.daemon.recording import RunRecording
from audioflinger_hook.sources import TapAddress, parse_tap
from device.address import DeviceAddress
from device.drive import ActuatorSettings
from device.errors import UsageError
from device.server import AppRules

LIVE_TAPS = ("default", "sink", "app")
PACED_TAPS = ("file", "capture", "scene")
SERVER_DEVICES = ("sink", "usb")
CARD_DEVICES = ("hw",)
"""Kinds of taps and devices: the sound server brings the live ones, cards keep their own time, we
pace the others."""


@dataclass(frozen=True)
class RunConfig:
    """Everything that was asked for.

    tap, device: where sound comes from and vibration goes; settings: how one is made of the
    other; live: all else, of which device does not count here, and tap if it is no application.
    recording: takes what runs; whoever made it begins and closes it. past_server: whether a USB
    device is a card itself, as there is no sound server.
    """

    tap: TapAddress
    device: DeviceAddress
    settings: Settings
    live: LiveSettings
    recording: RunRecording | None = None
    past_server: bool = False

    @property
    def tap_is_live(self) -> bool:
        """Whether the sound is the sound server's."""
        return self.tap.kind in LIVE_TAPS

    @property
    def device_is_live(self) -> bool:
        """Whether the vibration goes to something that asks for it in its own time."""
        return self.device.kind in SERVER_DEVICES + CARD_DEVICES

    @property
    def device_is_a_card(self) -> bool:
        """Whether the vibration goes to a card itself, past the sound server."""
        return self.device.kind in CARD_DEVICES or (self.past_server and self.device.kind == "usb")

    @property
    def needs_server(self) -> bool:
        """Whether sound or vibration is the sound server's."""
        return self.tap_is_live or (
            self.device.kind in SERVER_DEVICES and not self.device_is_a_card
        )

    @property
    def rules(self) -> AppRules | None:
        """Return which applications are felt by themselves, None where their mix is.

        Raises
        ------
        UsageError
            A rule cannot be read, or there are rules for a tap that knows no applications.
        """
        include, exclude = self.live.include, self.live.exclude
        if self.tap.kind == "app":
            return AppRules((*(parse_tap(tap).name for tap in self.live.tap), *include), exclude)
        if not include and not exclude:
            return None
        if self.tap.kind == "default":
            return AppRules(include, exclude)
        raise UsageError(
            f"tap {str(self.tap)!r} knows no single applications; for include and exclude of "
            "[applications] the tap has to be default or app:NAME"
        )


@dataclass(frozen=True)
class ConfigDiff:
    """What is another from one order to the next, by what it takes.

    level, volume, offset, priority: nothing is interrupted; volume is the device's own; the offset
    is a jump of the delay, faded over 5 ms; actuators: level, polarity, delay, source or channels
    of some, each faded over one block or 10 ms; a priority that is wanted is that of streams that
    are opened from now on.
    transform: the vibration fades out and begins anew after the transform's latency. tap, device:
    the one stream is led elsewhere or opened anew. drop_in: the virtual sink comes or goes.
    blocks: both streams are opened anew. engine: everything but the connection begins anew.
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
    engine: bool = False

    @classmethod
    def between(cls, old: RunConfig, new: RunConfig) -> ConfigDiff:
        """Return what `new` changes of `old`."""
        before, after = old.settings, new.settings
        # The effect takes another level and other parameters while it runs, and nothing else; a
        # profile is its parameters.
        alike = replace(
            after,
            gain_db=before.gain_db,
            profile=before.profile,
            parameters=before.parameters,
            said=before.said,
        )
        follow = _can_follow(before, after)
        if follow:
            alike = replace(alike, actuators=before.actuators)
        return cls(
            level=before.gain_db != after.gain_db,
            actuators=follow and before.actuators != after.actuators,
            volume=old.live.device_volume_db != new.live.device_volume_db,
            offset=old.live.offset_ms != new.live.offset_ms,
            priority=old.live.realtime != new.live.realtime,
            transform=before.parameters != after.parameters,
            tap=_what_is_heard(old) != _what_is_heard(new),
            device=old.device != new.device,
            drop_in=old.live.drop_in != new.live.drop_in,
            blocks=old.live.block_frames != new.live.block_frames,
            engine=before != alike,
        )

    @property
    def any(self) -> bool:
        """Whether anything is another."""
        return any(astuple(self))

    def __str__(self) -> str:
        """Return what changed, for people, in one line."""
        words = {
            "the level": self.level,
            "the actuators": self.actuators,
            "the device's volume": self.volume,
            "the offset": self.offset,
            "the audio threads' priority": self.priority,
            "the transform, which begins anew": self.transform and not self.engine,
            "the tap": self.tap,
            "the device": self.device,
            "the virtual sink": self.drop_in,
            "the blocks, so that both streams open anew": self.blocks and not self.engine,
            "the effects, so that everything begins anew": self.engine,
        }
        changed = [text for text, is_so in words.items() if is_so]
        return ", ".join(changed) or "nothing"


def _can_follow(before: Settings, after: Settings) -> bool:
    """Whether the actuators can go over while they play: as many, the same rigs and sources."""
    were, are = before.actuators, after.actuators
    return before.sources == after.sources and [_fixed(a) for a in were] == [_fixed(a) for a in are]


def _fixed(actuator: ActuatorSettings) -> tuple[str | None, ...]:
    """What stays as it is while it plays."""
    return actuator.rig, actuator.damping, actuator.protection, actuator.exposure_cap


def _what_is_heard(order: RunConfig) -> tuple[object, ...]:
    live = order.live
    apps = live.tap if order.tap.kind == "app" else ()
    return order.tap, apps, live.include, live.exclude
