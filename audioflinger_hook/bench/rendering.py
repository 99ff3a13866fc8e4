"""Bench on rendering: a file through the command line, as a user would do it."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import soundfile

from audioflinger_hook.bench.report import Missing, Must, Row, Section
from audioflinger_hook.bench.signals import PROJECT_ROOT, SAMPLERATE
from audioflinger_hook.bench.workbench import Workbench, not_compiled
from audioflinger_hook.clients import mixdown
from audioflinger_hook.scenes import demo_scene

PACKAGE = "audioflinger_hook"
LONG_S = 600.0
LONG_WALL = Must("<=", 9.0)
PEAK_MEMORY = Must("<=", 400.0)
TIMEOUT_S = 300.0

# A small process of its own starts the command: the peak of a child includes what its parent
# occupied when it was started, and the bench occupies a lot.
_WATCHER = """
import json, os, resource, subprocess, sys, time
start = time.perf_counter()
done = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
wall_s = time.perf_counter() - start
peak_kb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
print(json.dumps([done.returncode, wall_s, peak_kb, done.stderr[-400:]]))
"""


def render_speed(bench: Workbench) -> Section:
    """Wall time and peak memory of `render`, the whole process."""
    title = "Rendering a file"
    explanation = (
        "`cushion render` of the demo scene in a loop, 48 kHz stereo, live form: wall time of the "
        "whole command, start of Python included, and the most memory that it occupied, which must "
        "not depend on the length. The limit of time is asked of ten minutes (full run)."
    )
    if importlib.util.find_spec(f"{PACKAGE}.__main__") is None:
        reason = f"`python -m {PACKAGE}` is not there"
        return Section(title, explanation, (), (Missing("rendering", reason, "pip install -e ."),))
    rows: list[Row] = []
    missing: list[Missing] = [*not_compiled("rendering")]
    with tempfile.TemporaryDirectory(prefix="cushion-bench-") as folder:
        for duration_s in bench.effort.render_s:
            name = f"{duration_s / 60:g} min"
            try:
                wall_s, peak_mb = _render(Path(folder), duration_s)
            except (RuntimeError, OSError, subprocess.TimeoutExpired) as error:
                reason = " ".join(str(error).split())
                missing.append(Missing(f"rendering {name}", reason, "cushion render --help"))
                continue
            rows += [
                Row(name, wall_s, "s", "wall time", LONG_WALL if duration_s >= LONG_S else None),
                Row(name, duration_s / wall_s, "", "x real time"),
                Row(name, peak_mb, "MB", "peak memory", PEAK_MEMORY),
            ]
    return Section(title, explanation, tuple(rows), tuple(missing))


def _render(folder: Path, duration_s: float) -> tuple[float, float]:
    """Return wall seconds and peak MB of one rendering; RuntimeError where it fails."""
    source, target = folder / "sound.wav", folder / "vibration.wav"
    _write_sound(source, duration_s)
    command = [sys.executable, "-m", PACKAGE, "render", str(source), str(target)]
    # The code that is measured here, whether it is installed or not.
    path = os.pathsep.join(filter(None, (str(PROJECT_ROOT), os.environ.get("PYTHONPATH"))))
    done = subprocess.run(
        [sys.executable, "-S", "-c", _WATCHER, *command],
        stdout=subprocess.PIPE,
        timeout=TIMEOUT_S,
        check=True,
        text=True,
        env=os.environ | {"PYTHONPATH": path},
    )
    exit_code, wall_s, peak_kb, message = json.loads(done.stdout)
    if exit_code != 0:
        raise RuntimeError(f"`render` ended with exit code {exit_code}: {message}")
    return float(wall_s), float(peak_kb) / 1024.0


def _write_sound(path: Path, duration_s: float) -> None:
    """Write the demo scene in a loop, 16 bit, without holding all of it."""
    demo = mixdown(demo_scene())
    demo = np.clip(demo, -1.0, 1.0)
    left = round(duration_s * SAMPLERATE)
    with soundfile.SoundFile(path, "w", SAMPLERATE, demo.shape[1], "PCM_16") as file:
        while left > 0:
            file.write(demo[:left])
            left -= len(demo)
