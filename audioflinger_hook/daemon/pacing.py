"""One thread that does what no device asks for: files played, and files written, in real time."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol

BURST = 64
"""So many blocks may be made up for in a row; then other threads have their turn."""

BREATH_S = 0.001
"""How long that turn is."""

LATE_MAX_S = 2.0
"""What is later than this is not made up for: the time that passed was a pause."""


class PacedJob(Protocol):
    """Something to be done block by block. error: what ended it, None for nothing."""

    error: Exception | None

    @property
    def due_s(self) -> float:
        """When the next block is due, in seconds from the job's start: a count over a rate."""
        ...

    def run(self, now_s: float) -> bool:
        """Do the next block; False if it was the last."""
        ...


class FrameTime:
    """Seconds that frames last, from a count: a sum of lengths would drift. samplerate: Hz."""

    def __init__(self, samplerate: int) -> None:
        self._before_s = 0.0
        self._frames = 0
        self._samplerate = samplerate

    def after(self, frames: int, samplerate: int) -> float:
        """Return how long all frames so far last, with so many more of that rate, Hz."""
        if samplerate != self._samplerate:
            return self._before_s + self._frames / self._samplerate + frames / samplerate
        return self._before_s + (self._frames + frames) / samplerate

    def add(self, frames: int, samplerate: int) -> None:
        """Count frames of that rate, Hz."""
        if samplerate != self._samplerate:
            self._before_s += self._frames / self._samplerate
            self._frames, self._samplerate = 0, samplerate
        self._frames += frames


class Pacer:
    """Does jobs at their due times, the earliest first, so that jobs stay in step with each other.

    Due times are absolute: nothing drifts. After a stall blocks are made up for, in bursts; after
    a longer one all jobs are shifted alike. now_s: the clock. exact: tell jobs their due times
    instead of the time that it is: for jobs that only deal with each other, where nothing is late.

    The supervising thread begins and ends jobs; the thread that does them is made with the first.
    What a job raises ends it and stays in its `error`.
    """

    def __init__(self, now_s: Callable[[], float], *, exact: bool = False) -> None:
        self._now_s = now_s
        self._exact = exact
        self._jobs: dict[PacedJob, float] = {}  # and when each began
        self._lock = threading.Lock()
        self._changed = threading.Event()
        self._thread: threading.Thread | None = None
        self._closed = False

    def begin(self, job: PacedJob, now_s: float) -> None:
        """Do this job from now on: what is due by its own count is due now."""
        with self._lock:
            self._jobs[job] = now_s - job.due_s
        if self._thread is None and not self._closed:
            # A daemon: a program that fails before `close` must be able to end.
            self._thread = threading.Thread(target=self._keep_pace, name="pacer", daemon=True)
            self._thread.start()
        self._changed.set()

    def is_doing(self, job: PacedJob) -> bool:
        """Whether the job has begun and neither ended nor been ended."""
        return job in self._jobs

    def end(self, job: PacedJob) -> None:
        """Do it no more. Once this returns it does not run; it can be begun again later."""
        with self._lock:
            self._jobs.pop(job, None)

    def close(self) -> None:
        """End the thread. Again too."""
        self._closed = True
        self._changed.set()
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join()

    def step(self, now_s: float) -> float:
        """Do what is due at now_s, a burst at most, and return how long nothing else is; s."""
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
            job.error = error
            goes_on = False
        if not goes_on:
            del self._jobs[job]

    def _keep_pace(self) -> None:
        while not self._closed:
            wait_s = self.step(self._now_s())
            self._changed.wait(min(wait_s, 1.0))
            self._changed.clear()
