"""The haptic effect: reads the mix, leaves it unchanged, and fills the haptic channels."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numpy as np
from numpy.typing import NDArray

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


class Vibration:
    """Vibration of one stream, scaled by a gain and written to all haptic channels of a buffer.

    gain: 0 to 1; a new gain is reached linearly over the next block, without a click. clip: whether
    samples beyond full scale are limited and counted. frames: length of the largest block. Use from
    the thread that steps the mixer.
    """

    def __init__(self, transform: HapticTransform, gain: float, frames: int) -> None:
        self.gain = gain
        self.clip = True
        self._transform = transform
        self._next: HapticTransform | None = None
        self._level = gain
        self._limited_before = 0
        self._replaced_before = 0
        self._clipped = 0
        self.prepare(frames)

    def prepare(self, frames: int) -> None:
        """Make room for blocks of up to `frames` frames, without an interruption of the stream."""
        self._column = np.zeros(frames)
        self._counted = np.arange(1.0, frames + 1.0)

    @property
    def latency_frames(self) -> int:
        """Frames by which vibration comes after its sound, with the newest transform."""
        return (self._next or self._transform).latency_frames

    @property
    def limited_samples(self) -> int:
        """Samples changed so far by the limiter or the cut at full scale."""
        return self._limited_before + self._transform.limited_samples + self._clipped

    @property
    def replaced_samples(self) -> int:
        """Unusable samples of sound so far, which were replaced by 0."""
        return self._replaced_before + self._transform.replaced_samples

    @property
    def principal(self) -> tuple[tuple[float, float, float], ...]:
        """What the latest hop vibrates, before the gain; any thread may read it."""
        return self._transform.principal

    def take_glides(self) -> FloatArray:
        """Return what the partials did since the last call, before the gain."""
        return self._transform.take_glides()

    def change(self, transform: HapticTransform) -> None:
        """Change to another transform: the old one fades out over the next block.

        The new one starts from silence with the sound after that block.
        """
        self._next = transform

    def restart(self, transform: HapticTransform) -> None:
        """Change to another transform at once, with no fade; for streams that are new or silent."""
        self._adopt(transform)

    def reset(self) -> None:
        """Forget all sound at once; the counters keep their values."""
        if self._next is not None:
            self._adopt(self._next)
        self._transform.reset()
        self._level = self.gain

    def process(self, audio: Frames, out: NDArray[np.float32]) -> None:
        """Write the vibration now due to `out` (frames, haptic channels); `audio` is only read."""
        owed = self._transform.process(audio)
        if self._next is None:
            self._write(owed, out, self.gain)
        else:
            self._write(owed, out, 0.0)
            self._adopt(self._next)

    def drain(self, haptic_channels: int) -> NDArray[np.float32]:
        """Return the vibration left after the sound ends, (latency_frames, haptic_channels)."""
        owed = self._transform.finish()
        out = np.zeros((len(owed), haptic_channels), np.float32)
        self._write(owed, out, self.gain)
        if self._next is not None:
            self._adopt(self._next)
        return out

    def _adopt(self, transform: HapticTransform) -> None:
        self._limited_before += self._transform.limited_samples
        self._replaced_before += self._transform.replaced_samples
        self._transform = transform
        self._next = None
        self._level = self.gain

    def _write(self, owed: FloatArray, out: NDArray[np.float32], goal: float) -> None:
        """Write vibration (frames, voices) to the haptic channels and end at the gain `goal`.

        A voice is one channel of vibration from the transform. If there are more haptic channels
        than voices, haptic channel h plays voice h mod voices. If there are fewer, channel h plays
        the mean of voices h, h + haptic_channels, ...: no voice is left out, and equal voices keep
        their level.
        """
        level, self._level = self._level, goal
        if level == goal == 0.0:
            out[:] = 0.0
            return
        frames, voices = owed.shape
        places = out.shape[1]
        fits = frames <= self._column.size
        column = self._column[:frames] if fits else np.zeros(frames)
        counted = self._counted[:frames] if fits else np.arange(1.0, frames + 1.0)
        for place in range(places):
            np.copyto(column, owed[:, place % voices])
            if places < voices:
                # one by one: NumPy's order of a sum depends on the shape, so on the blocks
                for voice in range(place + places, voices, places):
                    column += owed[:, voice]
                column /= len(range(place, voices, places))
            if level != goal:
                column *= level + (goal - level) * (counted / frames)
            elif goal != 1.0:
                column *= goal
            if self.clip:
                self._clipped += cut_to_full_scale(column)
            out[:, place] = column


def cut_to_full_scale(samples: FloatArray) -> int:
    """Limit samples to +-1 in place and return how many exceeded it."""
    if peak(samples) <= 1.0:
        return 0
    beyond = int(np.count_nonzero(np.abs(samples) > 1.0))
    np.clip(samples, -1.0, 1.0, out=samples)
    return beyond


class HapticEffect:
    """One instance of the effect, an `EffectEngine`.

    - The sound passes bit for bit; vibration comes `latency_frames` after its sound.
    - Every buffer's haptic channels are overwritten, with silence while the effect is disabled.
      With ACCUMULATE the vibration is added, and the sum limited to full scale. None is stale.
    - A change of gain or mute is linear over the next buffer.
    - A new parameter of the transform fades the vibration out over the next buffer; the new
      transform then starts from silence. GET_PARAM returns the new value at once.
    - A new sample rate or channel count restarts vibration and sound without a fade.
    - A stream without a haptic channel is refused.

    Use from the thread that steps the mixer.
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
            PRINCIPAL: self._principal,
            GLIDES: self._glides,
        }

    def process(self, source: MixBuffer, target: MixBuffer) -> int:
        """Write the vibration of a buffer to its haptic channels. ENODATA while disabled."""
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
        """Carry out a command that the framework has checked; see `HAPTIC_PARAMETERS`, `DRAIN`."""
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
            transform = transform_for(config, self._values)
            if transform is None:
                return EINVAL, None
            if vibration is None:
                vibration = Vibration(transform, amplitude(self._values), config.frames)
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
        name, value = cast(tuple[str, Value], pair)
        return self._take(self._values | {name: value})

    def _set_param_deferred(self, pair: object) -> tuple[int, object]:
        name, value = cast(tuple[str, Value], pair)
        self._deferred[name] = value
        return OK, None

    def _set_param_commit(self, _: object) -> tuple[int, object]:
        deferred, self._deferred = self._deferred, {}
        return self._take(self._values | deferred)

    def _take(self, values: dict[str, Value]) -> tuple[int, object]:
        """Apply a set of values, or change nothing if the values contradict each other."""
        if not is_possible(values):
            return EINVAL, None
        transform = None
        restarting = any(values[name] != self._values[name] for name in RESTARTING)
        if restarting and self._config is not None:
            transform = transform_for(self._config, values)
            if transform is None:
                return EINVAL, None
        self._values = values
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

    def _principal(self, _: object) -> tuple[int, object]:
        vibration = self._vibration
        told = vibration.principal if vibration is not None and self._enabled else ()
        return OK, told

    def _glides(self, _: object) -> tuple[int, object]:
        vibration = self._vibration
        return (OK, vibration.take_glides()) if vibration is not None else (ENODATA, None)

    def _dump(self, _: object) -> tuple[int, object]:
        if self._vibration is None:
            return OK, "no stream yet"
        vibration = self._vibration
        return OK, (
            f"{'enabled' if self._enabled else 'disabled'}, level {vibration.gain:.3g}, "
            f"latency {vibration.latency_frames} frames, limited {vibration.limited_samples}, "
            f"replaced {vibration.replaced_samples} samples"
        )


CUSHION = EffectLibrary("cushion", ((HAPTIC_CUSHION, HapticEffect),))
"""The library that brings the haptic effect."""
