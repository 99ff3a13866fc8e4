"""The interface of all outputs that take vibration."""

from typing import Protocol

from device.units import Float32Array, FloatArray


class VibrationOutput(Protocol):
    """Takes vibration in blocks; at the end, `close` keeps the output and `abort` discards it.

    One thread at a time may use it. After that thread has ended, another thread may call `close`
    or `abort`. Only the first call of `close` or `abort` has an effect.
    """

    @property
    def samplerate(self) -> int:
        """Required sample rate of the vibration in Hz."""

    @property
    def channels(self) -> int:
        """Required number of channels of a block."""

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Take one block: (frames, channels), full scale ±1.0, 0 or more frames.

        After the call, the caller may reuse the array. InternalError: the block has another shape,
        or the output is closed. WriteError: writing failed, and the output is discarded.
        """

    def close(self) -> None:
        """Keep all written frames and finish. A file appears under its name only now."""

    def abort(self) -> None:
        """Discard everything, as if the output had never been opened. Raises no exception."""
