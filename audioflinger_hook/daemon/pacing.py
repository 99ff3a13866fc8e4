"""One thread that plays and writes files in real time."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol

BURST = 64  # late blocks at most in a row, before other threads get a turn
BREATH_S = 0.001  # length of that turn
LATE_MAX_S = 2.0  # lateness above this counts as a pause and is not caught up


class PacedJob(Protocol):
    """A job done block by block. error: the error that ended it, or None."""

    error: Exception | None

    @property
    def due_s(self) -> float:
        """Time of the next block, in seconds from the job's start."""

    def run(self, now_s: float) -> bool:
        """Do the next block; return False if it was the last."""


class FrameTime:
    """Duration of all frames so far, computed from their count; a sum of durations would drift."""

    def __init__(self, samplerate: int) -> None:
        self._before_s = 0.0
        self._frames = 0
        self._samplerate = samplerate

    def after(self, frames: int, samplerate: int) -> float:
        """Return the duration in seconds after `frames` more frames at `samplerate` Hz."""
        if samplerate != self._samplerate:
            return self._before_s + self._frames / self._samplerate + frames / samplerate
        return self._before_s + (self._frames + frames) / samplerate

    def add(self, frames: int, samplerate: int) -> None:
        """Count frames at `samplerate` Hz."""
        if samplerate != self._samplerate:
            self._before_s += self._frames / self._samplerate
            self._frames, self._samplerate = 0, samplerate
        self._frames += frames


class Pacer:
    """Does jobs at their due times, earliest first, on a thread that the first job starts.

    Due times are absolute, so nothing drifts. Late blocks are done in bursts; after a long stall,
    all jobs are shifted. An exception ends its job. The supervising thread begins and ends jobs.
    exact: whether jobs get their due times instead of the present time.
    """

    def __init__(self, now_s: Callable[[], float], *, exact: bool = False) -> None:
        self._now_s = now_s
        self._exact = exact
        self._jobs: dict[PacedJob, float] = {}  # with the start of each
        self._lock = threading.Lock()
        self._changed = threading.Event()
        self._thread: threading.Thread | None = None
        self._closed = False

    def begin(self, job: PacedJob, now_s: float) -> None:
        """Start or continue a job: its next block is due now."""
        with self._lock:
            self._jobs[job] = now_s - job.due_s
        if self._thread is None and not self._closed:
            # A daemon thread does not keep a program alive that fails before `close`.
            self._thread = threading.Thread(target=self._keep_pace, name="pacer", daemon=True)
            self._thread.start()
        self._changed.set()

    def is_doing(self, job: PacedJob) -> bool:
        """Return whether the job runs."""
        return job in self._jobs

    def end(self, job: PacedJob) -> None:
        """Stop a job. After the return the job does not run; it may begin again later."""
        with self._lock:
            self._jobs.pop(job, None)

    def close(self) -> None:
        """End the thread. May be repeated."""
        self._closed = True
        self._changed.set()
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join()

    def step(self, now_s: float) -> float:
        """Do the due blocks, at most a burst; return the seconds until the next block is due."""
        for _ in range(BURST):
            with self._lock:
                if not self._jobs:
                    return float("inf")
                job = min(self._jobs, key=lambda job: self._jobs[job] + job.due_s)
                due_s = self._jobs[job] + job.due_s
                if now_s < due_s:
                    return due_s - now_s
                if now_s - due_s > LATE_MAX_S:
                    for shifted in self._jobs:
                        self._jobs[shifted] += now_s - due_s
                    due_s = now_s
                self._do(job, due_s if self._exact else now_s)
        return BREATH_S

    def _do(self, job: PacedJob, now_s: float) -> None:
        try:
            goes_on = job.run(now_s)
        except Exception as error:
            job.error, goes_on = error, False
        if not goes_on:
            del self._jobs[job]

    def _keep_pace(self) -> None:
        while not self._closed:
            wait_s = self.step(self._now_s())
            self._changed.wait(min(wait_s, 1.0))
            self._changed.clear()
