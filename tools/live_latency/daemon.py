"""A daemon of this very code, started to be measured, and what a daemon says of itself."""

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
SETTLES_S = 10.0
"""How long the delay line may take to its target; after that it is measured as it is."""

ANSWER_S = 0.5
TICK_S = 0.1
READY = (DaemonState.RUNNING, DaemonState.IDLE)


def status_of_daemon(environment: Mapping[str, str]) -> Status | None:
    """Return what the daemon there says of itself, None while it does not answer."""
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
    """A context in which `cushion run` of this very code plays to a device.

    folder: for its config file and what it prints; block_frames: for its streams, None for what
    it takes by itself.

    Raises
    ------
    LostError
        It does not come to play within READY_S; the message is its own.
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
    """Return once it plays and has come to its delay, or has not for SETTLES_S."""
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
