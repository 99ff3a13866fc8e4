"""One thread that plays and writes files in real time."""

import threading
from collections.abc import Callable
from fractions import Fraction
from typing import Protocol

BURST = 64  # largest number of late blocks in a row before other threads may run
BREATH_S = 0.001  # pause for other threads after BURST late blocks
LATE_MAX_S = 2.0  # largest lateness that jobs make up for; a larger one shifts all jobs


class PacedJob(Protocol):
    """A job that runs block by block. error: the error that ended the job, or None."""

    error: Exception | None

    @property
    def due_s(self) -> float:
        """Time of the next block, in seconds from the job's start."""

    def run(self, now_s: float) -> bool:
        """Process the next block; return False after the last block."""


class FrameTime:
    """Duration of all added frames. Only one thread at a time may use an instance."""

    def __init__(self) -> None:
        self._duration_s = Fraction()

    def after(self, frames: int, samplerate: int) -> float:
        """Return the duration in seconds after `frames` more frames at `samplerate` Hz."""
        return float(self._duration_s + Fraction(frames, samplerate))

    def add(self, frames: int, samplerate: int) -> None:
        """Add `frames` frames at `samplerate` Hz."""
        self._duration_s += Fraction(frames, samplerate)


class Pacer:
    """Runs jobs at their due times, earliest first, on a thread that the first job starts.

    At most BURST late blocks run without a pause. If a block is late by more than LATE_MAX_S, all
    jobs are shifted by its lateness. An exception in `run` ends only that job. exact: whether `run`
    gets the due time of a block instead of the current time.
    """

    def __init__(self, now_s: Callable[[], float], *, exact: bool = False) -> None:
        self._now_s, self._exact = now_s, exact
        self._jobs: dict[PacedJob, float] = {}  # start time of each job
        self._lock = threading.Lock()
        self._changed = threading.Event()
        self._thread: threading.Thread | None = None
        self._closed = False

    def begin(self, job: PacedJob, now_s: float) -> None:
        """Start or continue a job. Its next block is due at `now_s`."""
        with self._lock:
            self._jobs[job] = now_s - job.due_s
        if self._thread is None and not self._closed:
            # A daemon thread, so that a program can exit without `close`.
            self._thread = threading.Thread(target=self._keep_pace, name="pacer", daemon=True)
            self._thread.start()
        self._changed.set()

    def is_doing(self, job: PacedJob) -> bool:
        """Return whether the job runs."""
        return job in self._jobs

    def end(self, job: PacedJob) -> None:
        """Stop a job. After `end` returns, the job does not run until the next `begin`."""
        with self._lock:
            self._jobs.pop(job, None)

    def close(self) -> None:
        """End the thread. Repeated calls do nothing."""
        self._closed = True
        self._changed.set()
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join()

    def step(self, now_s: float) -> float:
        """Process due blocks, at most BURST; return the seconds until the next step."""
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
                try:
                    goes_on = job.run(due_s if self._exact else now_s)
                except Exception as error:
                    job.error, goes_on = error, False
                if not goes_on:
                    del self._jobs[job]
        return BREATH_S

    def _keep_pace(self) -> None:
        while not self._closed:
            self._changed.wait(min(self.step(self._now_s()), 1.0))
            self._changed.clear()
