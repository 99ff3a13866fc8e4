"""Detects pauses of the whole machine, in which no program runs.

A virtual machine may pause, which is not a fault of the measured program. On each core, a small
process sleeps for 4 ms again and again, with real-time priority if allowed. If all these processes
wake up late, the machine was paused. If only some of them wake up late, other programs used their
cores. With real-time priority, only the host of the virtual machine can have used these cores.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from audioflinger_hook.transform import FloatArray

NAP_S = 0.004
LEAST_S = 0.01  # shortest pause in s
PRIORITY = 60  # SCHED_FIFO priority if allowed, above that of the daemon's threads
_WITNESS = """
import os, select, signal, sys, time
signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever started it ends it
core, nap_s, least_s, priority = int(sys.argv[1]), *map(float, sys.argv[2:])
os.sched_setaffinity(0, {core})
try:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(int(priority)))
    print("first", flush=True)
except OSError:
    print("equal", flush=True)
before_s = time.monotonic()
while not select.select([0], [], [], nap_s)[0]:  # closed once its parent is gone
    now_s = time.monotonic()
    if now_s - before_s >= least_s:
        print(before_s, now_s, flush=True)
    before_s = time.monotonic()
"""


@dataclass(frozen=True)
class Pause:
    """A time in which a core or the whole machine ran no program.

    start_s, end_s: times in s of time.monotonic.
    """

    start_s: float
    end_s: float

    @property
    def seconds(self) -> float:
        """The duration of the pause in s."""
        return self.end_s - self.start_s


class PauseWitness:
    """Watches all cores available to this process for pauses, until `close`.

    Only one thread may use it.

    first: whether the watching processes have a real-time priority above that of the daemon.
    """

    def __init__(self) -> None:
        self.first = True
        self._seen: list[list[Pause]] = []
        self._rest: list[bytes] = []
        self._processes: list[subprocess.Popen[bytes]] = []
        for core in sorted(os.sched_getaffinity(0)):
            figures = (str(core), str(NAP_S), str(LEAST_S), str(PRIORITY))
            process = subprocess.Popen(
                [sys.executable, "-S", "-E", "-c", _WITNESS, *figures],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
            assert process.stdout is not None
            self.first &= process.stdout.readline() == b"first\n"  # watching has started
            os.set_blocking(process.stdout.fileno(), False)
            self._processes.append(process)
            self._seen.append([])
            self._rest.append(b"")

    def close(self) -> None:
        """Stop watching. Further calls have no effect."""
        self._read()
        for process in self._processes:
            with process:  # closes the pipes and waits
                process.kill()
        self._processes.clear()

    def pauses(self) -> tuple[Pause, ...]:
        """Return the pauses of the whole machine until now, or until `close`, in order."""
        self._read()
        return common(self._seen)

    def core_pauses(self) -> tuple[Pause, ...]:
        """Return the pauses of single cores; without real-time priority, those of the machine."""
        if not self.first:
            return self.pauses()
        self._read()
        return tuple(sorted((one for seen in self._seen for one in seen), key=_start))

    def _read(self) -> None:
        for core, process in enumerate(self._processes):
            assert process.stdout is not None
            *lines, self._rest[core] = (self._rest[core] + (process.stdout.read() or b"")).split(
                b"\n"
            )
            self._seen[core] += [Pause(*map(float, line.split())) for line in lines]


def _start(pause: Pause) -> float:
    return pause.start_s


def common(seen: Sequence[Sequence[Pause]]) -> tuple[Pause, ...]:
    """Return the times in which all cores paused together for at least 6 ms.

    Cores notice the start of the same pause up to 4 ms apart. Therefore 6 ms suffice, although each
    core reports only pauses of 10 ms or more.

    seen: pauses of each core, in order.
    """
    if not seen:
        return ()
    still: Sequence[Pause] = seen[0]
    for other in seen[1:]:
        still = [
            Pause(max(one.start_s, two.start_s), min(one.end_s, two.end_s))
            for one in still
            for two in other
            if min(one.end_s, two.end_s) - max(one.start_s, two.start_s) >= LEAST_S - NAP_S
        ]
    return tuple(still)


def undisturbed(
    times_s: FloatArray, pauses: Iterable[Pause], recovers_s: float
) -> npt.NDArray[np.bool_]:
    """Return for each time whether it is neither in a pause nor within `recovers_s` after one."""
    clear = np.ones(len(times_s), np.bool_)
    for pause in pauses:
        clear &= (times_s < pause.start_s) | (times_s > pause.end_s + recovers_s)
    return clear
