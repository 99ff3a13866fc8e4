"""The transform for its users: sound of any channels in, vibration out."""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np

from audioflinger_hook.core.compiled_core import GLIDE_NUMBERS, Core
from audioflinger_hook.core.design import core_design
from audioflinger_hook.transform.arrays import FloatArray, Frames
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.downmix import source_mixes
from audioflinger_hook.transform.input_stage import fit_block
from audioflinger_hook.transform.parameters import TransformParameters, check_format
from audioflinger_hook.transform.reference import ReferenceStream, ReferenceTransform
from device.errors import UsageError


class CoreStream:
    """One stream of the live form, compiled; its members are those of `HapticTransform`.

    Memory grows with the largest block. channels: of the sound. each: whether every channel is
    transformed separately, instead of their mono mix. weights: (channels, outputs, 2) of sources
    that are transformed instead. NotFoundError: the core is not built.
    """

    def __init__(
        self, design: LiveDesign, channels: int, each: bool, weights: FloatArray | None = None
    ) -> None:
        self._made_of = (design, channels, each, weights)
        mixes = () if weights is None else source_mixes(weights)
        self._core = Core(
            core_design(
                design.samplerate, channels, transform=design.records(), each=each, mixes=mixes
            )
        )
        self._channels = channels
        self._records_glides = False
        self._glides: list[FloatArray] = []
        self.latency_frames = design.latency_frames
        self.tonal_latency_frames = design.tonal_latency_frames

    def __getstate__(self) -> tuple[Any, bytes]:
        return self._made_of, self._core.state

    def __setstate__(self, state: tuple[Any, bytes]) -> None:
        made_of, numbers = state
        CoreStream.__init__(self, *made_of)
        self._core.state = numbers

    @property
    def delivered_frames(self) -> int:
        """Frames of vibration given so far."""
        return int(self._core.readings.frames)

    @property
    def replaced_samples(self) -> int:
        """Unusable samples so far, which counted as 0."""
        return int(self._core.readings.replaced)

    @property
    def limited_samples(self) -> int:
        """Samples of vibration that the limiter has changed, some not delivered yet."""
        return int(self._core.readings.limited)

    @property
    def told(self) -> tuple[tuple[float, float, float], ...]:
        """What the latest hop of all channels vibrates."""
        return self._core.partials

    def take_glides(self) -> FloatArray:
        """Return what all partials did since the last call, one row a glide."""
        self._records_glides = True
        found, self._glides = self._glides, []
        return np.concatenate([np.empty((0, GLIDE_NUMBERS)), *found])

    def process(self, frames: Frames) -> FloatArray:
        """Return (frames, outputs) of vibration; raise as `fit_block`. For the audio thread."""
        fitted = fit_block(frames, self._channels)
        if self._records_glides:
            self._core.record_glides(len(fitted))
        vibration = self._core.vibrate(fitted)
        if self._records_glides:
            self._glides.append(self._core.record_glides(0))
        return vibration

    def finish(self) -> FloatArray:
        """Return the last `latency_frames` of vibration; restart."""
        rest = self.process(np.zeros((self.latency_frames, self._channels)))
        self._core.reset()
        return rest

    def reset(self) -> None:
        """Start a new stream; the counters go on."""
        self._core.reset()


Form = Literal["live", "reference"]
FORMS: tuple[Form, ...] = get_args(Form)


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

    Attributes
    ----------
    channels_out : int
        Channels of the vibration.

    Raises
    ------
    UsageError
        The format or the form is not supported.
    NotFoundError
        The live form is asked for, and the core is not built.
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
    ) -> None:
        check_format(samplerate, channels)
        if form not in FORMS:
            raise UsageError(f"transform form {form!r} is not known; allowed: {', '.join(FORMS)}")
        self.samplerate = samplerate
        self.channels = channels
        self.parameters = parameters or TransformParameters()
        self.form = form
        streamed = channels if weights is None else weights.shape[1]
        per_channel |= weights is not None
        self.channels_out = streamed if per_channel else 1
        self._stream: ReferenceStream | CoreStream
        if form == "live":
            design = LiveDesign.of(self.parameters, samplerate)
            self._stream = CoreStream(design, channels, per_channel, weights)
        else:
            references = [
                ReferenceTransform(self.parameters, samplerate, single=single)
                for _ in range(self.channels_out)
            ]
            self._stream = ReferenceStream(references, channels, weights)

    @property
    def latency_frames(self) -> int:
        """Frames by which the vibration of an onset follows its sound; exact and constant."""
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
        """Samples changed by the limiter, counted up to one hop before they are delivered."""
        return min(self._stream.limited_samples, self._stream.delivered_frames * self.channels_out)

    @property
    def replaced_samples(self) -> int:
        """Unusable samples of sound so far, which counted as 0."""
        return self._stream.replaced_samples

    @property
    def principal(self) -> tuple[tuple[float, float, float], ...]:
        """What the latest hop vibrates, at most 16 partials; () in the reference form.

        Each is (Hz of the sound, Hz of vibration, amplitude in full scale), of all outputs. Any
        thread may read it while another one calls `process`.
        """
        return self._stream.told

    def take_glides(self) -> FloatArray:
        """Return what the partials of the live form did since the last call, one row a glide.

        Rows are (glides, 9) float64 with the columns of `GLIDE_COLUMNS`; `PartialSynthesis` plays
        them. Frames count from the start of the recording, without the low-pass's delay.

        The first call starts the recording and returns no rows; the vibration stays the same. Not
        for live sound: rows are allocated as they come, 72 bytes each.
        """
        return self._stream.take_glides()

    def process(self, frames: Frames) -> FloatArray:
        """Return the vibration now due, (frames, channels_out) float64, full scale +-1.

        frames: (frames, channels), or (frames,) for one channel; float32 or float64, 0 frames
            upwards. Samples that are not finite or exceed 1e3 count as 0 and in `replaced_samples`.
        UsageError: the block has another type or shape.
        """
        return self._stream.process(frames)

    def finish(self) -> FloatArray:
        """Return the last `latency_frames` of vibration, (frames, channels_out); start again."""
        return self._stream.finish()

    def reset(self) -> None:
        """Start a new stream; the counters go on."""
        self._stream.reset()
