"""Description of the machine that runs the benchmarks."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from tools.bench.cost import rfft_unit_s


@dataclass(frozen=True)
class MachineFacts:
    """Machine and software of a run.

    cores: number of processor cores that the program may use.
    load_before: system load average of the minute before the run.
    rfft_us: CPU time of one FFT of 2048 float32 samples in µs.
    """

    cpu: str
    cores: int
    system: str
    load_before: float
    python: str
    numpy: str
    scipy: str
    rfft_us: float


def machine_facts() -> MachineFacts:
    """Return the description of this machine."""
    return MachineFacts(
        cpu=cpu_model(),
        cores=len(os.sched_getaffinity(0)),
        system=f"{platform.system()} {platform.machine()}",
        load_before=os.getloadavg()[0],
        python=platform.python_version(),
        numpy=np.__version__,
        scipy=scipy.__version__,
        rfft_us=1e6 * min(rfft_unit_s() for _ in range(5)),
    )


def cpu_model() -> str:
    """Return the name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    for line in lines:
        key, _, value = line.partition(":")
        if key.strip() in {"model name", "Hardware", "Model"} and value.strip():
            return value.strip()
    return platform.processor() or "unknown processor"
