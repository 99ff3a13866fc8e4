"""The compiled part of `haptic.py`, which is the way to use it."""

from audioflinger_hook.transform.arrays import FloatArray, Frames

NEIGHBOURS: int
"""Bins to either side of a peak that are cleared of its image."""

TABLE_BINS_A_BIN: int
"""Entries of `table` a bin."""

class LiveKernel:
    """The live form of one stream.

    design: bytes of `LiveDesign.to_bytes`; they are copied. channels: of the sound, 1 to 1024.
    each: one channel of vibration for each, else one for their mean. All memory is taken here.
    Holds the interpreter lock; held by one thread at a time.

    Raises
    ------
    TypeError
        The design is not bytes.
    ValueError
        It is damaged, of another version, or its numbers do not fit one another.
    """

    replaced: int
    """Unusable samples so far."""

    limited: int
    """Samples of vibration that the limiter has changed, of the hops computed so far."""

    delivered: int
    """Frames so far."""

    state: bytes
    """All that changes as a stream goes on; for a kernel of the same design. ValueError where it
    is set to what no such kernel has."""

    partials: list[list[tuple[float, float, float]]]
    """What sounds in each voice: Hz of vibration, amplitude, phase in cycles."""

    told: tuple[tuple[float, float, float], ...]
    """What the latest hop of all voices vibrates, at most 16: Hz of the sound, Hz of vibration,
    amplitude. Any thread may read it."""

    def __new__(cls, design: bytes, channels: int, each: bool) -> LiveKernel: ...
    def process(self, frames: Frames, vibration: FloatArray, /) -> None:
        """Take a block of sound and write as much vibration.

        frames: (frames, channels), or (frames,) of one channel, float32 or float64, in any layout.
        vibration: (frames, channels out), float64, contiguous; overwritten.

        Raises
        ------
        TypeError, ValueError
            One of them is something else; the stream stands as before.
        """

    def reset(self) -> None:
        """Begin a new stream; the counters go on."""

    def take_glides(self) -> bytes:
        """Return what the slots of all voices did since the last call, as rows of float64.

        A row has the columns of `GLIDE_COLUMNS`. The first call starts the recording and returns
        nothing. MemoryError: rows were lost, as memory was lacking.
        """
