"""The haptic effect: writes vibration, computed from the sound, to the haptic channels."""

from typing import cast

import numpy as np

from audioflinger_hook.effect.haptic_parameters import (
    DRAIN,
    GLIDES,
    HAPTIC_CUSHION,
    HAPTIC_PARAMETERS,
    PRINCIPAL,
    RESTARTING,
    amplitude,
    is_possible,
    transform_for,
)
from audioflinger_hook.effect.interface import (
    EINVAL,
    ENODATA,
    ENOSYS,
    OK,
    Access,
    Command,
    EffectConfig,
    EffectLibrary,
    Value,
)
from audioflinger_hook.mixer.mix_buffer import MixBuffer
from audioflinger_hook.transform import FloatArray, Frames, HapticTransform
from device.blocks import peak
from device.units import Float32Array


class Vibration:
    """Computes the vibration of one stream, scales it by a gain and writes it to a buffer.

    gain: factor from 0 to 1; it changes to a new value linearly over one block.
    frames: largest block size. clip: whether samples beyond full scale are clipped and counted.
    """

    def __init__(self, transform: HapticTransform, gain: float, frames: int) -> None:
        self.gain = gain
        self.clip = True
        self.transform = transform
        self._next: HapticTransform | None = None
        self._level = gain
        self._limited_before = self._replaced_before = self._clipped = 0
        self.prepare(frames)

    def prepare(self, frames: int) -> None:
        """Allocate memory for blocks of up to `frames` frames."""
        self._column = np.zeros(frames)
        self._counted = np.arange(1.0, frames + 1.0)

    @property
    def latency_frames(self) -> int:
        """Delay from sound to vibration in frames; during a change, that of the new transform."""
        return (self._next or self.transform).latency_frames

    @property
    def limited_samples(self) -> int:
        """Number of vibration samples that the limiter or the clipping has changed."""
        return self._limited_before + self.transform.limited_samples + self._clipped

    @property
    def replaced_samples(self) -> int:
        """Number of invalid sound samples that were replaced by 0."""
        return self._replaced_before + self.transform.replaced_samples

    def change(self, transform: HapticTransform) -> None:
        """Fade the vibration out over the next block; then start the new transform from silence."""
        self._next = transform

    def restart(self, transform: HapticTransform) -> None:
        """Change to another transform without a fade. The stream must be new or silent."""
        self._limited_before += self.transform.limited_samples
        self._replaced_before += self.transform.replaced_samples
        self.transform = transform
        self._next = None
        self._level = self.gain

    def reset(self) -> None:
        """Start a new stream without a fade. The counts of limited and replaced samples remain."""
        if self._next is not None:
            self.restart(self._next)
        self.transform.reset()
        self._level = self.gain

    def process(self, audio: Frames, out: Float32Array) -> None:
        """Write the vibration of one block to `out` of shape (frames, haptic channels)."""
        self._write(self.transform.process(audio), out, 0.0 if self._next else self.gain)
        if self._next:
            self.restart(self._next)

    def drain(self, haptic_channels: int) -> Float32Array:
        """End the sound and return the remaining vibration, (latency_frames, haptic_channels)."""
        owed = self.transform.finish()
        out = np.zeros((len(owed), haptic_channels), np.float32)
        self._write(owed, out, self.gain)
        if self._next is not None:
            self.restart(self._next)
        return out

    def _write(self, owed: FloatArray, out: Float32Array, goal: float) -> None:
        """Write vibration, (frames, channels), to `out`; the gain ramp ends at `goal`.

        If haptic_channels >= channels, haptic channel h plays channel h mod channels. Otherwise
        haptic channel h plays the mean of the channels h, h + haptic_channels, ...
        """
        level, self._level = self._level, goal
        if level == goal == 0.0:
            out[:] = 0.0
            return
        frames, channels = owed.shape
        haptic_channels = out.shape[1]
        if frames > self._column.size:
            self.prepare(frames)
        column, counted = self._column[:frames], self._counted[:frames]
        for haptic_channel in range(haptic_channels):
            np.copyto(column, owed[:, haptic_channel % channels])
            if haptic_channels < channels:
                # This loop replaces NumPy's sum(), whose rounding depends on the block size.
                mixed = range(haptic_channel, channels, haptic_channels)
                for channel in mixed[1:]:
                    column += owed[:, channel]
                column /= len(mixed)
            if level != goal:
                column *= level + (goal - level) * (counted / frames)
            elif goal != 1.0:
                column *= goal
            if self.clip and not peak(column) <= 1.0:
                self._clipped += int(np.count_nonzero(np.abs(column) > 1.0))
                np.clip(column, -1.0, 1.0, out=column)
            out[:, haptic_channel] = column


class HapticEffect:
    """One instance of the haptic effect, an `EffectEngine`.

    - The sound stays bit-identical. The vibration is `latency_frames` frames later than the sound.
    - With `Access.WRITE`, the haptic channels are overwritten. A disabled effect writes zeros.
    - With ACCUMULATE, vibration is added to the haptic channels. The sum is clipped to full scale.
    - After a change of gain or mute, the gain changes linearly over the next buffer.
    - After a change of a transform parameter, the vibration fades out over the next buffer. Then a
      new transform starts from silence. GET_PARAM returns the new value immediately.
    - A new sample rate or channel count restarts the vibration without a fade.
    - A stream without a haptic channel is refused.
    """

    descriptor = HAPTIC_CUSHION

    def __init__(self) -> None:
        self._values: dict[str, Value] = {
            parameter.name: parameter.default
            for parameter in HAPTIC_PARAMETERS
            if parameter.default is not None
        }
        self._deferred: dict[str, Value] = {}
        self._config: EffectConfig | None = None
        self._vibration: Vibration | None = None
        self._enabled = False
        self._added = np.zeros((0, 0), np.float32)

    def process(self, source: MixBuffer, target: MixBuffer) -> int:
        """Write sound and vibration. Return OK, ENODATA (disabled) or EINVAL (not configured)."""
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
        """Execute a command that the framework has checked. Return (status, reply)."""
        vibration = self._vibration
        match code:
            case Command.INIT:
                self._config = self._vibration = None
                self._enabled = False
                return OK, None
            case Command.SET_CONFIG:
                return self._set_config(data), None
            case Command.SET_PARAM:
                name, value = cast(tuple[str, Value], data)
                return self._set_values({name: value}), None
            case Command.SET_PARAM_DEFERRED:
                name, value = cast(tuple[str, Value], data)
                self._deferred[name] = value
                return OK, None
            case Command.SET_PARAM_COMMIT:
                deferred, self._deferred = self._deferred, {}
                return self._set_values(deferred), None
            case Command.GET_PARAM if data in self._values:
                return OK, self._values[str(data)]
            case Command.GET_PARAM:
                return (OK, getattr(vibration, str(data))) if vibration else (ENODATA, None)
            case Command.GET_CONFIG:
                return (OK, self._config) if self._config else (ENODATA, None)
            case Command.RESET:
                if vibration is not None:
                    vibration.reset()
                return OK, None
            case Command.ENABLE:
                if vibration is None:
                    return EINVAL, None
                if not self._enabled:
                    vibration.reset()
                self._enabled = True
                return OK, None
            case Command.DISABLE:
                self._enabled = False
                return OK, None
            case Command.DUMP:
                if vibration is None:
                    return OK, "no stream yet"
                return OK, (
                    f"{'enabled' if self._enabled else 'disabled'}, level {vibration.gain:.3g}, "
                    f"latency {vibration.latency_frames} frames, "
                    f"limited {vibration.limited_samples}, "
                    f"replaced {vibration.replaced_samples} samples"
                )
            case _ if code == DRAIN:
                if vibration is None or self._config is None:
                    return ENODATA, None
                owed = vibration.drain(self._config.haptic_channels)
                return OK, owed if self._enabled else np.zeros_like(owed)
            case _ if code == PRINCIPAL:
                return OK, vibration.transform.principal if vibration and self._enabled else ()
            case _ if code == GLIDES:
                return (OK, vibration.transform.take_glides()) if vibration else (ENODATA, None)
        return ENOSYS, None

    def _set_config(self, config: object) -> int:
        if not isinstance(config, EffectConfig) or not config.haptic_channels:
            return EINVAL
        before, vibration = self._config, self._vibration
        same = before and (before.samplerate, before.channels) == (
            config.samplerate,
            config.channels,
        )
        if vibration is None or not same:
            if (transform := transform_for(config, self._values)) is None:
                return EINVAL
            if vibration is None:
                vibration = Vibration(transform, amplitude(self._values), config.frames)
                self._vibration = vibration
            else:
                vibration.restart(transform)
        vibration.prepare(config.frames)
        vibration.clip = self._values["clip"] is True
        self._added = np.zeros((config.frames, config.haptic_channels), np.float32)
        self._config = config
        return OK

    def _set_values(self, changed: dict[str, Value]) -> int:
        """Apply values and return OK. Return EINVAL if they conflict or do not fit the stream."""
        values = self._values | changed
        if not is_possible(values):
            return EINVAL
        transform = None
        restarting = any(values[name] != self._values[name] for name in RESTARTING)
        if restarting and self._config and not (transform := transform_for(self._config, values)):
            return EINVAL
        self._values = values
        if self._vibration is not None:
            self._vibration.gain = amplitude(values)
            self._vibration.clip = values["clip"] is True
            if transform is not None and self._enabled:
                self._vibration.change(transform)
            elif transform is not None:
                self._vibration.restart(transform)
        return OK


CUSHION = EffectLibrary("cushion", ((HAPTIC_CUSHION, HapticEffect),))
