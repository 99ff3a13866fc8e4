"""User settings: the transform, the rig, where the sound comes from, where the vibration goes."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from audioflinger_hook.config.applications import ApplicationRule
from audioflinger_hook.config.kinds import Address, FileName, Names, RigName, Taps
from audioflinger_hook.config.profiles import OFFLINE_DEFAULT, PROFILES, parameters_of
from audioflinger_hook.sources import parse_tap
from audioflinger_hook.sources.address import GRAMMAR as TAPS
from audioflinger_hook.transform import Form, TransformParameters
from device import drive
from device.address import GRAMMAR as DEVICES
from device.address import parse_device
from device.drive.damping import resonance_as_damped
from device.drive.settings import DAMPING, EXPOSURE_CAP, GAIN_MAX_DB, GAIN_MIN_DB, PROTECTION
from device.rig.parameters import LEAST_TOLERANCE, MODELS, Model
from device.rig.rig import SHIPPED, rig_by_name
from device.server.forwarding import MAX_DELAY_S
from device.values import OFF, Choice, Described, Number, Refusal, Switch

Channels = Literal["mono", "each"]

AUTO = "auto"  # as a value of `offset_ms`: the daemon finds the delay
OFFSET_MIN_MS, OFFSET_MAX_MS = -1e3 * MAX_DELAY_S, 1_000.0  # an offset below 0 delays the sound
BLOCK_FRAMES = (128, 256, 512, 1024)  # fewer frames per callback reduce latency and cost CPU time
ENGINES = ("auto", "native", "python")  # engines that compute live vibration

OF_PROFILE = TransformParameters()  # this object stands for the parameters of the profile


@dataclass(frozen=True)
class Settings(Described):
    """Settings of the transform, the effects and the rig.

    With actuators, `channels` is "mono", and each actuator's `source` selects its signal.

    parameters: parameters of the transform; by default those of the profile.
    said: names of parameters that the user set; another profile does not change their values.
    actuators: if empty, all channels of the device, or its known coil channels, play the vibration.
    UsageError: one or more values are not allowed; the message names all of them.
    """

    profile: Annotated[
        str, Choice("named set of transform parameters", tuple(PROFILES), change="transform")
    ] = OFFLINE_DEFAULT
    damping: Annotated[
        str, Choice("reduce the rig's ringing; also turns protection on", DAMPING)
    ] = DAMPING[0]
    protection: Annotated[
        str, Choice("keep the rig within its limits, and count exposure", PROTECTION)
    ] = PROTECTION[0]
    exposure_cap: Annotated[
        str, Choice("limit daily exposure by 2002/44/EC; also turns protection on", EXPOSURE_CAP)
    ] = EXPOSURE_CAP[0]
    form: Annotated[
        Form, Choice("form of the transform", get_args(Form), name="transform", section="transform")
    ] = "live"
    channels: Annotated[
        Channels,
        Choice(
            "transform the mono mix of all channels, or each channel separately",
            ("mono", "each"),
            section="transform",
        ),
    ] = "mono"
    rig: Annotated[str, RigName("rig that is driven, or its file", change="engine")] = SHIPPED[0]
    model: Annotated[
        Model, Choice("model of the simulated rig; auto: the fastest within tolerance", MODELS)
    ] = "auto"
    tolerance: Annotated[
        float, Number("largest error of model = auto, as a share of the peak", LEAST_TOLERANCE, 1.0)
    ] = 0.01
    gain_db: Annotated[
        float, Number("level of the vibration", GAIN_MIN_DB, GAIN_MAX_DB, "dB", change="nothing")
    ] = GAIN_MAX_DB
    effects_file: Annotated[
        Path | None,
        FileName("effects to run; default: the haptic effect", "the path of an audio_effects.xml"),
    ] = None
    parameters: TransformParameters = OF_PROFILE
    said: tuple[str, ...] = ()
    actuators: tuple[drive.ActuatorSettings, ...] = ()

    def __post_init__(self) -> None:
        if self.parameters is OF_PROFILE:
            known = self.profile if self.profile in PROFILES else OFFLINE_DEFAULT
            object.__setattr__(self, "parameters", parameters_of(known))
        super().__post_init__()

    @classmethod
    def refusals(cls, values: Mapping[str, Any]) -> dict[str, Refusal]:
        """Return why values of settings or of actuators are not allowed, keyed by name."""
        found, actuators = super().refusals(values), values.get("actuators", ())
        for number, one in enumerate(actuators, 1):
            if one.rig is not None and (refusal := cls.DESCRIPTIONS["rig"].refuse(one.rig)):
                wrong = f"= {one.rig!r} {refusal.wrong}"
                found[f"actuator[{number}].rig"] = replace(refusal, wrong=wrong)
        wiring = drive.wiring_refusals(drive.wiring_of(actuators))
        return found | {f"actuator[{number}]": refusal for number, refusal in wiring.items()}

    @classmethod
    def contradictions(cls, values: Mapping[str, Any]) -> dict[str, Refusal]:
        """Return why "each" is not allowed as `channels` with actuators; otherwise {}."""
        if not values.get("actuators") or values.get("channels") != "each":
            return {}
        allowed = "mono: each [[actuator]] selects its signal with source"
        return {"channels": Refusal("cannot be used with actuators", allowed)}

    def choosing(self, **given: Any) -> "Settings":
        """Return a copy with `given` values. A new profile changes no parameters in `said`."""
        if given.get("profile") in PROFILES and "parameters" not in given:
            kept = {name: getattr(self.parameters, name) for name in self.said}
            given["parameters"] = parameters_of(given["profile"], kept)
        return replace(self, **given)

    @cached_property
    def transform_parameters(self) -> TransformParameters:
        """The parameters for the transform, with the rig's resonance if `strength` is "rig".

        If the user set `resonance_hz`, the rig's resonance is not used. A profile's `strength`
        becomes "rig" if all actuators share one rig, damping, protection and exposure cap, and one
        of these is not the default. UsageError: the rig file cannot be read.
        """
        driven = set(self.drives)
        chosen = self.parameters
        of_profile = PROFILES[self.profile].get("strength")
        if of_profile and chosen.strength == of_profile.value and "strength" not in self.said:
            unset = {(SHIPPED[0], DAMPING[0], PROTECTION[0], EXPOSURE_CAP[0])}
            if len(driven) == 1 and driven != unset:
                chosen = replace(chosen, strength="rig")
        if chosen.strength != "rig" or chosen.resonance_hz:
            return chosen
        rig, damping = min(driven)[:2] if len(driven) == 1 else (self.rig, self.damping)
        hz, q, gain_db = resonance_as_damped(rig_by_name(rig).actuator, damping == "auto")
        return replace(chosen, resonance_hz=hz, resonance_q=q, resonance_gain_db=gain_db)

    @property
    def drives(self) -> tuple[tuple[str, ...], ...]:
        """Rig, damping, protection and exposure cap of each actuator, or of all channels."""
        names = ("rig", "damping", "protection", "exposure_cap")
        return tuple(
            tuple(getattr(one, name) or getattr(self, name) for name in names)
            for one in self.actuators or (self,)
        )

    @property
    def sources(self) -> tuple[str, ...]:
        """The parts of the sound that actuators play, such as "left"; () without actuators."""
        return drive.sources_of(self.actuators)

    @property
    def numbered_channels(self) -> drive.ChannelMap:
        """The actuators' channels on a device without channel names.

        UsageError: an actuator's channel is given by its name.
        """
        wiring = drive.wiring_of(self.actuators)
        return drive.ChannelMap.of(
            wiring, drive.channels_needed(wiring), device="a file, a card itself or the twin"
        )


@dataclass(frozen=True)
class LiveSettings(Described):
    """Where live sound comes from, where the vibration goes, and settings of the streams.

    device: None if no device is chosen. device_volume_db: None does not change the volume.
    UsageError: one or more values are not allowed; the message names all of them.
    """

    tap: Annotated[
        tuple[str, ...], Taps("where the sound comes from", TAPS, parse_tap, "tap", change="stream")
    ] = ("default",)
    device: Annotated[
        str | None,
        Address("where the vibration goes", DEVICES, parse_device, "device", change="stream"),
    ] = None
    offset_ms: Annotated[
        float | str,
        Number(
            "delay of the vibration; auto: as late as the sound; a negative delay requires drop_in",
            OFFSET_MIN_MS,
            OFFSET_MAX_MS,
            "ms",
            word=AUTO,
            change="nothing",
        ),
    ] = AUTO
    drop_in: Annotated[
        bool, Switch("applications play to a virtual sink, which delays the sound", change="stream")
    ] = False
    block_frames: Annotated[
        int, Choice("frames of one audio callback", BLOCK_FRAMES, "frames", change="streams")
    ] = 512
    realtime: Annotated[
        bool, Switch("request real-time priority for the audio threads", change="next stream")
    ] = True
    engine: Annotated[
        str,
        Choice(
            "native: inside PipeWire, 8 ms after the sound; auto: native if possible",
            ENGINES,
            change="another engine",
        ),
    ] = ENGINES[0]
    device_volume_db: Annotated[
        float | None,
        Number(
            "set the device's own volume; default: keep it",
            -96.0,  # a device whose lowest volume is higher uses its own
            0.0,
            "dB",
            word=OFF,
            change="nothing",
        ),
    ] = None
    include: Annotated[
        tuple[str, ...],
        Names("applications to play; default: all", section="applications", change="stream"),
    ] = ()
    exclude: Annotated[
        tuple[str, ...], Names("applications to leave out", section="applications", change="stream")
    ] = ()
    feel_calls_and_alerts: Annotated[
        bool, Switch("feel calls, notifications and alerts", section="live", change="nothing")
    ] = False
    application_rules: tuple[ApplicationRule, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.device_volume_db is not None:
            described = self.DESCRIPTIONS["device_volume_db"]
            object.__setattr__(self, "device_volume_db", described.typed(self.device_volume_db))

    @classmethod
    def contradictions(cls, values: Mapping[str, Any]) -> dict[str, Refusal]:
        """Return why `offset_ms` below 0 is not allowed without drop-in mode; otherwise {}.

        A negative offset delays the sound, which only drop-in mode can do.
        """
        offset_ms = values.get("offset_ms", AUTO)
        if values.get("drop_in") is not False or offset_ms == AUTO or offset_ms >= 0.0:
            return {}
        allowed = f"0 to {OFFSET_MAX_MS:g} ms, or drop_in = true"
        return {"offset_ms": Refusal("is below 0 without drop_in", allowed)}

    @property
    def offset_s(self) -> float | None:
        """The delay of the vibration in seconds; below 0, the sound is delayed. None: auto."""
        return None if isinstance(self.offset_ms, str) else 1e-3 * self.offset_ms
