"""The transform as its users meet it: sound of any channels in, vibration out."""

from __future__ import annotations

from typing import Literal, Protocol

from audioflinger_hook.transform.arrays import FloatArray, Frames
from audioflinger_hook.transform.channel_bank import ChannelBank
from audioflinger_hook.transform.input_stage import Mixdown
from audioflinger_hook.transform.kernel import KernelStream, kernel_warning
from audioflinger_hook.transform.live.transform import LiveTransform
from audioflinger_hook.transform.parameters import TransformParameters, check_format
from audioflinger_hook.transform.reference.transform import ReferenceTransform
from device.errors import UsageError

Form = Literal["live", "reference"]
Implementation = Literal["compiled", "numpy"]

FORMS: dict[Form, type[LiveTransform] | type[ReferenceTransform]] = {
    "live": LiveTransform,
    "reference": ReferenceTransform,
}


class Stream(Protocol):
    """One stream of either form, in NumPy or compiled."""

    latency_frames: int
    tonal_latency_frames: int

    @property
    def delivered_frames(self) -> int:
        """Frames of vibration given so far."""
        ...

    @property
    def replaced_samples(self) -> int:
        """Unusable samples that were taken for 0 so far."""
        ...

    @property
    def limited_samples(self) -> int:
        """Samples of vibration that the limiter has changed in all hops computed so far."""
        ...

    def process(self, frames: Frames) -> FloatArray:
        """Return (frames, channels_out) of vibration for sound as `HapticTransform` takes it."""
        ...

    def finish(self) -> FloatArray:
        """Return the `latency_frames` still owed, and begin anew."""
        ...

    def reset(self) -> None:
        """Begin anew; the counters go on."""
        ...


class HapticTransform:
    """Vibration for a stream of sound, block by block; pure: no clock, no I/O.

    samplerate: Hz, 1 000 to 768 000; channels: 1 to 64. parameters: the paper's where not given.
    form: `live`, what a cushion plays, or `reference`, the paper's equations literally.
    per_channel: each channel is transformed by itself instead of their mean. weights: instead of
    that (channels, voices), by which the channels are mixed, each voice then transformed by itself;
    the weights of a voice add up to 1 or less, so that none exceeds full scale. Any split of the
    stream into blocks gives the same bytes. Held by one thread at a time.

    single: the vibration is wanted as float32. The reference form then costs a third, and its
    float64 rounds to the same float32; to the live form it makes no difference.

    implementation: how the live form is computed. Where it is not given, `compiled`, or `numpy`
    where the kernel is not there (`kernel_warning` says so): the same within 1e-6 of full scale,
    at about fifteen times the cost. The reference form is `numpy` always.

    Raises
    ------
    UsageError
        The format, the form or its implementation is not supported.
    """

    def __init__(
        self,
        samplerate: int,
        channels: int = 2,
        parameters: TransformParameters | None = None,
        *,
        form: Form = "live",
        per_channel: bool = False,
        weights: FloatArray | None = None,
        single: bool = False,
        implementation: Implementation | None = None,
    ) -> None:
        check_format(samplerate, channels)
        if form not in FORMS:
            raise UsageError(f"transform form {form!r} is not known; allowed: {', '.join(FORMS)}")
        self.samplerate = samplerate
        self.channels = channels
        self.parameters = parameters or TransformParameters()
        self.form = form
        self.implementation = _implementation(form, implementation)
        self._single = single
        self._mixdown = None if weights is None else Mixdown(weights)
        streamed = self._mixdown.voices if self._mixdown else channels
        per_channel |= self._mixdown is not None
        self.channels_out = streamed if per_channel else 1
        self._stream = self._begun(streamed, per_channel)

    def _begun(self, channels: int, per_channel: bool) -> Stream:
        """Return a new stream."""
        if self.implementation == "compiled":
            settings = LiveTransform(self.parameters, self.samplerate)
            return KernelStream(settings, channels, per_channel)
        voices = [self._voice() for _ in range(self.channels_out)]
        self._references = [voice for voice in voices if isinstance(voice, ReferenceTransform)]
        return ChannelBank(voices, channels)

    def _voice(self) -> LiveTransform | ReferenceTransform:
        """Return a new transform of one channel, in NumPy."""
        if self.form == "reference":
            return ReferenceTransform(self.parameters, self.samplerate, single=self._single)
        return LiveTransform(self.parameters, self.samplerate)

    @property
    def latency_frames(self) -> int:
        """Frames by which vibration comes after its sound, that of an onset; exact and constant.

        To be taken out or waited for: one sees and hears when something begins.
        """
        return self._stream.latency_frames

    @property
    def tonal_latency_frames(self) -> int:
        """Frames by which the level of what lasts follows, and its end; no less, and constant."""
        return self._stream.tonal_latency_frames

    @property
    def latency_s(self) -> float:
        """`latency_frames` in seconds."""
        return self.latency_frames / self.samplerate

    @property
    def limited_samples(self) -> int:
        """Samples of vibration that the limiter has changed so far.

        A hop is counted when it is computed, which is up to one hop before it is delivered.
        """
        return min(self._stream.limited_samples, self._stream.delivered_frames * self.channels_out)

    @property
    def replaced_samples(self) -> int:
        """Samples of sound that were unusable and counted as 0 so far."""
        return (self._mixdown or self._stream).replaced_samples

    @property
    def past(self) -> tuple[bytes, ...]:
        """Of the reference form between two units: all that what was heard does to what comes.

        May be set to that of another stream of the same format: what follows is then the same.
        """
        return tuple(voice.past for voice in self._references)

    @past.setter
    def past(self, past: tuple[bytes, ...]) -> None:
        for voice, its in zip(self._references, past, strict=True):
            voice.past = its

    def process(self, frames: Frames) -> FloatArray:
        """Return the vibration due, (frames, channels_out) float64, full scale +-1.

        frames: (frames, channels), or (frames,) for one channel; float32 or float64, 0 frames
        upwards. Samples that are not finite or exceed 1e3 count as 0 and in `replaced_samples`.
        """
        return self._stream.process(self._mixdown.process(frames) if self._mixdown else frames)

    def finish(self) -> FloatArray:
        """Return the last `latency_frames` of vibration, (frames, channels_out), and begin anew."""
        return self._stream.finish()

    def reset(self) -> None:
        """Begin a new stream; the counters go on."""
        self._stream.reset()


def _implementation(form: Form, wanted: Implementation | None) -> Implementation:
    """Return how a form is computed, the faster way where there is a choice."""
    missing = kernel_warning()
    if wanted not in (None, "compiled", "numpy"):
        raise UsageError(
            f"implementation {wanted!r} of the transform is not known; allowed: compiled, numpy"
        )
    if wanted == "compiled" and form == "reference":
        raise UsageError("the reference form is not compiled; allowed for it: numpy")
    if wanted == "compiled" and missing:
        raise UsageError(missing)
    if wanted:
        return wanted
    return "numpy" if missing or form == "reference" else "compiled"
