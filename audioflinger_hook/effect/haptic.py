"""The haptic effect: reads the mix, leaves it unchanged, and writes the vibration beside it."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast
from uuid import UUID

import numpy as np

from audioflinger_hook.effect.commands import CommandCheck
from audioflinger_hook.effect.haptic_parameters import (
    HAPTIC_PARAMETERS,
    RESTARTING,
    amplitude,
    is_possible,
    sources,
    transform_parameters,
)
from audioflinger_hook.effect.interface import (
    EINVAL,
    ENODATA,
    ENOSYS,
    OK,
    Access,
    Command,
    EffectConfig,
    EffectDescriptor,
    EffectFlag,
    EffectLibrary,
    VendorCommand,
)
from audioflinger_hook.effect.parameters import ParameterValues, Value, Values
from audioflinger_hook.effect.vibration import Vibration
from audioflinger_hook.mixer.layouts import source_weights
from audioflinger_hook.mixer.mix_buffer import MixBuffer
from audioflinger_hook.transform import Form, HapticTransform
from device.errors import UsageError

DRAIN = Command.FIRST_PROPRIETARY + 1
"""Vendor command: replies with the rest of the vibration after the end of the sound,
(latency_frames, haptic channels) float32, and resets. The reply is silence while disabled."""

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
    vendor_commands=(VendorCommand(DRAIN, "DRAIN"),),
)
"""A separate type UUID, since Android's HapticGenerator serves players only."""


class HapticEffect:
    """One instance of the effect, an `EffectEngine`.

    - The sound passes bit for bit; vibration comes `latency_frames` after its sound.
    - Every buffer's haptic channels are overwritten, with silence while it is disabled. With
      ACCUMULATE they are added to and limited to full scale. No stale vibration can remain.
    - A new gain, or mute, is reached linearly over the next buffer.
    - A new parameter of the transform fades the vibration out over the next buffer; the new
      transform then starts from silence. GET_PARAM returns the new value at once.
    - A new sample rate or channel count restarts it without a fade, as it does the sound.
    - A stream without a haptic channel is refused.

    Held by the thread that steps the mixer.
    """

    descriptor = HAPTIC_CUSHION

    def __init__(self) -> None:
        self._values = ParameterValues(HAPTIC_PARAMETERS)
        self._check = CommandCheck(HAPTIC_CUSHION)
        self._config: EffectConfig | None = None
        self._vibration: Vibration | None = None
        self._enabled = False
        self._added = np.zeros((0, 0), np.float32)
        self._carry_out: dict[int, Callable[[object], tuple[int, object]]] = {
            Command.INIT: self._init,
            Command.SET_CONFIG: self._set_config,
            Command.RESET: self._reset,
            Command.ENABLE: self._enable,
            Command.DISABLE: self._disable,
            Command.SET_PARAM: self._set_param,
            Command.SET_PARAM_DEFERRED: self._set_param_deferred,
            Command.SET_PARAM_COMMIT: self._set_param_commit,
            Command.GET_PARAM: self._get_param,
            Command.GET_CONFIG: self._get_config,
            Command.DUMP: self._dump,
            DRAIN: self._drain,
        }

    def process(self, source: MixBuffer, target: MixBuffer) -> int:
        """Write the vibration of a buffer beside its sound. ENODATA while it is disabled."""
        vibration, config = self._vibration, self._config
        if vibration is None or config is None:
            return EINVAL
        if config.access is Access.ACCUMULATE:
            target.audio += source.audio
            if not self._enabled:
                return ENODATA
            added = self._added[: source.frames]
            vibration.process(source.audio, added)
            target.haptic += added
            np.clip(target.haptic, -1.0, 1.0, out=target.haptic)
            return OK
        if source is not target:
            np.copyto(target.audio, source.audio)
        if not self._enabled:
            target.haptic[:] = 0.0
            return ENODATA
        vibration.process(source.audio, target.haptic)
        return OK

    def command(self, code: int, data: object = None) -> tuple[int, object]:
        """Carry out a command; see `HAPTIC_PARAMETERS` and `DRAIN` for what there is."""
        status = self._check.status(code, data)
        if status != OK:
            return status, None
        carry_out = self._carry_out.get(code)
        return carry_out(data) if carry_out else (ENOSYS, None)

    def _init(self, _: object) -> tuple[int, object]:
        self._config = self._vibration = None
        self._enabled = False
        return OK, None

    def _set_config(self, config: object) -> tuple[int, object]:
        if not isinstance(config, EffectConfig) or not config.haptic_channels:
            return EINVAL, None
        before, vibration = self._config, self._vibration
        same_sound = before is not None and (before.samplerate, before.channels) == (
            config.samplerate,
            config.channels,
        )
        if vibration is None or not same_sound:
            transform = transform_for(config, self._values.all())
            if transform is None:
                return EINVAL, None
            if vibration is None:
                vibration = Vibration(transform, amplitude(self._values.all()), config.frames)
                self._vibration = vibration
            else:
                vibration.restart(transform)
        vibration.prepare(config.frames)
        vibration.clip = self._values["clip"] is True
        self._added = np.zeros((config.frames, config.haptic_channels), np.float32)
        self._config = config
        return OK, None

    def _reset(self, _: object) -> tuple[int, object]:
        if self._vibration is not None:
            self._vibration.reset()
        return OK, None

    def _enable(self, _: object) -> tuple[int, object]:
        if self._vibration is None:
            return EINVAL, None
        if not self._enabled:
            self._vibration.reset()
        self._enabled = True
        return OK, None

    def _disable(self, _: object) -> tuple[int, object]:
        self._enabled = False
        return OK, None

    def _set_param(self, pair: object) -> tuple[int, object]:
        return self._take(self._values.proposed(*cast(tuple[str, Value], pair)))

    def _set_param_deferred(self, pair: object) -> tuple[int, object]:
        taken = self._values.stage(*cast(tuple[str, Value], pair))
        return (OK if taken else EINVAL), None

    def _set_param_commit(self, _: object) -> tuple[int, object]:
        return self._take(self._values.proposed_together())

    def _take(self, values: dict[str, Value] | None) -> tuple[int, object]:
        """Apply a set of values, or change nothing if they are not possible together."""
        if values is None or not is_possible(values):
            return EINVAL, None
        transform = None
        restarting = any(values[name] != self._values[name] for name in RESTARTING)
        if restarting and self._config is not None:
            transform = transform_for(self._config, values)
            if transform is None:
                return EINVAL, None
        self._values.take(values)
        if self._vibration is not None:
            self._vibration.gain = amplitude(values)
            self._vibration.clip = values["clip"] is True
            if transform is not None and self._enabled:
                self._vibration.change(transform)
            elif transform is not None:
                self._vibration.restart(transform)
        return OK, None

    def _get_param(self, parameter: object) -> tuple[int, object]:
        name = cast(str, parameter)
        if name in self._values:
            return OK, self._values[name]
        if self._vibration is None:
            return ENODATA, None
        return OK, getattr(self._vibration, name)

    def _get_config(self, _: object) -> tuple[int, object]:
        return (OK, self._config) if self._config else (ENODATA, None)

    def _drain(self, _: object) -> tuple[int, object]:
        if self._vibration is None or self._config is None:
            return ENODATA, None
        owed = self._vibration.drain(self._config.haptic_channels)
        return OK, owed if self._enabled else np.zeros_like(owed)

    def _dump(self, _: object) -> tuple[int, object]:
        if self._vibration is None:
            return OK, "no stream yet"
        vibration = self._vibration
        return OK, (
            f"{'enabled' if self._enabled else 'disabled'}, level {vibration.gain:.3g}, "
            f"latency {vibration.latency_frames} frames, limited {vibration.limited_samples}, "
            f"replaced {vibration.replaced_samples} samples"
        )


def transform_for(config: EffectConfig, values: Values) -> HapticTransform | None:
    """Return a transform for a stream, about 6 ms of work, or None where none can be."""
    chosen = sources(values)
    # A transform without weights makes the mix alone.
    mixed = chosen not in ((), ("mix",))
    try:
        return HapticTransform(
            config.samplerate,
            config.channels,
            transform_parameters(values),
            form=cast(Form, values["form"]),
            per_channel=values["per_channel"] is True,
            weights=source_weights(config.channels, chosen) if mixed else None,
            # The haptic channels are float32; only a level would be multiplied before.
            single=amplitude(values) == 1.0,
        )
    except (UsageError, ValueError):
        # ValueError: a band that a low sample rate cannot hold has no filter.
        return None


CUSHION = EffectLibrary("cushion", ((HAPTIC_CUSHION, HapticEffect),))
"""The library that brings the haptic effect."""
