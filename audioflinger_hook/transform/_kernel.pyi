"""The compiled part of `kernel.py`, which is the way to use it; and parts of that, for tests."""

from typing import Any

from audioflinger_hook.transform.arrays import FloatArray, Frames, IntArray
from audioflinger_hook.transform.spectrum import ComplexArray

NEIGHBOURS: int
"""Bins to either side of a peak that are cleared of its image."""

TABLE_BINS_A_BIN: int
"""Entries of `table` a bin."""

class LiveKernel:
    """The live form of one stream.

    settings: every name that native/settings.h lists; they are copied. channels: of the sound, 1 to
    1024. each: one channel of vibration for each, else one for their mean. All memory is taken
    here. Holds the interpreter lock; held by one thread at a time.

    Raises
    ------
    TypeError, ValueError
        A setting is missing or does not fit the others.
    """

    replaced: int
    """Unusable samples so far."""

    limited: int
    """Samples of vibration that the limiter has changed, of the hops computed so far."""

    delivered: int
    """Frames so far."""

    state: bytes
    """All that changes as a stream goes on; for a kernel of the same settings. ValueError where it
    is set to what no such kernel has."""

    partials: list[list[tuple[float, float, float]]]
    """What sounds in each voice: Hz of vibration, amplitude, phase in cycles."""

    def __new__(cls, settings: dict[str, Any], channels: int, each: bool) -> LiveKernel: ...
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

def find(
    spectra: ComplexArray,
    table: FloatArray,
    turn: FloatArray,
    first_sample: float,
    bins: int,
    first: int,
    last: int,
    bin_hz: float,
    threshold_hz: float,
    peak_span_min: float,
    weakest_image: float,
    side_lobe: float,
    most: int,
    row: IntArray,
    found: FloatArray,
    /,
) -> int:
    """Find the principal frequencies of each row; return how many there are in all.

    spectra: (rows, columns), of which the first `bins` are looked at. table: the window's real
    spectrum, 1 at 0, without the window's first sample. turn: (2, low bins + NEIGHBOURS), cosine
    and sine of the turn of each bin's phase to the window's centre. first_sample: as a share of
    the other samples' sum. first, last: bins on which a peak counts. weakest_image: peaks up to
    this amplitude keep their image. side_lobe: share of a row's highest amplitude that the others
    must exceed. most: of more in a row those with the largest r stay.

    Overwritten: row, (rows x most,), the row of each; found, (4, rows x most), their audio_hz,
    amplitude, bandwidth_hz and r. For `most` over bins // 2 room for bins // 2 will do. All arrays
    are contiguous.

    Raises
    ------
    TypeError
        Something is of another type.
    ValueError
        Something is not contiguous, or its size does not fit the others.
    """

def spectrum(samples: FloatArray, length: int, bins: FloatArray, /) -> None:
    """Write the first bins of scipy.fft.rfft(samples, length): bins, (2, bins), real, imaginary.

    samples: (frames,), no more than length; up to length / 2 it is done as of what is padded.
    length: of the factors 2, 3 and 5.

    Raises
    ------
    TypeError, ValueError
        Something else.
    """

def fifth_roots(numbers: FloatArray, /) -> None:
    """Replace numbers from 0 up by their fifth roots."""

def cosines(numbers: FloatArray, /) -> None:
    """Replace numbers of turns by their cosines."""
