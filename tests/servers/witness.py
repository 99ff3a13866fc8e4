"""A step of a test, measured where the machine let it be measured.

On a busy machine PipeWire loses cycles of any stream, and a lost cycle is a click. Witnesses are
recordings that the vibration does not pass. A step that fails is made again: often where one of
them is torn, and twice where none is. The product is near one of them, the played sound: so in the
end only the bare server's sound tells a busy machine from a product that tears both.
"""

from __future__ import annotations

import signal
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from device.units import Float32Array, FloatArray
from tests.servers.daemons import FELT, Daemon, tone
from tests.servers.listening import RATE_HZ, playing, recording, wait_for
from tools.sound_server import SoundServer

CLICK_DB = -50.0
"""Loudest click: what is above 250 Hz, against full scale."""

ATTEMPTS = 10
"""How often a step is made until it is as it must be."""

UNEXCUSED = 3
"""Failed attempts that no witness excuses, and that end it: a witness does not see every pause."""

BUSY = 3
"""Failed attempts with a torn bare server; with fewer, a test whose attempts all failed fails."""

AFTER = RATE_HZ
"""Frames that are looked at once a step is in effect: its last fade may begin only then."""

EARLIER = RATE_HZ // 5
"""Frames before a step that are looked at, too: the filter starts from silence."""

SETTLED = RATE_HZ // 10
"""Frames after which the filter's start is over."""

BLOCK = RATE_HZ // 100
"""Frames of a block that is felt or not."""

NEAR = RATE_HZ // 5
"""Frames between two recordings of one moment, at most."""

Heard = Callable[[], Float32Array]


@dataclass(frozen=True)
class Found:
    """A measured step: its loudest click, how long nothing was felt, and which witness was torn."""

    click_db: float
    silent_ms: float
    sound_torn: bool
    bare_torn: bool


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
def bare_sound(folder: Path) -> Iterator[Heard]:
    """A tone that a server of its own plays and a recorder hears: nothing of ours is near it."""
    with (
        tempfile.TemporaryDirectory(prefix="cushion-") as own,
        SoundServer("pipewire", Path(own)) as server,
        playing(server, "desktop", tone(110.0, 240.0), name="bare"),
        recording(server, "desktop.monitor", folder / "bare") as heard,
    ):
        yield heard


def measure(heard: Sequence[Heard], before: Callable[[], None], act: Callable[[], None]) -> Found:
    """Make a step, and look at it for two seconds or more; at the witnesses also before it.

    heard: what is felt, the played sound, a bare server's sound. before: leads to the step.
    """
    first = [len(one()) for one in heard]
    before()
    _wait_for_frames(heard[0], len(heard[0]()) + 2 * RATE_HZ)
    starts = [max(0, len(one()) - EARLIER) for one in heard]
    act()
    done = [len(one()) + AFTER for one in heard]
    for one, start, end in zip(heard, starts, done, strict=True):
        _wait_for_frames(one, max(start + EARLIER + 2 * RATE_HZ, end))
    felt, sound, bare = (one() for one in heard)
    step = felt[starts[0] :]
    return Found(
        float(above_250_hz(step).max()),
        10.0 * float(silent_blocks(step[EARLIER:]).sum()),
        tears(sound[first[1] :], felt[first[0] :]) > 0,
        tears(bare[first[2] :]) > 0,
    )


def give_up(what: str, attempts: Sequence[object], bare_torn: int) -> NoReturn:
    """End a test whose attempts all failed: skip it only on a machine that tears a bare server."""
    figures = f"{what}: a bare server's sound was torn {bare_torn} times: {attempts}"
    assert bare_torn >= BUSY, figures
    pytest.skip(figures)


def check_step(
    daemon: Daemon,
    config: Path,
    texts: tuple[str, str],
    heard: Sequence[Heard],
    settle: Callable[[int], None],
    silent_ms: float,
) -> None:
    """A change of the config neither clicks nor lets the vibration end for longer than silent_ms.

    texts: the config before and after. heard: what is felt, the played sound, a bare server's.
    settle: waits until the config before (0) or after (1) is in effect.
    """

    def put(which: int) -> None:
        config.write_text(texts[which])
        daemon.process.send_signal(signal.SIGHUP)
        settle(which)

    attempts: list[Found] = []
    for _ in range(ATTEMPTS):
        found = measure(heard, lambda: put(0), lambda: put(1))
        print(f"{texts[1]!r}: {found}")
        if found.click_db < CLICK_DB and found.silent_ms <= silent_ms:
            return
        attempts.append(found)
        unexcused = [one for one in attempts if not (one.sound_torn or one.bare_torn)]
        assert len(unexcused) < UNEXCUSED, f"{texts[1]!r}: {unexcused}"
    give_up(repr(texts[1]), attempts, sum(one.bare_torn for one in attempts))


def _wait_for_frames(heard: Heard, frames: int) -> None:
    wait_for(lambda: len(heard()) >= frames, "two seconds", 20.0)
