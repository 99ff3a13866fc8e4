"""The interface of everything that takes vibration."""

from typing import Protocol

from device.units import Float32Array, FloatArray


class VibrationOutput(Protocol):
    """Takes vibration block by block; then `close` keeps it or `abort` discards it.

    WAV files and the simulated rig implement it. Sound-card outputs can be used instead. Use from
    one thread at a time; after that thread has ended, another one may call `close` or `abort`. Only
    the first of these calls has an effect.
    """

    @property
    def samplerate(self) -> int:
        """Rate in Hz that the vibration must have."""

    @property
    def channels(self) -> int:
        """Number of columns that a block must have."""

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Take one block: (frames, channels), full scale ±1.0, any number of frames, also 0.

        The caller may reuse the array after the return. InternalError: the block has another shape,
        or the output is closed. WriteError: the disk is full or failed; all is discarded.
        """

    def close(self) -> None:
        """Finish: all frames written are kept; a file appears under its name."""

    def abort(self) -> None:
        """Discard everything, as if the output had never been opened. Raises nothing."""
