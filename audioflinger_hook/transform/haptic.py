"""The public class of the transform, which computes vibration from sound."""

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
    """The live form of one stream, computed by the compiled core.

    each: whether each channel has its own vibration. NotFoundError: the core cannot be loaded.
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
        """Number of frames of vibration that `process` and `finish` have returned."""
        return int(self._core.readings.frames)

    @property
    def replaced_samples(self) -> int:
        """Number of invalid samples of sound, which were replaced by 0."""
        return int(self._core.readings.replaced)

    @property
    def limited_samples(self) -> int:
        """Number of vibration samples changed by the limiter; some may not be returned yet."""
        return int(self._core.readings.limited)

    @property
    def told(self) -> tuple[tuple[float, float, float], ...]:
        """See `HapticTransform.principal`."""
        return self._core.partials

    def take_glides(self) -> FloatArray:
        """See `HapticTransform.take_glides`."""
        self._records_glides = True
        found, self._glides = self._glides, []
        return np.concatenate([np.empty((0, GLIDE_NUMBERS)), *found])

    def process(self, frames: Frames) -> FloatArray:
        """Return vibration, (frames, outputs). UsageError: see `HapticTransform.process`."""
        fitted = fit_block(frames, self._channels)
        if self._records_glides:
            self._core.record_glides(len(fitted))
        vibration = self._core.vibrate(fitted)
        if self._records_glides:
            self._glides.append(self._core.record_glides(0))
        return vibration

    def finish(self) -> FloatArray:
        """End the sound: return the last `latency_frames` of vibration, and reset."""
        rest = self.process(np.zeros((self.latency_frames, self._channels)))
        self._core.reset()
        return rest

    def reset(self) -> None:
        """Start a new stream. The counts of samples and of frames keep their values."""
        self._core.reset()


Form = Literal["live", "reference"]
FORMS: tuple[Form, ...] = get_args(Form)


class HapticTransform:
    """Computes the vibration for a stream of sound, block by block.

    Block sizes do not affect the vibration. Only one thread at a time may use the object.

    samplerate: Hz, 1 000 to 768 000. channels: number of channels of the sound, 1 to 64.
    parameters: by default those of the paper. form: "live" has low latency; "reference" follows the
    paper's equations exactly. per_channel: whether each channel is transformed separately, instead
    of the mono mix of all. weights: array (channels, outputs, 2) of the weights with which each
    channel is added to a left and a right signal for each output. The mono mix of these two signals
    is transformed. single: whether the caller rounds the vibration to float32. The reference form
    is then faster, with the same rounded values. channels_out: number of channels of the vibration.
    UsageError: samplerate, channels or form are not supported, or `band_low_hz` is too high.
    NotFoundError: the live form needs the compiled core, which cannot be loaded.
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
        """Constant delay in frames from an onset of the sound to its vibration."""
        return self._stream.latency_frames

    @property
    def tonal_latency_frames(self) -> int:
        """Delay in frames from a change or end of a steady sound to the change of its vibration."""
        return self._stream.tonal_latency_frames

    @property
    def latency_s(self) -> float:
        """`latency_frames` in seconds."""
        return self.latency_frames / self.samplerate

    @property
    def limited_samples(self) -> int:
        """Number of vibration samples changed by the limiter; some may not be returned yet."""
        return min(self._stream.limited_samples, self._stream.delivered_frames * self.channels_out)

    @property
    def replaced_samples(self) -> int:
        """Number of invalid samples of sound, which were replaced by 0."""
        return self._stream.replaced_samples

    @property
    def principal(self) -> tuple[tuple[float, float, float], ...]:
        """The strongest partials of the latest hop, at most 16; () in the reference form.

        A partial is (audio frequency in Hz, vibration frequency in Hz, amplitude; full scale is 1).
        Any thread may read this property.
        """
        return self._stream.told

    def take_glides(self) -> FloatArray:
        """Return all glides since the last call, (glides, 9); none in the reference form.

        A glide is a partial's course over some frames, from a start to an end value of frequency
        and amplitude. `core.structures.GLIDE_COLUMNS` lists the columns. The first call returns no
        rows and starts the recording; frames are counted from this call. Until the next call, each
        glide needs 72 bytes of memory.
        """
        return self._stream.take_glides()

    def process(self, frames: Frames) -> FloatArray:
        """Return the next frames of vibration, (frames, channels_out) float64, full scale +-1.

        frames: (frames, channels), or (frames,) for one channel, of a floating-point type.
            Samples beyond +-1e3 and non-finite samples become 0 and increase `replaced_samples`.
        UsageError: `frames` has the wrong type or shape.
        """
        return self._stream.process(frames)

    def finish(self) -> FloatArray:
        """End the sound: return the last vibration, (latency_frames, channels_out), and reset."""
        return self._stream.finish()

    def reset(self) -> None:
        """Start a new stream; `limited_samples` and `replaced_samples` keep their values."""
        self._stream.reset()
