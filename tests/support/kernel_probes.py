"""Parts of the compiled kernel for tests, built on demand: `probes`, or None without a compiler.

Run as a module it only builds, with the compiler and flags of CC and CFLAGS.
"""

import ctypes
import os
import subprocess
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.ctypeslib import ndpointer

ROOT = Path(__file__).resolve().parents[2]
NATIVE = ROOT / "audioflinger_hook/transform/native"
SOURCES = [
    Path(__file__).with_suffix(".c"),
    *(NATIVE / f"{name}.c" for name in ("analysis", "fft", "fft_plan", "peaks")),
]
BUILT = ROOT / "build" / "kernel_probes.so"
FLAGS = "-O3 -fPIC -shared -ffp-contract=off -fno-math-errno -Wall -Wextra -Werror"


def build() -> None:
    """Compile the probes unless they are newer than their sources."""
    newest = max(path.stat().st_mtime for path in (*SOURCES, *NATIVE.glob("*.h")))
    if BUILT.exists() and BUILT.stat().st_mtime >= newest:
        return
    BUILT.parent.mkdir(exist_ok=True)
    flags = [*FLAGS.split(), *os.environ.get("CFLAGS", "").split()]
    with tempfile.TemporaryDirectory(dir=BUILT.parent) as folder:
        # Another process may build at the same time: the finished file is put in place at once.
        made = Path(folder) / BUILT.name
        command = [os.environ.get("CC", "cc"), *flags, f"-I{NATIVE}"]
        subprocess.run([*command, *map(str, SOURCES), "-lm", "-o", str(made)], check=True)
        made.replace(BUILT)


NUMBERS, MATRIX = (ndpointer(np.float64, dimensions, flags="C") for dimensions in (1, 2))
SPECTRA, ROWS = ndpointer(np.complex128, 2, flags="C"), ndpointer(np.int64, 1, flags="C")
SIZE, DOUBLE = ctypes.c_size_t, ctypes.c_double


class Probes:
    """The parts. Others than these, by name: exact_exp(numbers) and so on replace numbers."""

    def __init__(self) -> None:
        self._built = ctypes.CDLL(str(BUILT))
        arrays = (SPECTRA, SIZE, SIZE, NUMBERS, SIZE, MATRIX, SIZE)
        limits = (DOUBLE, SIZE, SIZE, SIZE, DOUBLE, NUMBERS, SIZE)
        self._built.find.argtypes = (*arrays, *limits, ROWS, MATRIX, SIZE)
        self._built.find.restype = ctypes.c_int64
        self._built.spectrum.argtypes = (NUMBERS, SIZE, SIZE, MATRIX, SIZE)

    def find(self, spectra, table, turn, first_sample, bins, first, last, bin_hz, *limits):
        """Find the principal frequencies of each row of spectra; return their number.

        limits: threshold_hz, peak_span_min, weakest_image, side_lobe, most, and two arrays that are
        overwritten: the rows, (rows x most,), and what is found there, (4, rows x most).
        """
        *levels, most, row, found = limits
        room = len(spectra) * min(most, bins // 2)
        assert 2 <= bins <= spectra.shape[1]
        assert first >= 1 <= most
        assert last < first or last <= bins - 2
        assert len(turn) == 2
        assert turn.shape[1] <= bins
        assert len(found) == 4
        assert min(found.shape[1], len(row)) >= room
        images = (table, len(table), turn, turn.shape[1], first_sample)
        band = (bins, first, last if last >= first else 0, bin_hz, np.array(levels))
        out = (most, row, found, found.shape[1])
        return self._built.find(spectra, *spectra.shape, *images, *band, *out)

    def spectrum(self, samples, length, bins):
        """Write the first bins of scipy.fft.rfft(samples, length): real, imaginary, (2, bins)."""
        assert len(samples) <= length
        assert bins.shape[1] <= length // 2 + 1
        count = bins.shape[1]
        assert self._built.spectrum(samples, len(samples), length, bins, count)

    def __getattr__(self, name: str):
        each = getattr(self._built, f"each_{name}")
        each.argtypes = (NUMBERS, SIZE)
        return lambda numbers: each(numbers, len(numbers))


if __name__ == "__main__":
    build()
else:
    probes: Any = None
    with suppress(OSError, subprocess.CalledProcessError):
        build()
        probes = Probes()
