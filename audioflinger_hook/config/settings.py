"""What a user may set: the transform, the rig, the source of sound and the target of vibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from audioflinger_hook.config.kinds import Address, FileName, Names, RigName, Taps
from audioflinger_hook.config.profiles import OFFLINE_DEFAULT, PROFILES, parameters_of
from audioflinger_hook.sources import parse_tap
from audioflinger_hook.sources.address import GRAMMAR as TAPS
from audioflinger_hook.transform import Form, TransformParameters
from device.address import GRAMMAR as DEVICES
from device.address import parse_device
from device.drive import (
    ActuatorSettings,
    ChannelMap,
    channels_needed,
    sources_of,
    wiring_of,
    wiring_refusals,
)
from device.drive.damping import resonance_as_damped
from device.drive.settings import DAMPING, EXPOSURE_CAP, GAIN_MAX_DB, GAIN_MIN_DB, PROTECTION
from device.rig.parameters import LEAST_TOLERANCE, MODELS, Model
from device.rig.rig import SHIPPED, rig_by_name
from device.server.forwarding import MAX_DELAY_S
from device.values import Choice, Described, Number, Refusal, Switch

Channels = Literal["mono", "each"]

OFFSET_MIN_MS, OFFSET_MAX_MS = -1e3 * MAX_DELAY_S, 1_000.0  # below 0, the sound is delayed
# Lowest volume of a 16-bit volume control; a device without it uses its own lowest volume.
DEVICE_VOLUME_MIN_DB = -96.0
BLOCK_FRAMES = (128, 256, 512, 1024)  # fewer frames a callback: less delay, more work
ENGINES = ("auto", "native", "python")  # what computes the vibration of live sound

OF_PROFILE = TransformParameters()  # marks the chosen profile's parameters; compared by identity


@dataclass(frozen=True)
class Settings(Described):
    """Settings of the transform, the effects and the rig.

    With actuators, their sources select the transformed sound, and `channels` is "mono".

    parameters: of the transform; default: those of the profile.
    said: names of parameters set individually; they override any profile.
    actuators: each actuator's source and channels; without any, all channels play one vibration.
    UsageError: some choices are refused; the message names all of them.
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
        str, Choice("daily dose allowed by 2002/44/EC; also turns protection on", EXPOSURE_CAP)
    ] = EXPOSURE_CAP[0]
    form: Annotated[
        Form,
        Choice(
            "form of the transform", ("live", "reference"), name="transform", section="transform"
        ),
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
        Model, Choice("model of the simulated rig; auto: the cheapest that suffices", MODELS)
    ] = "auto"
    tolerance: Annotated[
        float,
        Number("error that model = auto may make, as a share of the peak", LEAST_TOLERANCE, 1.0),
    ] = 0.01
    gain_db: Annotated[
        float, Number("level of the vibration", GAIN_MIN_DB, GAIN_MAX_DB, "dB", change="nothing")
    ] = GAIN_MAX_DB
    effects_file: Annotated[
        Path | None,
        FileName(
            "which effects run; default: the haptic effect", "the path of an audio_effects.xml"
        ),
    ] = None
    parameters: TransformParameters = OF_PROFILE
    said: tuple[str, ...] = ()
    actuators: tuple[ActuatorSettings, ...] = ()

    def __post_init__(self) -> None:
        if self.parameters is OF_PROFILE:
            known = self.profile if self.profile in PROFILES else OFFLINE_DEFAULT
            object.__setattr__(self, "parameters", parameters_of(known))
        super().__post_init__()

    @classmethod
    def refusals(cls, values: Mapping[str, Any]) -> dict[str, Refusal]:
        """Return why values are refused, including values of the actuators' rigs and wiring."""
        found, actuators = super().refusals(values), values.get("actuators", ())
        for number, one in enumerate(actuators, 1):
            if one.rig is not None and (refusal := cls.DESCRIPTIONS["rig"].refuse(one.rig)):
                wrong = f"= {one.rig!r} {refusal.wrong}"
                found[f"actuator[{number}].rig"] = replace(refusal, wrong=wrong)
        wiring = wiring_refusals(wiring_of(actuators))
        return found | {f"actuator[{number}]": refusal for number, refusal in wiring.items()}

    @classmethod
    def contradictions(cls, values: Mapping[str, Any]) -> dict[str, Refusal]:
        """Refuse `channels` if actuators have sources."""
        if not values.get("actuators") or values.get("channels") != "each":
            return {}
        allowed = "mono: the source of every [[actuator]] says what it plays"
        return {"channels": Refusal("cannot be used with actuators", allowed)}

    def choosing(self, **given: Any) -> Settings:
        """Return a copy with the given settings changed.

        A profile brings its parameters, except those that were set individually. Raises as the
        constructor.
        """
        if given.get("profile") in PROFILES and "parameters" not in given:
            kept = {name: getattr(self.parameters, name) for name in self.said}
            given["parameters"] = parameters_of(given["profile"], kept)
        return replace(self, **given)

    @cached_property
    def transform_parameters(self) -> TransformParameters:
        """The parameters; strength "rig" without a resonance gets that of the damped rig.

        A profile's strength "felt" becomes "rig" where one rig is set: another one than the
        default, or one that is damped, protected or whose exposure is limited. The rig is read
        once. UsageError: its file cannot be read any more.
        """
        chosen, driven = self.parameters, self._driven
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
    def _driven(self) -> set[tuple[str, ...]]:
        """The actuators' rigs, each with damping, protection and exposure cap."""
        own = (self.rig, self.damping, self.protection, self.exposure_cap)
        names = ("rig", "damping", "protection", "exposure_cap")
        return {
            tuple(getattr(one, name, None) or mine for name, mine in zip(names, own, strict=True))
            for one in self.actuators
        } or {own}

    @property
    def sources(self) -> tuple[str, ...]:
        """The actuators' sources, each with its own vibration; empty without actuators."""
        return sources_of(self.actuators)

    @property
    def numbered_channels(self) -> ChannelMap:
        """The actuators on a device with exactly the channels that they need, such as a file.

        UsageError: an actuator's channel is given by name.
        """
        wiring = wiring_of(self.actuators)
        return ChannelMap.of(
            wiring, channels_needed(wiring), device="a file, a card itself or the twin"
        )


@dataclass(frozen=True)
class LiveSettings(Described):
    """Where live sound comes from, where the vibration goes, and the settings of the streams.

    `device` is None if none is chosen; `device_volume_db` is None if the volume stays unchanged.

    UsageError: some choices are refused; the message names all of them.
    """

    tap: Annotated[
        tuple[str, ...], Taps("where the sound comes from", TAPS, parse_tap, "tap", change="stream")
    ] = ("default",)
    device: Annotated[
        str | None,
        Address("where the vibration goes", DEVICES, parse_device, "device", change="stream"),
    ] = None
    offset_ms: Annotated[
        float,
        Number(
            "delay of the vibration; below 0 it is earlier, only with drop_in",
            OFFSET_MIN_MS,
            OFFSET_MAX_MS,
            "ms",
            change="nothing",
        ),
    ] = 0.0
    drop_in: Annotated[
        bool, Switch("applications play to a virtual sink, which delays the sound", change="stream")
    ] = False
    block_frames: Annotated[
        int, Choice("frames of one audio callback", BLOCK_FRAMES, "frames", change="streams")
    ] = 512
    realtime: Annotated[
        bool, Switch("ask for real-time priority for the audio threads", change="next stream")
    ] = True
    engine: Annotated[
        str,
        Choice(
            "native: inside PipeWire, 8 ms after the sound; auto: native wherever it can",
            ENGINES,
            change="another engine",
        ),
    ] = ENGINES[0]
    device_volume_db: Annotated[
        float | None,
        Number(
            "set the device's own volume; default: leave it",
            DEVICE_VOLUME_MIN_DB,
            0.0,
            "dB",
            off=True,
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

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.device_volume_db is not None:
            described = self.DESCRIPTIONS["device_volume_db"]
            object.__setattr__(self, "device_volume_db", described.typed(self.device_volume_db))

    @classmethod
    def contradictions(cls, values: Mapping[str, Any]) -> dict[str, Refusal]:
        """Refuse an offset below 0 without drop-in mode: only drop-in mode delays the sound."""
        if values.get("drop_in") is not False or values.get("offset_ms", 0.0) >= 0.0:
            return {}
        allowed = f"0 to {OFFSET_MAX_MS:g} ms, or drop_in = true"
        return {"offset_ms": Refusal("is below 0 without drop_in", allowed)}

    @property
    def offset_s(self) -> float:
        """The offset in seconds."""
        return 1e-3 * self.offset_ms
