"""When the machine itself stood still: no program can play then.

Virtual machines do that for tens of ms. It tells a measurement what is not the fault of what it
measures. One small process for each core sleeps a few ms at a time, before all others where that
is allowed. A moment when none of them woke was one of the machine. Where only one did not, its core
was busy; or, if that process goes before all others, the core itself was taken away for a while,
and with it whatever ran there.
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
LEAST_S = 0.01
"""What counts as a pause. Streams of 256 frames at 48 kHz outlast shorter ones."""
PRIORITY = 60
"""Of SCHED_FIFO, where it is granted: over that of the daemon's own threads."""

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
    """A time when a core, or the machine, ran nothing; seconds of time.monotonic."""

    start_s: float
    end_s: float

    @property
    def seconds(self) -> float:
        """How long it was."""
        return self.end_s - self.start_s


class PauseWitness:
    """Watches all cores that this process may use, from now until `close`. One thread uses it.

    first: whether the watching processes go before all others, so that nobody else delays them.
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
            self.first &= process.stdout.readline() == b"first\n"  # it watches from now on
            os.set_blocking(process.stdout.fileno(), False)
            self._processes.append(process)
            self._seen.append([])
            self._rest.append(b"")

    def close(self) -> None:
        """Stop watching. Again too."""
        self._read()
        for process in self._processes:
            with process:  # closes the pipes and waits
                process.kill()
        self._processes.clear()

    def pauses(self) -> tuple[Pause, ...]:
        """Return when the whole machine stood still, until now, in order; also after the end."""
        self._read()
        return common(self._seen)

    def core_pauses(self) -> tuple[Pause, ...]:
        """Return when at least one core was taken away; `pauses` where that cannot be told."""
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
    """Return when all cores stood still at once; short of LEAST_S by a nap is still counted.

    seen: of each core, in order. Cores notice a pause up to a nap apart.
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
    """Return which of these times are neither within a pause nor up to recovers_s behind one."""
    clear = np.ones(len(times_s), np.bool_)
    for pause in pauses:
        clear &= (times_s < pause.start_s) | (times_s > pause.end_s + recovers_s)
    return clear
