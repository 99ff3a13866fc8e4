"""What the haptic effect declares: its descriptor and its parameters."""

from __future__ import annotations

from dataclasses import asdict, fields
from typing import Any, cast
from uuid import UUID

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.effect.interface import (
    Command,
    EffectConfig,
    EffectDescriptor,
    EffectFlag,
    Parameter,
    Value,
    Values,
    VendorCommand,
)
from audioflinger_hook.mixer.layouts import source_weights
from audioflinger_hook.transform import Form, HapticTransform, TransformParameters
from device.drive import SOURCES
from device.errors import UsageError
from device.units import db_to_amplitude
from device.values import Choice, Description, Number

TRANSFORM_FIELDS = tuple(field.name for field in fields(TransformParameters))


def _parameter(name: str, described: Description, default: Value, meaning: str = "") -> Parameter:
    meaning = meaning or described.meaning
    if isinstance(described, Number):
        low, high, unit = described.low, described.high, described.unit
        return Parameter(name, type(default), default, low, high, unit=unit, meaning=meaning)
    assert isinstance(described, Choice)
    words = tuple(map(str, described.words))
    return Parameter(name, str, default, choices=words, meaning=meaning)


def _switch(name: str, default: bool, meaning: str) -> Parameter:
    return Parameter(name, bool, default, meaning=meaning)


RESTARTING = frozenset({*TRANSFORM_FIELDS, "form", "per_channel", "sources"})
"""Parameters whose change needs a new transform."""

HAPTIC_PARAMETERS = (
    *(
        _parameter(name, described, getattr(TransformParameters, name))
        for name, described in TransformParameters.DESCRIPTIONS.items()
    ),
    _parameter("form", Settings.DESCRIPTIONS["form"], Settings.form),
    _switch("per_channel", False, "transform each channel instead of the mono mix of all"),
    Parameter(
        *("sources", str, ""),
        meaning="source of each haptic channel instead, such as left,right; empty: see per_channel",
    ),
    _parameter(
        *("gain_db", Settings.DESCRIPTIONS["gain_db"], Settings.gain_db),
        "level of the vibration; reached over one buffer",
    ),
    _switch("mute", False, "down to silence over one buffer, and back in the same way"),
    _switch("clip", True, "limit to full scale; without it the reference form may exceed it"),
    Parameter("latency_frames", int, unit="frames", meaning="by which vibration follows its sound"),
    Parameter("limited_samples", int, meaning="of vibration, changed by limiter or full scale"),
    Parameter("replaced_samples", int, meaning="of sound, unusable and taken for 0"),
)
"""All parameters; the last three can only be read. Without a stream, reading them gives ENODATA."""


def transform_parameters(values: Values) -> TransformParameters:
    """Return the values that belong to the transform."""
    chosen: dict[str, Any] = {name: values[name] for name in TRANSFORM_FIELDS}
    return TransformParameters(**chosen)


def is_possible(values: Values) -> bool:
    """Return whether the values can be used together."""
    if not {*sources(values)} <= {*SOURCES} or (values["sources"] and values["per_channel"]):
        return False
    try:
        transform_parameters(values)
    except UsageError:
        return False
    return True


def sources(values: Values) -> tuple[str, ...]:
    """Return the source of each haptic channel; empty if no sources are chosen."""
    chosen = values["sources"]
    return tuple(chosen.split(",")) if isinstance(chosen, str) and chosen else ()


def amplitude(values: Values) -> float:
    """Return the factor that results from gain and mute, 0 to 1."""
    gain_db = values["gain_db"]
    assert isinstance(gain_db, (int, float))
    return 0.0 if values["mute"] else db_to_amplitude(gain_db)


def from_settings(settings: Settings) -> dict[str, Value]:
    """Return the effect's parameters for a user's settings."""
    return {
        **asdict(settings.transform_parameters),
        "form": settings.form,
        "per_channel": settings.channels == "each",
        "sources": ",".join(settings.sources),
        "gain_db": settings.gain_db,
    }


def transform_for(config: EffectConfig, values: Values) -> HapticTransform | None:
    """Return a transform for a stream (takes about 6 ms), or None if none can be made."""
    chosen = sources(values)
    # Without weights the transform treats only the mix.
    mixed = chosen not in ((), ("mix",))
    try:
        return HapticTransform(
            config.samplerate,
            config.channels,
            transform_parameters(values),
            form=cast(Form, values["form"]),
            per_channel=values["per_channel"] is True,
            weights=source_weights(config.channels, chosen) if mixed else None,
            # The haptic channels are float32; only a gain would be multiplied before.
            single=amplitude(values) == 1.0,
        )
    except (UsageError, ValueError):
        # ValueError: a band that a low sample rate cannot hold has no filter.
        return None


# Vendor commands.
DRAIN = Command.FIRST_PROPRIETARY + 1
"""Replies with the rest of the vibration after the end of the sound, (latency_frames, haptic
channels) float32, and resets. The reply is silence while disabled."""

PRINCIPAL = Command.FIRST_PROPRIETARY + 2
"""Replies as `HapticTransform.principal`. It changes nothing, and any thread may send it."""

GLIDES = Command.FIRST_PROPRIETARY + 3
"""Replies as `HapticTransform.take_glides`, before the gain. For files only."""

HAPTIC_CUSHION = EffectDescriptor(
    type_uuid=UUID("ba39e606-2bd4-4eb4-9ed7-0e63c0415600"),
    uuid=UUID("e6e06d15-d79b-427b-8572-ef1ff53c4fb1"),
    name="Haptic Cushion",
    implementor="Haptic Cushion",
    # Last: it must read the sound after every effect that changes it.
    flags=EffectFlag.INSERT | EffectFlag.INSERT_LAST,
    cpu_load=1_000,
    memory_kb=256,
    parameters=HAPTIC_PARAMETERS,
    vendor_commands=(
        VendorCommand(DRAIN, "DRAIN"),
        VendorCommand(PRINCIPAL, "PRINCIPAL"),
        VendorCommand(GLIDES, "GLIDES"),
    ),
)
"""A separate type UUID, since Android's HapticGenerator serves players only."""
