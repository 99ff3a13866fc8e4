"""Parts of the compiled kernel for tests, built on demand: `probes` is a module, or None.

    find(spectra, table, turn, first_sample, bins, first, last, bin_hz, threshold_hz,
         peak_span_min, weakest_image, side_lobe, most, row, found)
        Find the principal frequencies of each row of spectra (rows, columns); return their number.
        row (rows x most,) and found (4, rows x most) are overwritten: audio_hz, amplitude,
        bandwidth_hz and r. The other arguments are named as in `AnalysisDesign`.
    spectrum(samples, length, bins)
        Write the first bins of scipy.fft.rfft(samples, length): real, imaginary, (2, bins).
    fifth_roots(numbers), cosines(numbers)
        Replace numbers by their fifth roots, or numbers of turns by their cosines.
    exact_exp(numbers) and the others of native/exact.h
        Replace numbers by the function of them. power_035 is exact_pow(x, 0.35).

Run as a module it only builds, with the compiler and flags of CC and CFLAGS.
"""

from __future__ import annotations

import os
import subprocess
import sysconfig
import tempfile
from importlib.machinery import ExtensionFileLoader
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
NATIVE = ROOT / "audioflinger_hook/transform/native"
SOURCES = [
    Path(__file__).with_suffix(".c"),
    Path(__file__).with_name("python_arrays.c"),
    *(NATIVE / f"{name}.c" for name in ("analysis", "fft", "fft_plan", "peaks")),
]
BUILT = ROOT / "build" / f"kernel_probes{sysconfig.get_config_var('EXT_SUFFIX')}"
FLAGS = "-O3 -fPIC -shared -ffp-contract=off -fno-math-errno -Wall -Wextra -Werror"


def build() -> None:
    """Compile the probes unless they are newer than their sources."""
    headers = (*NATIVE.glob("*.h"), *Path(__file__).parent.glob("*.h"))
    newest = max(path.stat().st_mtime for path in (*SOURCES, *headers))
    if BUILT.exists() and BUILT.stat().st_mtime >= newest:
        return
    BUILT.parent.mkdir(exist_ok=True)
    include = sysconfig.get_paths()["include"]
    flags = [*FLAGS.split(), *os.environ.get("CFLAGS", "").split()]
    with tempfile.TemporaryDirectory(dir=BUILT.parent) as folder:
        # Another process may build at the same time: the finished file is put in place at once.
        made = Path(folder) / BUILT.name
        command = [os.environ.get("CC", "cc"), *flags, f"-I{include}", f"-I{NATIVE}"]
        subprocess.run([*command, *map(str, SOURCES), "-lm", "-o", str(made)], check=True)
        made.replace(BUILT)


def _load() -> Any:
    try:
        build()
    except (OSError, subprocess.CalledProcessError):
        return None
    loader = ExtensionFileLoader("kernel_probes", str(BUILT))
    spec = spec_from_file_location("kernel_probes", BUILT, loader=loader)
    assert spec
    assert spec.loader
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


if __name__ == "__main__":
    build()
else:
    probes: Any = _load()
