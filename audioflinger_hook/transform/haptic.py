"""The transform as its users meet it: sound of any channels in, vibration out."""

from __future__ import annotations

from typing import Literal, Protocol

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray, Frames
from audioflinger_hook.transform.intake import mono, replace_unusable
from audioflinger_hook.transform.live import LiveTransform
from audioflinger_hook.transform.parameters import TransformParameters, check_format
from audioflinger_hook.transform.reference import ReferenceTransform
from device.errors import UsageError

Form = Literal["live", "reference"]


class MonoTransform(Protocol):
    """One channel of either form."""

    latency_frames: int
    limited_frames: int

    def process(self, mono: FloatArray) -> FloatArray:
        """Return as many frames as come in, `latency_frames` behind them."""
        ...

    def finish(self) -> FloatArray:
        """Return the `latency_frames` still owed, and begin anew."""
        ...

    def reset(self) -> None:
        """Begin anew."""
        ...


FORMS: dict[Form, type[LiveTransform] | type[ReferenceTransform]] = {
    "live": LiveTransform,
    "reference": ReferenceTransform,
}


class HapticTransform:
    """Vibration for a stream of sound, block by block; pure: no clock, no I/O.

    samplerate: Hz, 1 000 to 768 000; channels: 1 to 64. parameters: the paper's where not given.
    form: `live`, what a cushion plays, or `reference`, the paper's equations literally.
    per_channel: each channel is transformed by itself instead of their mean. Any split of the
    stream into blocks gives the same bytes. Held by one thread at a time.

    Raises
    ------
    UsageError
        The format or the form is not supported.
    """

    def __init__(
        self,
        samplerate: int,
        channels: int = 2,
        parameters: TransformParameters | None = None,
        *,
        form: Form = "live",
        per_channel: bool = False,
    ) -> None:
        check_format(samplerate, channels)
        if form not in FORMS:
            raise UsageError(f"transform form {form!r} is not known; allowed: {', '.join(FORMS)}")
        self.samplerate = samplerate
        self.channels = channels
        self.parameters = parameters or TransformParameters()
        self.form = form
        self.channels_out = channels if per_channel else 1
        self._voices: list[MonoTransform] = [
            FORMS[form](self.parameters, samplerate) for _ in range(self.channels_out)
        ]
        self.replaced_samples = 0
        self._delivered_frames = 0

    @property
    def latency_frames(self) -> int:
        """Frames by which the vibration comes after its sound; exact and constant."""
        return self._voices[0].latency_frames

    @property
    def latency_s(self) -> float:
        """The same in seconds."""
        return self.latency_frames / self.samplerate

    @property
    def limited_samples(self) -> int:
        """Samples of vibration that the limiter has changed so far.

        A hop is counted when it is computed, which is up to one hop before it is delivered.
        """
        counted = sum(voice.limited_frames for voice in self._voices)
        return min(counted, self._delivered_frames * self.channels_out)

    def process(self, frames: Frames) -> FloatArray:
        """Return the vibration due, (frames, channels_out) float64, full scale +-1.

        frames: (frames, channels), or (frames,) for one channel; float32 or float64, 0 frames
        upwards. Samples that are not finite or exceed 1e3 count as 0 and in `replaced_samples`.
        """
        if frames.dtype.kind != "f":
            raise UsageError(
                f"a block of {frames.dtype} is not sound in full scale; allowed: float32, float64; "
                "divide integers by their own full scale first"
            )
        if frames.ndim == 1:
            frames = frames[:, None]
        if frames.ndim != 2 or frames.shape[1] != self.channels:
            raise UsageError(
                f"a block of shape {frames.shape} does not fit this stream; "
                f"allowed: (frames, {self.channels})"
            )
        usable, replaced = replace_unusable(frames)
        self.replaced_samples += replaced
        self._delivered_frames += len(frames)
        if self.channels_out == 1:
            return self._voices[0].process(mono(usable))[:, None]
        return np.stack(
            [
                voice.process(usable[:, channel].astype(np.float64))
                for channel, voice in enumerate(self._voices)
            ],
            axis=1,
        )

    def finish(self) -> FloatArray:
        """Return the last `latency_frames` of vibration, (frames, channels_out), and begin anew."""
        self._delivered_frames += self.latency_frames
        return np.stack([voice.finish() for voice in self._voices], axis=1)

    def reset(self) -> None:
        """Begin a new stream; the counters go on."""
        for voice in self._voices:
            voice.reset()
