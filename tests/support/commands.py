"""The `cushion` command, run as its users run it, and the files it is run on.

`cushion` runs a process of its own, away from the project's folder and with the environment of a
plain shell; `call` runs the command inside this process, a second sooner, for what cannot depend
on that. Both return what came of it. Arguments may be numbers and paths.
"""

import contextlib
import io
import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import soundfile
from numpy.typing import NDArray

from audioflinger_hook.cli import main
from tests.support.recordings import ROOT

DEADLINE_S = 60.0
"""No command here takes a tenth of it; who reaches it hangs."""

RATE = 48_000
"""Samplerate in Hz where it does not matter."""

STEERING = ("FORCE_COLOR", "NO_COLOR", "COLUMNS", "TTY_COMPATIBLE", "TTY_INTERACTIVE")
"""What a shell may export to change how programs print; the runs here do without."""

RUN = """
import sys
from audioflinger_hook.cli import main
sys.exit(main())
"""


@dataclass(frozen=True)
class Done:
    """What came of a command: exit code (negative: the signal that ended it) and what it said."""

    code: int
    stdout: str
    stderr: str


def environment(**changes: str) -> dict[str, str]:
    """Return the environment of a plain shell, in which a Python elsewhere finds the packages."""
    plain = {
        name: text
        for name, text in os.environ.items()
        if name not in STEERING and not name.startswith("PYTHON")
    }
    return plain | {"PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"} | changes


def start(
    *arguments: object,
    prelude: str = "",
    env: Mapping[str, str] = {},
    warnings: str = "error",
    **options: Any,
) -> subprocess.Popen[str]:
    """Start a command and return its process; warnings are errors in it, too.

    prelude: Python that runs in the process before the command does; env: variables added to the
    `environment`; warnings: what is done with them; what else is given goes to Popen.
    """
    program = ["-c", prelude + RUN] if prelude else ["-m", "audioflinger_hook"]
    command = [sys.executable, "-W", warnings, *program, *map(str, arguments)]
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "cwd": "/"}
    child = pipes | {"stdin": subprocess.DEVNULL} | options
    return subprocess.Popen(
        command, env=environment(**env), encoding="utf-8", errors="surrogateescape", **child
    )


def cushion(*arguments: object, **options: Any) -> Done:
    """Run a command in a process of its own; options are those of `start`."""
    with start(*arguments, **options) as process:
        try:
            stdout, stderr = process.communicate(timeout=DEADLINE_S)
        finally:
            process.kill()
    return Done(process.returncode, stdout or "", stderr or "")


def call(*arguments: object, program: Callable[[list[str]], int] = main) -> Done:
    """Run a command, or the main function of another program, inside this process."""
    stdout, stderr = io.StringIO(), io.StringIO()
    handlers = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    try:
        with contextlib.redirect_stdout(stdout), contextlib.redirect_stderr(stderr):
            code = program([str(argument) for argument in arguments])
    except SystemExit as end:  # --help and --version
        code = int(end.code or 0)
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return Done(code, stdout.getvalue(), stderr.getvalue())


def document(*arguments: object) -> Any:
    """Run a command with --json that works and has nothing to warn of; return what it prints."""
    done = call(*arguments, "--json")
    assert (done.code, done.stderr) == (0, ""), done
    return json.loads(done.stdout)


def without_a_reader(*arguments: object, **options: Any) -> Done:
    """Run a command in a process of its own; whoever read its standard output has gone."""
    ours, theirs = os.pipe()
    os.close(ours)
    try:
        return cushion(*arguments, stdout=theirs, **options)
    finally:
        os.close(theirs)


def ended_by(name: str, folder: Path) -> dict[str, str]:
    """Return an environment in which a process that opens a file of this name ends at once."""
    (folder / "sitecustomize.py").write_text(
        "import os, sys\n"
        "def ended(event, arguments):\n"
        f"    if event == 'open' and str(arguments[0]).endswith({name!r}):\n"
        "        os._exit(9)\n"
        "sys.addaudithook(ended)\n"
    )
    return {"PYTHONPATH": f"{folder}{os.pathsep}{ROOT}"}


def refused(done: Done, code: int = 2) -> str:
    """Return the one line that an error is; everything every error must be is asserted."""
    assert done.code == code, done
    assert done.stdout == "", done
    assert done.stderr.endswith("\n"), done
    assert done.stderr.count("\n") == 1, done
    assert done.stderr.startswith("cushion: error: "), done
    assert "fault of cushion" not in done.stderr, done
    return done.stderr.removesuffix("\n")


def until(condition: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    """Return once the condition holds; fails if the process ends before, or at the deadline."""
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(0.005)
            raise AssertionError(f"ended too soon: {process.communicate()}")


def workers_of(process: subprocess.Popen[str]) -> list[psutil.Process]:
    """Return the worker processes of a run, not the server that forks them."""
    servers = psutil.Process(process.pid).children()
    return [worker for server in servers for worker in server.children()]


def held_back(process: subprocess.Popen[str] | psutil.Process, folder: Path) -> list[int]:
    """Return the length of every file that a process writes in a folder, named or not yet."""
    lengths = []
    with contextlib.suppress(OSError):  # the process has ended
        for entry in Path(f"/proc/{process.pid}/fd").iterdir():
            with contextlib.suppress(OSError):  # closed since
                if str(entry.readlink()).startswith(f"{folder}/"):
                    lengths.append(entry.stat().st_size)
    return lengths


def on_a_terminal(*arguments: object, streams: tuple[str, ...], **options: Any) -> tuple[Done, str]:
    """Run a command with some of its streams on a terminal; return it and what was drawn there."""
    ours, theirs = os.openpty()
    drawn = bytearray()
    terminal: dict[str, Any] = dict.fromkeys(streams, theirs)
    env = {"TERM": "xterm-256color", **options.pop("env", {})}
    try:
        with start(*arguments, env=env, **options, **terminal) as process:
            os.close(theirs)
            with contextlib.suppress(OSError):  # EIO: nobody has the terminal open any more
                while select.select([ours], [], [], DEADLINE_S)[0]:
                    drawn += os.read(ours, 65_536)
                process.kill()
            stdout, stderr = process.communicate(timeout=DEADLINE_S)
    finally:
        os.close(ours)
    return Done(process.returncode, stdout or "", stderr or ""), drawn.decode()


def sound(path: Path, samples: NDArray[Any], samplerate: int = RATE, **options: Any) -> Path:
    """Write samples (frames,) or (frames, channels) as a sound file, float32 WAV if not told."""
    options = {"format": "WAV", "subtype": "FLOAT"} | options
    soundfile.write(path, samples, samplerate, **options)
    return path


def noise(frames: int, channels: int = 1, seed: int = 1) -> NDArray[np.float64]:
    """Return white noise of 0.2 rms, (frames, channels)."""
    return 0.2 * np.random.default_rng(seed).standard_normal((frames, channels))


def vibration(path: Path) -> NDArray[np.float32]:
    """Return the samples of a file, (frames, channels)."""
    samples, _ = soundfile.read(path, dtype="float32", always_2d=True)
    return np.asarray(samples, np.float32)


def open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def listing(folder: Path) -> dict[str, bytes]:
    """Return everything in a folder, hidden files too: name and content."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
