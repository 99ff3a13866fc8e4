"""Descriptor, parameters and vendor commands of the haptic effect."""

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
    words = map(str, described.words) if isinstance(described, Choice) else ()
    return Parameter(name, str, default, choices=tuple(words), meaning=meaning)


def _switch(name: str, default: bool, meaning: str) -> Parameter:
    return Parameter(name, bool, default, meaning=meaning)


RESTARTING = frozenset({*TRANSFORM_FIELDS, "form", "per_channel", "sources"})
"""Parameters whose change requires a new transform."""

HAPTIC_PARAMETERS = (
    *(
        _parameter(name, described, getattr(TransformParameters, name))
        for name, described in TransformParameters.DESCRIPTIONS.items()
    ),
    _parameter("form", Settings.DESCRIPTIONS["form"], Settings.form),
    _switch("per_channel", False, "transform each channel instead of the mono mix of all"),
    Parameter(
        *("sources", str, ""),
        meaning="source of each haptic channel, such as left,right; empty: per_channel decides",
    ),
    _parameter(
        *("gain_db", Settings.DESCRIPTIONS["gain_db"], Settings.gain_db),
        "gain of the vibration; a change takes one buffer",
    ),
    _switch("mute", False, "fade to silence over one buffer; off: fade in over one buffer"),
    _switch("clip", True, "limit to full scale; without it the reference form may exceed it"),
    Parameter(
        "latency_frames", int, unit="frames", meaning="delay of the vibration after its sound"
    ),
    Parameter(
        "limited_samples", int, meaning="vibration samples changed by the limiter or clipping"
    ),
    Parameter("replaced_samples", int, meaning="invalid sound samples, replaced by 0"),
)
"""All parameters. The last three are read-only; without a stream, reading them gives ENODATA."""


def transform_parameters(values: Values) -> TransformParameters:
    """Return the parameters of the transform. UsageError: the values contradict each other."""
    chosen: dict[str, Any] = {name: values[name] for name in TRANSFORM_FIELDS}
    return TransformParameters(**chosen)


def is_possible(values: Values) -> bool:
    """Return whether all values are valid and do not contradict each other."""
    if not {*sources(values)} <= {*SOURCES} or (values["sources"] and values["per_channel"]):
        return False
    try:
        transform_parameters(values)
    except UsageError:
        return False
    return True


def sources(values: Values) -> tuple[str, ...]:
    """Return the chosen source of each haptic channel; empty if none is chosen."""
    chosen = values["sources"]
    return tuple(chosen.split(",")) if isinstance(chosen, str) and chosen else ()


def amplitude(values: Values) -> float:
    """Return the gain as a factor from 0 to 1; 0 while muted."""
    gain_db = values["gain_db"]
    assert isinstance(gain_db, (int, float))
    return 0.0 if values["mute"] else db_to_amplitude(gain_db)


def from_settings(settings: Settings) -> dict[str, Value]:
    """Return the values of the effect's parameters for a user's settings."""
    return {
        **asdict(settings.transform_parameters),
        "form": settings.form,
        "per_channel": settings.channels == "each",
        "sources": ",".join(settings.sources),
        "gain_db": settings.gain_db,
    }


def transform_for(config: EffectConfig, values: Values) -> HapticTransform | None:
    """Return a new transform for a stream, or None if its format or the values are unsupported."""
    chosen = sources(values)
    # All sources except the mono mix need weights.
    mixed = chosen not in ((), ("mix",))
    try:
        return HapticTransform(
            config.samplerate,
            config.channels,
            transform_parameters(values),
            form=cast(Form, values["form"]),
            per_channel=values["per_channel"] is True,
            weights=source_weights(config.channels, chosen) if mixed else None,
            # With gain 1, the haptic channels hold the vibration rounded to float32.
            single=amplitude(values) == 1.0,
        )
    except (UsageError, ValueError):
        # ValueError: the filter design can fail at a low samplerate.
        return None


DRAIN = Command.FIRST_PROPRIETARY + 1
"""Vendor command that ends the sound and resets the effect. The reply is the remaining vibration,
(latency_frames, haptic channels) float32."""

PRINCIPAL = Command.FIRST_PROPRIETARY + 2
"""Vendor command that any thread may send. The reply is `HapticTransform.principal`."""

GLIDES = Command.FIRST_PROPRIETARY + 3
"""Vendor command for exports. It replies with `HapticTransform.take_glides`, before the gain."""

HAPTIC_CUSHION = EffectDescriptor(
    type_uuid=UUID("ba39e606-2bd4-4eb4-9ed7-0e63c0415600"),
    uuid=UUID("e6e06d15-d79b-427b-8572-ef1ff53c4fb1"),
    name="Haptic Cushion",
    implementor="Haptic Cushion",
    # LAST: the effect must process the sound after all effects that change the sound.
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
"""The type UUID is not that of Android's HapticGenerator, which runs only on players' sessions."""
