"""What a user may choose: how sound becomes vibration, and where both come from and go."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.sources import parse_tap
from audioflinger_hook.sources.address import GRAMMAR as TAPS
from audioflinger_hook.transform import Form, TransformParameters
from audioflinger_hook.transform.parameters import Problem
from device.address import GRAMMAR as DEVICES
from device.address import parse_device
from device.drive import (
    ActuatorSettings,
    ChannelMap,
    channels_needed,
    problems_together,
    sources_of,
    wiring_of,
)
from device.errors import UsageError
from device.rig.rig_file import SHIPPED, SUFFIX, read_rig

Channels = Literal["mono", "each"]

CHOICES: dict[str, tuple[str, ...]] = {
    "profile": tuple(PROFILES),
    "damping": ("off", "auto"),
    "protection": ("off", "on"),
    "exposure_cap": ("off", "action", "limit"),
    "form": ("live", "reference"),
    "channels": ("mono", "each"),
}
"""Every choice by name, with the values that exist; the first one, the paper's, is the default."""

GAIN_MIN_DB = -60.0
GAIN_MAX_DB = 0.0

OF_PROFILE = TransformParameters()
"""Stands for the parameters of whichever profile is chosen: it itself, not its equals."""

RENAMED_PARAMETERS = {
    "follower_db": "loudness_db",
    "follower_target_db": "loudness_target_db",
    "follower_slope_db": "loudness_slope_db",
    "follower_floor_db": "loudness_floor_db",
    "follower_gate_db": "loudness_gate_db",
}
"""Parameters by the name that an older config or capture has for them."""

LABELS = {"form": "transform"}
"""What a choice is called on the command line, where that differs."""


@dataclass(frozen=True)
class Settings:
    """One complete set of choices.

    profile: a named set of parameters (`profiles.PROFILES`); form: which form of the transform;
    channels: `mono` mixes before the transform, `each` transforms every channel by itself; damping:
    whether residual vibration is reduced; protection: whether the rig is kept within its limits,
    which comes with damping; exposure_cap: the value of 2002/44/EC that all vibration since the
    start is kept under, which brings protection along; rig: what is driven, one that ships or a
    file, NAME.toml; gain_db: level of the vibration, -60 to 0; effects_file: an audio_effects.xml
    that says which effects run, None for the bundled one. actuators: what each gets that the device
    drives, on which of its channels; none: the vibration, on all of them. With actuators, their
    sources say what is transformed, and `channels` is `mono`.

    parameters: the profile's where not given; said: the names of those that were chosen one by one
    and stay where another profile is chosen (`choosing`).

    Raises
    ------
    UsageError
        Names every choice that does not exist or is out of range, all at once.
    """

    profile: str = CHOICES["profile"][0]
    damping: str = CHOICES["damping"][0]
    protection: str = CHOICES["protection"][0]
    exposure_cap: str = CHOICES["exposure_cap"][0]
    form: Form = "live"
    channels: Channels = "mono"
    rig: str = SHIPPED[0]
    gain_db: float = GAIN_MAX_DB
    effects_file: Path | None = None
    parameters: TransformParameters = OF_PROFILE
    said: tuple[str, ...] = ()
    actuators: tuple[ActuatorSettings, ...] = ()

    def __post_init__(self) -> None:
        if self.parameters is OF_PROFILE:
            known = self.profile if self.profile in CHOICES["profile"] else CHOICES["profile"][0]
            object.__setattr__(self, "parameters", parameters_of(known))
        problems = [
            f"{LABELS.get(name, name)} {getattr(self, name)!r} is not known; "
            f"allowed: {', '.join(allowed)}"
            for name, allowed in CHOICES.items()
            if getattr(self, name) not in allowed
        ]
        if wrong := wrong_rig(self.rig):
            problems.append(f"rig {self.rig!r} {wrong.wrong}; allowed: {wrong.allowed}")
        if wrong := wrong_gain(self.gain_db):
            problems.append(f"gain_db={self.gain_db!r} {wrong.wrong}; allowed: {wrong.allowed}")
        for number, actuator in enumerate(self.actuators, 1):
            if actuator.rig is not None and (wrong := wrong_rig(actuator.rig)):
                problems.append(
                    f"rig {actuator.rig!r} of actuator {number} {wrong.wrong}; "
                    f"allowed: {wrong.allowed}"
                )
        problems += [
            f"actuator {number} {wrong_wiring}; allowed: {allowed}"
            for number, (wrong_wiring, allowed) in problems_together(
                wiring_of(self.actuators)
            ).items()
        ]
        if self.actuators and self.channels != "mono":
            problems.append(
                f"channels {self.channels!r} cannot be with [[actuator]]; allowed: mono, since "
                "every actuator's source says what it plays"
            )
        if problems:
            raise UsageError("; ".join(problems))

    def choosing(self, **given: Any) -> Settings:
        """Return these settings with others of the given names.

        A profile brings its parameters, but for those that were said by name.

        Raises
        ------
        UsageError
            As upon making them.
        """
        if given.get("profile") in CHOICES["profile"] and "parameters" not in given:
            kept = {name: getattr(self.parameters, name) for name in self.said}
            given["parameters"] = parameters_of(given["profile"], kept)
        return replace(self, **given)

    @property
    def sources(self) -> tuple[str, ...]:
        """The sources that the actuators play, one vibration each; none without actuators."""
        return sources_of(self.actuators)

    @property
    def numbered_channels(self) -> ChannelMap:
        """The actuators on a device of as many channels as they need, such as a file.

        UsageError: one of them goes by a name, and a file's channels have none.
        """
        wiring = wiring_of(self.actuators)
        return ChannelMap.of(
            wiring, channels_needed(wiring), device="a file, a card itself or the twin"
        )


def wrong_rig(value: object, folder: Path | None = None) -> Problem | None:
    """Return what is wrong with a `rig`, None where nothing is. folder: where files are."""
    allowed = f"{', '.join(SHIPPED)}, or a file, NAME{SUFFIX}"
    if not isinstance(value, str):
        return Problem("is not a name", allowed)
    if value in SHIPPED:
        return None
    if not value.endswith(SUFFIX):
        return Problem("is not known", allowed)
    try:
        read_rig((folder or Path()) / value)
    except (UsageError, ValueError) as error:  # ValueError: a path that cannot be
        return Problem(f"cannot be used ({error})", allowed)
    return None


def wrong_gain(value: object) -> Problem | None:
    """Return what is wrong with a `gain_db`, None where nothing is."""
    allowed = f"{GAIN_MIN_DB:g} to {GAIN_MAX_DB:g} dB"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return Problem("is not a number", allowed)
    return None if GAIN_MIN_DB <= value <= GAIN_MAX_DB else Problem("is out of range", allowed)


OFFSET_MAX_MS = 1_000.0
DEVICE_VOLUME_LEAST_DB = -96.0
"""Of any volume control of 16 bits; what a device cannot do becomes its lowest."""

BLOCK_FRAMES = (128, 256, 512, 1024)
"""Frames a callback, of the streams on both sides; fewer are less delay and more work."""

SWITCHES = ("drop_in", "realtime")
LISTS = ("include", "exclude")


@dataclass(frozen=True)
class LiveSettings:
    """One complete set of choices.

    tap: where the sound comes from, one address or several of applications; device: where the
    vibration goes, None for not said. offset_ms: delay on top of what is needed; a negative one
    takes drop_in. drop_in: whether to stand between applications and their sink; block_frames:
    one of `BLOCK_FRAMES`; realtime: whether the audio threads ask for real-time priority;
    device_volume_db: what the device's own volume is set to, None to leave it as it is. include,
    exclude: which applications are felt; their grammar is not checked here.

    Raises
    ------
    UsageError
        Names every choice that cannot be, all at once.
    """

    tap: tuple[str, ...] = ("default",)
    device: str | None = None
    offset_ms: float = 0.0
    drop_in: bool = False
    block_frames: int = 512
    realtime: bool = True
    device_volume_db: float | None = None
    include: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        chosen = {field.name: getattr(self, field.name) for field in fields(self)}
        # None is no text but says that nothing was said.
        found = live_problems({name: value for name, value in chosen.items() if value is not None})
        if found:
            raise UsageError(
                "; ".join(
                    f"{name}={_text(chosen[name])} {problem.wrong}; allowed: {problem.allowed}"
                    for name, problem in found.items()
                )
            )

    @property
    def offset_s(self) -> float:
        """The offset in seconds."""
        return 1e-3 * self.offset_ms


def live_problems(values: Mapping[str, Any]) -> dict[str, Problem]:
    """Return what is wrong with a set of choices, by name; absent ones are the defaults.

    Values may be of any type, as a config file has them: `tap` may be one text, every tuple a
    list. Unknown names are the caller's to report. An empty dict means that the set is usable.
    """
    found = {
        name: Problem("is not true or false", "true, false")
        for name in SWITCHES
        if not isinstance(values.get(name, False), bool)
    }
    wrong = {
        "tap": _wrong_tap(values.get("tap", "default")),
        "device": _wrong_device(values.get("device", "twin")),
        "offset_ms": _wrong_offset(values.get("offset_ms", 0.0), values.get("drop_in", False)),
        "device_volume_db": _wrong_volume(values.get("device_volume_db", 0.0)),
        "block_frames": _wrong_block(values.get("block_frames", LiveSettings.block_frames)),
        **{name: _wrong_list(values.get(name, ())) for name in LISTS},
    }
    return found | {name: problem for name, problem in wrong.items() if problem is not None}


def live_from_document(values: Mapping[str, Any]) -> LiveSettings:
    """Return the settings that a config file means; `live_problems` has found nothing wrong."""
    chosen = dict(values)
    if isinstance(chosen.get("tap"), str):
        chosen["tap"] = [chosen["tap"]]
    for name in ("tap", *LISTS):
        if name in chosen:
            chosen[name] = tuple(chosen[name])
    for name in ("offset_ms", "device_volume_db"):
        if name in chosen:
            chosen[name] = float(chosen[name])
    return LiveSettings(**chosen)


def _wrong_tap(value: Any) -> Problem | None:
    taps = [value] if isinstance(value, str) else value
    if not isinstance(taps, (list, tuple)) or not all(isinstance(tap, str) for tap in taps):
        return Problem("is no tap and no list of taps", TAPS)
    if not taps:
        return Problem("is a list of no taps", TAPS)
    kinds = []
    for tap in taps:
        try:
            kinds.append(parse_tap(tap).kind)
        except UsageError as error:
            return _refused(error, f"tap {tap!r}: ", TAPS)
    if len(taps) > 1 and set(kinds) != {"app"}:
        return Problem(
            "are several taps that are not all applications", "one tap, or app:NAME each"
        )
    return None


def _wrong_device(value: Any) -> Problem | None:
    if not isinstance(value, str):
        return Problem("is no device", DEVICES)
    try:
        parse_device(value)
    except UsageError as error:
        return _refused(error, f"device {value!r}: ", DEVICES)
    return None


def _refused(error: UsageError, prefix: str, allowed: str) -> Problem:
    """Return the problem that a parser found, without the value, which stands there already."""
    wrong = str(error.args[0]).removeprefix(prefix).partition("; allowed: ")[0]
    return Problem(f"is none: {wrong}", allowed)


def _wrong_offset(value: Any, drop_in: Any) -> Problem | None:
    allowed = f"{-OFFSET_MAX_MS:g} to {OFFSET_MAX_MS:g} ms, below 0 with drop_in = true only"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return Problem("is not a number", allowed)
    if not -OFFSET_MAX_MS <= value <= OFFSET_MAX_MS:
        return Problem("is out of range", allowed)
    if value < 0.0 and drop_in is False:
        return Problem(
            "is below 0 without drop_in", f"0 to {OFFSET_MAX_MS:g} ms, or drop_in = true"
        )
    return None


def _wrong_volume(value: Any) -> Problem | None:
    allowed = f"{DEVICE_VOLUME_LEAST_DB:g} to 0 dB"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return Problem("is not a number", allowed)
    if not DEVICE_VOLUME_LEAST_DB <= value <= 0.0:
        return Problem("is out of range", allowed)
    return None


def _wrong_block(value: Any) -> Problem | None:
    if type(value) is int and value in BLOCK_FRAMES:
        return None
    return Problem("is no length of a block", ", ".join(map(str, BLOCK_FRAMES)) + " frames")


def _wrong_list(value: Any) -> Problem | None:
    texts = value if isinstance(value, (list, tuple)) else [None]
    if all(isinstance(text, str) and text.strip() for text in texts):
        return None
    return Problem("is no list of texts that are not empty", '["NAME", ...]')


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return ",".join(map(str, value))
    return str(value).lower() if isinstance(value, bool) else f"{value}"
