"""Starts `cushion run` from this source tree for measurements, and reads the daemon's status."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from audioflinger_hook.service.state import DaemonState
from audioflinger_hook.service.status import Status
from audioflinger_hook.service.status_client import ask_status
from device.errors import CushionError, LostError
from tools.live_latency.recording import end, spawn
from tools.records import PROJECT_ROOT

READY_S = 30.0
SETTLES_S = 10.0  # longest wait in s for the delay line to reach its target
ANSWER_S = 0.5
TICK_S = 0.1
READY = (DaemonState.RUNNING, DaemonState.IDLE)


def status_of_daemon(environment: Mapping[str, str]) -> Status | None:
    """Return the status of the running daemon; None if it does not answer."""
    try:
        return ask_status(ANSWER_S, time.monotonic, environment)
    except CushionError:
        return None


@contextmanager
def running_daemon(
    device: str,
    environment: Mapping[str, str],
    folder: Path,
    *,
    block_frames: int | None = None,
    arguments: Sequence[str] = (),
) -> Iterator[None]:
    """Run `cushion run` from this source tree within a `with` block.

    device: value of `--device`.
    folder: folder for the config file and the output of the daemon.
    block_frames: block size of the daemon's streams; None for the default.
    arguments: further arguments of `cushion run`.

    LostError: the daemon ends, or does not play within 30 s.
    """
    command = [sys.executable, "-m", "audioflinger_hook", "run", "--device", device, *arguments]
    if block_frames is not None:
        config = folder / "latency.toml"
        config.write_text(f"block_frames = {block_frames}\n")
        command += ["--config", str(config)]
    path = os.pathsep.join(filter(None, (str(PROJECT_ROOT), environment.get("PYTHONPATH"))))
    printed = folder / "daemon.log"
    with printed.open("wb") as log:
        process = spawn(command, {**environment, "PYTHONPATH": path}, stderr=log.fileno())
        try:
            _wait_until_ready(process, environment, printed)
            yield
        finally:
            end(process)


def _wait_until_ready(
    process: subprocess.Popen[bytes], environment: Mapping[str, str], printed: Path
) -> None:
    began_s = time.monotonic()
    playing_s = np.inf
    while (now_s := time.monotonic()) < min(began_s + READY_S, playing_s + SETTLES_S):
        if process.poll() is not None:
            break
        status = status_of_daemon(environment)
        if status and status.state in READY and status.engine == "native":
            return
        if status and status.state in READY and status.delay_line.delay_ms > 0.0:
            playing_s = min(playing_s, now_s)
            if status.delay_line.state == "locked":
                return
        time.sleep(TICK_S)
    if process.poll() is not None or playing_s == np.inf:
        said = printed.read_text("utf-8", "replace").strip().splitlines()
        raise LostError(f"the daemon does not play: {said[-1] if said else 'it says nothing'}")
