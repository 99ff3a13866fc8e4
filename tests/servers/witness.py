"""A step of a test, measured where the machine let it be measured.

On a busy machine PipeWire loses cycles of any stream, and a lost cycle is a click. The witness is
a tone that a server of its own plays and records: nothing of the product is near it. A step during
which the witness was torn, too, is made again. Of the others a single one may fail, since a cycle
may be lost on one server alone; so many must be as they should that a click now and then is found.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from device.units import Float32Array, FloatArray
from tests.servers.daemons import FELT, tone
from tests.servers.listening import RATE_HZ, own_server, playing, recording, wait_for

CLICK_DB = -50.0  # loudest click: what is above 250 Hz, against full scale
CLEAN, STRAY = 5, 1
"""Attempts that must be as they should, and that may fail before: a click in every second one is
missed one time in 9, and a cycle that is lost in one of 30 fails one test in 60."""

EXCUSED = 10  # failed attempts with a torn witness after which the machine is too busy to tell
AFTER = RATE_HZ  # frames looked at once a step is in effect: its last fade may begin only then
EARLIER = RATE_HZ // 5  # frames before it that are looked at, too: the filter starts from silence
SETTLED = RATE_HZ // 10  # frames after which the filter's start is over
BLOCK = RATE_HZ // 100  # frames of a block that is felt or not
NEAR = RATE_HZ // 5  # frames between two recordings of one moment, at most

Heard = Callable[[], Float32Array]


@dataclass(frozen=True)
class Found:
    """A measured step: its loudest click, how long nothing was felt, and what else was torn.

    sound_torn: of the product's own server, the played sound; it explains and excuses nothing.
    witness_torn: whether the machine made the witness's server lose a cycle meanwhile.
    """

    click_db: float
    silent_ms: float
    sound_torn: bool
    witness_torn: bool


def above_250_hz(frames: Float32Array) -> FloatArray:
    """What is above 250 Hz, in dB of full scale, without the filter's start."""
    high_pass = butter(8, 250.0, "highpass", fs=RATE_HZ, output="sos")
    rest = sosfilt(high_pass, frames[:, 0].astype(np.float64))[SETTLED:]
    return np.asarray(20.0 * np.log10(np.abs(rest) + 1e-9))


def silent_blocks(frames: Float32Array) -> NDArray[np.bool_]:
    """Whether each 10 ms are without vibration."""
    blocks = np.abs(frames[: len(frames) // BLOCK * BLOCK]).reshape(-1, BLOCK * 2).max(axis=1)
    return np.asarray(blocks <= FELT)


def tears(frames: Float32Array, felt: Float32Array | None = None) -> int:
    """How many samples of a recorded tone are torn.

    felt: where it is silent, tears do not count. A chain leaves the graph while nothing is felt,
    and that may tear other streams.
    """
    torn = above_250_hz(frames) > CLICK_DB
    if felt is not None and (silent := silent_blocks(felt)).any():
        near = np.convolve(np.repeat(silent, BLOCK), np.ones(2 * NEAR), "same") > 0.5
        near = np.pad(near[SETTLED:], (0, max(0, len(torn) - len(near) + SETTLED)))
        torn &= ~near[: len(torn)]
    return int(np.count_nonzero(torn))


@contextmanager
def witness_tone(folder: Path, quantum: int = 0) -> Iterator[Heard]:
    """A tone that a server of its own plays and a recorder hears: nothing of ours is near it.

    quantum: its cycle in frames; 0 for what the programs ask for. Short cycles are lost more often.
    """
    with own_server() as server:
        server.set_clock("force-quantum", quantum)
        with (
            playing(server, "desktop", tone(110.0, 240.0), name="witness"),
            recording(server, "desktop.monitor", folder / "witness") as heard,
        ):
            yield heard


def measure(heard: Sequence[Heard], before: Callable[[], None], act: Callable[[], None]) -> Found:
    """Make a step, and look at it for two seconds or more; at the witnesses also before it.

    heard: what is felt, the played sound, the witness. before: leads to the step.
    """
    first = [len(one()) for one in heard]
    before()
    _wait_for_frames(heard[0], len(heard[0]()) + 2 * RATE_HZ)
    starts = [max(0, len(one()) - EARLIER) for one in heard]
    act()
    for one, start, end in zip(heard, starts, [len(one()) + AFTER for one in heard], strict=True):
        _wait_for_frames(one, max(start + EARLIER + 2 * RATE_HZ, end))
    felt, sound, witness = (one() for one in heard)
    step = felt[starts[0] :]
    return Found(
        float(above_250_hz(step).max()),
        10.0 * float(silent_blocks(step[EARLIER:]).sum()),
        tears(sound[first[1] :], felt[first[0] :]) > 0,
        tears(witness[first[2] :]) > 0,
    )


class Verdict:
    """Counts attempts at something until enough succeeded or the machine is too busy.

    what: of the step, for messages. needed: attempts that must succeed. stray: that may fail.
    """

    def __init__(self, what: str, needed: int = CLEAN, stray: int = STRAY) -> None:
        self._what, self._needed, self._allowed = what, needed, stray
        self._clean = self._stray = 0
        self._excused: list[object] = []

    def add(self, attempt: object, *, good: bool, witness_torn: bool) -> bool:
        """Count an attempt; return whether it is shown.

        A second failed attempt fails the test. Those with a torn witness do not count, but many of
        them skip it.
        """
        if good:
            self._clean += 1
            return self._clean == self._needed
        self._stray += not witness_torn
        assert self._stray <= self._allowed, (
            f"{self._what}, after {self._clean} clean attempts: {attempt}"
        )
        if not witness_torn:
            return False
        self._excused.append(attempt)
        if len(self._excused) == EXCUSED:
            pytest.skip(f"{self._what}: too busy, the witness was torn each time: {self._excused}")
        return False


def check_step(daemon, config, texts, heard, settle, silent_ms) -> None:
    """A change of the config never clicks nor lets the vibration end for longer than silent_ms.

    texts: the config before and after. heard: what is felt, the played sound, the witness.
    settle: waits until the config before (0) or after (1) is in effect.
    """

    def put(which: int) -> None:
        daemon.reload(config, texts[which])
        settle(which)

    verdict, shown = Verdict(repr(texts[1])), False
    while not shown:
        found = measure(heard, lambda: put(0), lambda: put(1))
        print(f"{texts[1]!r}: {found}")
        good = found.click_db < CLICK_DB and found.silent_ms <= silent_ms
        shown = verdict.add(found, good=good, witness_torn=found.witness_torn)


def _wait_for_frames(heard: Heard, frames: int) -> None:
    wait_for(lambda: len(heard()) >= frames, "two seconds", 20.0)
