"""The compiled part of `analysis.py`, which is the way to use it."""

from audioflinger_hook.transform.arrays import FloatArray, IntArray
from audioflinger_hook.transform.spectrum import ComplexArray

NEIGHBOURS: int
"""Bins to either side of a peak that are cleared of its image."""

TABLE_BINS_A_BIN: int
"""Entries of `table` a bin."""

SCRATCH_A_BIN: int
"""Entries of `scratch` a bin."""

def find(
    spectra: ComplexArray,
    table: FloatArray,
    turn: FloatArray,
    bins: int,
    first: int,
    last: int,
    bin_hz: float,
    threshold_hz: float,
    peak_span_min: float,
    weakest_image: float,
    side_lobe: float,
    most: int,
    scratch: FloatArray,
    row: IntArray,
    found: FloatArray,
    /,
) -> int:
    """Find the principal frequencies of each row; return how many there are in all.

    spectra: (rows, columns), of which the first `bins` are looked at. table: the window's real
    spectrum, 1 at 0. turn: (2, low bins + NEIGHBOURS), cosine and sine of the turn of each bin's
    phase to the window's centre. first, last: bins on which a peak counts. weakest_image: peaks
    up to this amplitude keep their image. side_lobe: share of a row's highest amplitude that the
    others must exceed. most: of more in a row those with the largest r stay.

    Overwritten: scratch, (SCRATCH_A_BIN x bins,); row, (rows x most,), the row of each; found,
    (4, rows x most), their audio_hz, amplitude, bandwidth_hz and r. For `most` over bins // 2
    room for bins // 2 will do. All arrays are contiguous. Keeps no state; holds the interpreter
    lock.

    Raises
    ------
    TypeError
        Something is of another type.
    ValueError
        Something is not contiguous, or its size does not fit the others.
    """
