"""Section "Rendering a file": time and memory that `cushion render` takes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import soundfile

from audioflinger_hook.offline.batch import usable_cores
from tools.bench.cost import in_ffts
from tools.bench.report import Must, Row, Section
from tools.bench.sounds.signals import SAMPLERATE, demo_sound
from tools.bench.workbench import Workbench
from tools.records import PROJECT_ROOT

PACKAGE = "audioflinger_hook"
LONG_S = 600.0
LONG_WALL = Must("<=", 9.0)
PEAK_MEMORY = Must("<=", 400.0)
TIMEOUT_S = 300.0
A_CORE = {"live": Must(">=", 400.0), "reference": Must(">=", 250.0)}
A_CORE_FFTS = {form: Must("<=", in_ffts(1.0 / must.bound)) for form, must in A_CORE.items()}
REPEATS = 3

# A small process starts the command, because a child's peak memory includes its parent's.
_WATCHER = """
import json, os, resource, subprocess, sys, time
start = time.perf_counter()
done = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
wall_s = time.perf_counter() - start
peak_kb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
print(json.dumps([done.returncode, wall_s, peak_kb, done.stderr[-400:]]))
"""


# This script runs the command after all imports, and measures CPU time of the rendering and an FFT.
_STARTED = """
import json, os, sys, time
from tools.bench.cost import rfft_unit_s
from audioflinger_hook.cli import main, render
sys.stdout = open(os.devnull, "w")
repeats, forms = int(sys.argv[1]), sys.argv[2].split(",")
spent = {form: [] for form in forms}
for form in forms * repeats:
    unit_s = rfft_unit_s()
    start = time.process_time()
    code = main([*sys.argv[3:], "--transform", form])
    if code:
        sys.exit(code)
    spent[form].append((time.process_time() - start, unit_s))
sys.__stdout__.write(json.dumps(spent))
"""


def render_speed(bench: Workbench) -> Section:
    """Measure wall time, CPU time and peak memory of `cushion render`."""
    rows: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="cushion-bench-") as folder:
        for duration_s in bench.effort.render_s:
            source = Path(folder) / "sound.wav"
            write_sound(source, duration_s)
            for measure in (_whole_command, _a_core, _several_files):
                rows += measure(source, f"{duration_s / 60:g} min", duration_s)
    return Section(
        "Rendering a file",
        "`cushion render` renders the repeated demo scene, 48 kHz stereo. Wall time includes the "
        "start of Python. Peak memory must not depend on the duration of the sound. The column *x "
        "real time* shows the duration of the sound divided by the wall time of its rendering with "
        "the live form. The columns with *a core* use CPU time without the start of Python, the "
        f"best of {REPEATS} runs. Columns with *FFTs* show the cost of a second of sound in FFTs. "
        "In rows with *files at once*, one file per core is rendered at the same time. The limit "
        "of peak memory applies to all durations; the other limits apply only to ten minutes of "
        "sound.",
        tuple(rows),
    )


def _whole_command(source: Path, name: str, duration_s: float) -> list[Row]:
    wall_s, peak_mb = _render(str(source), str(source.with_name("vibration.wav")))
    return [
        Row(name, wall_s, "s", "wall time", LONG_WALL if duration_s >= LONG_S else None),
        Row(name, duration_s / wall_s, "", "x real time"),
        Row(name, peak_mb, "MB", "peak memory", PEAK_MEMORY),
    ]


def _a_core(source: Path, name: str, duration_s: float) -> list[Row]:
    target = str(source.with_name("vibration.wav"))
    # With one worker, all CPU time belongs to this process.
    command = ["render", str(source), target, "--workers", "1"]
    done = subprocess.run(
        [sys.executable, "-c", _STARTED, str(REPEATS), ",".join(A_CORE), *command],
        capture_output=True,
        timeout=TIMEOUT_S,
        text=True,
        env=_environment(),
    )
    if done.returncode != 0:
        raise RuntimeError(f"`render` ended with exit code {done.returncode}: {done.stderr[-400:]}")
    spent: dict[str, list[tuple[float, float]]] = json.loads(done.stdout)
    rows = []
    for form, must in A_CORE.items():
        # The minima of both times are used, since other programs only add time.
        seconds, unit_s = map(min, zip(*spent[form], strict=True))
        limits = (must, A_CORE_FFTS[form]) if duration_s >= LONG_S else (None, None)
        column, ffts_column = f"x real time a core, {form}", f"a second a core, {form}, FFTs"
        rows.append(Row(name, duration_s / seconds, "", column, limits[0], ffts_column=ffts_column))
        ffts = round(seconds / duration_s / unit_s)
        rows.append(Row(name, ffts, "FFTs", ffts_column, limits[1]))
    return rows


def _several_files(source: Path, name: str, duration_s: float) -> list[Row]:
    cores = usable_cores()
    with tempfile.TemporaryDirectory(dir=source.parent) as folder:
        sources = [Path(folder) / f"{number}.wav" for number in range(cores)]
        for link in sources:
            link.hardlink_to(source)
        out = Path(folder) / "out"
        out.mkdir()
        wall_s, _ = _render(*map(str, sources), "--out-dir", str(out), "--workers", str(cores))
    return [Row(f"{name}, {cores} files at once", cores * duration_s / wall_s, "", "x real time")]


def _render(*arguments: str) -> tuple[float, float]:
    """Run `cushion render`, and return its wall time in s and peak memory in MB.

    RuntimeError: the command failed.
    """
    done = subprocess.run(
        [sys.executable, "-S", "-c", _WATCHER, sys.executable, "-m", PACKAGE, "render", *arguments],
        stdout=subprocess.PIPE,
        timeout=TIMEOUT_S,
        check=True,
        text=True,
        env=_environment(),
    )
    exit_code, wall_s, peak_kb, message = json.loads(done.stdout)
    if exit_code != 0:
        raise RuntimeError(f"`render` ended with exit code {exit_code}: {message}")
    return float(wall_s), float(peak_kb) / 1024.0


def _environment() -> dict[str, str]:
    path = os.pathsep.join(filter(None, (str(PROJECT_ROOT), os.environ.get("PYTHONPATH"))))
    return os.environ | {"PYTHONPATH": path}


def write_sound(path: Path, duration_s: float) -> None:
    """Write a 16-bit WAV file in which the demo scene is repeated for `duration_s`."""
    demo = np.clip(demo_sound(), -1.0, 1.0)
    left = round(duration_s * SAMPLERATE)
    with soundfile.SoundFile(path, "w", SAMPLERATE, demo.shape[1], "PCM_16") as file:
        for first in range(0, left, len(demo)):
            file.write(demo[: left - first])
