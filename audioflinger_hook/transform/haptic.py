"""The transform for its users: sound of any channels in, vibration out."""

from __future__ import annotations

from types import ModuleType
from typing import Literal

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray, Frames
from audioflinger_hook.transform.channel_bank import ChannelBank
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.downmix import MonoMix
from audioflinger_hook.transform.input_stage import Mixdown, fit_block
from audioflinger_hook.transform.live.synthesis import GLIDE_COLUMNS
from audioflinger_hook.transform.live.transform import LiveTransform
from audioflinger_hook.transform.parameters import TransformParameters, check_format
from audioflinger_hook.transform.reference.transform import ReferenceTransform
from device.errors import UsageError
from device.extension import load

_kernel: ModuleType | None
try:
    _kernel = load("audioflinger_hook.transform._kernel", "LiveKernel")
except ImportError as error:
    _kernel = None
    _why_missing = str(error)


def kernel_warning() -> str | None:
    """Return why the live form is not compiled, and the cost of this; None if compiled."""
    if _kernel is not None:
        return None
    return (
        f"the transform runs uncompiled, the same vibration for about fifteen times the processor "
        f"time ({_why_missing}); to build it: `rm -rf .venv`, then `make run`, with a C compiler"
    )


class KernelStream:
    """One stream of the live form, (frames, channels) to (frames, channels or 1), compiled.

    The vibration is that of `ChannelBank` within 1e-6 of full scale; the counters are the same, and
    any split gives the same bytes. All memory is allocated in the constructor. Use from one thread
    at a time.

    design: all numbers and tables.
    channels: channels of the sound.
    each: whether every channel is transformed separately, instead of their mono mix.
    RuntimeError: the kernel is missing: see `kernel_warning`.
    """

    def __init__(self, design: LiveDesign, channels: int, each: bool) -> None:
        if _kernel is None:
            raise RuntimeError(kernel_warning())
        self._kernel = _kernel.LiveKernel(design.to_bytes(), channels, each)
        self._made_of = (design, channels, each)
        self._channels = channels
        self._channels_out = channels if each else 1
        self.latency_frames = design.latency_frames
        self.tonal_latency_frames = design.tonal_latency_frames

    def __getstate__(self) -> tuple[tuple[LiveDesign, int, bool], bytes]:
        return self._made_of, self._kernel.state

    def __setstate__(self, state: tuple[tuple[LiveDesign, int, bool], bytes]) -> None:
        made_of, numbers = state
        KernelStream.__init__(self, *made_of)
        self._kernel.state = numbers

    @property
    def delivered_frames(self) -> int:
        """Frames of vibration given so far."""
        delivered: int = self._kernel.delivered
        return delivered

    @property
    def replaced_samples(self) -> int:
        """Unusable samples so far, which counted as 0."""
        replaced: int = self._kernel.replaced
        return replaced

    @property
    def limited_samples(self) -> int:
        """Samples of vibration that the limiter has changed, some not delivered yet."""
        limited: int = self._kernel.limited
        return limited

    @property
    def told(self) -> tuple[tuple[float, float, float], ...]:
        """What the latest hop of all channels vibrates, at most 16."""
        told: tuple[tuple[float, float, float], ...] = self._kernel.told
        return told

    def take_glides(self) -> FloatArray:
        """Return what all slots did since the last call; see `HapticTransform.take_glides`."""
        return np.frombuffer(self._kernel.take_glides()).reshape(-1, len(GLIDE_COLUMNS))

    def process(self, frames: Frames) -> FloatArray:
        """Return (frames, channels out) of vibration for a block that `fit_block` takes.

        Raises as `fit_block` does. Called on the audio thread: what Python does here costs more
        than the kernel, where other programs have had the caches since the last block.
        """
        try:
            vibration = np.empty((len(frames), self._channels_out))
            self._kernel.process(frames, vibration)
        except (TypeError, ValueError, BufferError):
            # The block has one of the rare layouts, or is no sound.
            frames = fit_block(frames, self._channels)
            vibration = np.empty((len(frames), self._channels_out))
            self._kernel.process(frames, vibration)
        return vibration

    def finish(self) -> FloatArray:
        """Return the last `latency_frames` of vibration, as if silence followed; restart."""
        rest = self.process(np.zeros((self.latency_frames, self._channels)))
        self._kernel.reset()
        return rest

    def reset(self) -> None:
        """Start a new stream; the counters go on."""
        self._kernel.reset()


Form = Literal["live", "reference"]
Implementation = Literal["compiled", "numpy"]

FORMS: tuple[Form, ...] = ("live", "reference")


class HapticTransform:
    """Vibration for a stream of sound, block by block; pure: no clock, no I/O.

    Any split of the stream into blocks gives the same bytes. Use from one thread at a time.

    Parameters
    ----------
    samplerate : int
        Frames a second, 1 000 to 768 000.
    channels : int
        Channels of the sound, 1 to 64.
    parameters : TransformParameters, optional
        What shapes the vibration; default: the paper's.
    form : {'live', 'reference'}
        `live` is what a cushion plays, `reference` the paper's equations literally.
    per_channel : bool
        Whether each channel is transformed alone, instead of the mono mix of all: see `downmix`.
    weights : ndarray, optional
        (channels, outputs, 2): each output is the mean of two mixes of the channels by these
        weights, and is transformed alone. See `MonoMix`.
    single : bool
        Whether the caller will round the vibration to float32. The reference form then takes a
        third of the time and gives the same float32 values. The live form ignores it.
    implementation : {'compiled', 'numpy'}, optional
        How the live form is computed. Both agree within 1e-6 of full scale; `numpy` takes about
        fifteen times as long. Default: `compiled` if the kernel exists (see `kernel_warning`).
        The reference form is always `numpy`.

    Attributes
    ----------
    channels_out : int
        Channels of the vibration.

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
        self.implementation = _choose_implementation(form, implementation)
        self._single = single
        self._mixdown = None if weights is None else Mixdown(weights, samplerate)
        streamed = self._mixdown.outputs if self._mixdown else channels
        per_channel |= self._mixdown is not None
        self.channels_out = streamed if per_channel else 1
        self._references: list[ReferenceTransform] = []
        self._stream = self._open(streamed, per_channel)

    def _open(self, channels: int, per_channel: bool) -> ChannelBank | KernelStream:
        """Return a new stream."""
        if self.form == "reference":
            self._references = [
                ReferenceTransform(self.parameters, self.samplerate, single=self._single)
                for _ in range(self.channels_out)
            ]
            return ChannelBank(self._references, channels)
        design = LiveDesign.of(self.parameters, self.samplerate)
        if self.implementation == "compiled":
            return KernelStream(design, channels, per_channel)
        return ChannelBank([LiveTransform(design) for _ in range(self.channels_out)], channels)

    @property
    def latency_frames(self) -> int:
        """Frames by which the vibration of an onset follows its sound; exact and constant.

        Synchronisation uses this one: people see and hear when something begins.
        """
        return self._stream.latency_frames

    @property
    def tonal_latency_frames(self) -> int:
        """Frames by which sustained levels and endings follow; no less, and constant."""
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
        """Unusable samples of sound so far, which counted as 0."""
        return (self._mixdown or self._stream).replaced_samples

    @property
    def principal(self) -> tuple[tuple[float, float, float], ...]:
        """What the latest hop vibrates, at most 16 partials; () in the reference form.

        Each is (Hz of the sound, Hz of vibration, amplitude in full scale). With several outputs,
        those of all. Any thread may read it while another one calls `process`.
        """
        return self._stream.told

    def take_glides(self) -> FloatArray:
        """Return what the partials of the live form did since the last call, one row a glide.

        The first call starts the recording and returns no rows; the vibration is the same with and
        without it. Not for live sound: rows are allocated as they come, 72 bytes each.

        Returns
        -------
        ndarray
            (glides, 9) float64 with the columns of `GLIDE_COLUMNS`; `PartialSynthesis` plays them.
            The frame is counted from the start of the recording, in the vibration as `process`
            returns it, without the low-pass's delay.
        """
        return self._stream.take_glides()

    @property
    def past(self) -> tuple[bytes, ...]:
        """The state of the reference form's input stage, carried from one unit to the next.

        May be set to that of another stream of the same format, to continue in the same way.
        """
        return tuple(part.past for part in self._input_parts())

    @past.setter
    def past(self, past: tuple[bytes, ...]) -> None:
        for part, its in zip(self._input_parts(), past, strict=True):
            part.past = its

    def _input_parts(self) -> list[ReferenceTransform | MonoMix]:
        """Return what keeps a state before the first unit of the reference form."""
        if not isinstance(self._stream, ChannelBank) or not self._references:
            return []
        return [*self._references, self._stream.mix]

    def process(self, frames: Frames) -> FloatArray:
        """Return the vibration now due, (frames, channels_out) float64, full scale +-1.

        frames: (frames, channels), or (frames,) for one channel; float32 or float64, 0 frames
            upwards. Samples that are not finite or exceed 1e3 count as 0 and in `replaced_samples`.
        UsageError: the block has another type or shape.
        """
        return self._stream.process(self._mixdown.process(frames) if self._mixdown else frames)

    def finish(self) -> FloatArray:
        """Return the last `latency_frames` of vibration, (frames, channels_out); start again."""
        if self._mixdown:
            self._mixdown.reset()
        return self._stream.finish()

    def reset(self) -> None:
        """Start a new stream; the counters go on."""
        if self._mixdown:
            self._mixdown.reset()
        self._stream.reset()


def _choose_implementation(form: Form, wanted: Implementation | None) -> Implementation:
    """Return how a form is computed; if there is a choice, the faster way."""
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
