"""The live form compiled: `_kernel` does in one call a block what `live` does in NumPy.

    native/live.c: input_stage.c -> fft.c -> peaks.c, analysis.c -> tracking.c -> synthesis.c

The NumPy implementation says what the kernel computes, for fifteen times the cost. It plays where
the kernel could not be built or does not load.
"""

from __future__ import annotations

from types import ModuleType

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray, Frames
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.input_stage import fit_block
from device.extension import load

_kernel: ModuleType | None
try:
    _kernel = load("audioflinger_hook.transform._kernel", "LiveKernel")
except ImportError as error:
    _kernel = None
    _why_missing = str(error)


def kernel_warning() -> str | None:
    """Return why the live form is not compiled, and what that costs; None where it is."""
    if _kernel is not None:
        return None
    return (
        f"the transform runs uncompiled, the same vibration for about fifteen times the processor "
        f"time ({_why_missing}); to build it: `rm -rf .venv`, then `make run`, with a C compiler"
    )


class KernelStream:
    """One stream of the live form, (frames, channels) to (frames, channels or 1), compiled.

    The vibration is that of `ChannelBank` within 1e-6 of full scale; the counters are the same, and
    any split gives the same bytes. All memory is allocated in the constructor. Held by one thread
    at a time.

    Parameters
    ----------
    design : LiveDesign
        All numbers and tables.
    channels : int
        Channels of the sound.
    each : bool
        Whether every channel is transformed by itself, instead of their mean.

    Raises
    ------
    RuntimeError
        The kernel is not there: see `kernel_warning`.
    """

    def __init__(self, design: LiveDesign, channels: int, each: bool) -> None:
        if _kernel is None:
            raise RuntimeError(kernel_warning())
        self._kernel = _kernel.LiveKernel(design.settings(), channels, each)
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
        """Return the last `latency_frames` of vibration, as if silence followed; start anew."""
        rest = self.process(np.zeros((self.latency_frames, self._channels)))
        self._kernel.reset()
        return rest

    def reset(self) -> None:
        """Start a new stream; the counters go on."""
        self._kernel.reset()
