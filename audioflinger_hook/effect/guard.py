"""Calls one engine so that it cannot harm the sound or the thread that mixes.

An engine never touches the mixer's buffers. It works on copies, which are taken only if they are
valid, so the sound before it is never lost.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.effect.interface import (
    EINVAL,
    ENODATA,
    ENOSYS,
    OK,
    Command,
    EffectConfig,
    EffectEngine,
)
from audioflinger_hook.mixer.mix_buffer import MixBuffer
from device.blocks import peak

LATE_IN_A_ROW = 3
"""Consecutive buffers over the time allowed, after which an engine counts as too slow."""

READING = frozenset({Command.GET_PARAM, Command.GET_CONFIG, Command.DUMP})
"""Commands whose failure is counted but bypasses nothing, since they change no sound."""

STATUSES = frozenset({OK, EINVAL, ENODATA, ENOSYS})
REASON_MAX = 200
"""Characters kept of what an engine says."""


class GuardedEngine:
    """An engine that may raise, answer nonsense, spoil arrays or take too long.

    All calls come from the thread that steps the mixer. None raises, except KeyboardInterrupt,
    which is the user's.

    Attributes
    ----------
    fault : str
        Why it is bypassed, "" while it is not.
    complaint : str
        The last failure.
    faults : int
        Number of failures.
    budget_s : float
        Seconds of `clock` that a whole buffer may take; a shorter one gets its share.
    overruns : int
        Buffers that took longer.
    worst_s : float
        Longest time that a buffer took.
    """

    def __init__(self, engine: EffectEngine, clock: Callable[[], float], budget_s: float) -> None:
        self._engine = engine
        self._clock = clock
        self.budget_s = budget_s
        self.fault = ""
        self.complaint = ""
        self.faults = 0
        self.overruns = 0
        self.buffers = 0
        self.worst_s = 0.0
        self._late = 0
        self._frames = 1
        self._lent = self._mixed = Loan(0)

    def prepare(self, config: EffectConfig) -> None:
        """Make room for buffers of a configuration."""
        self._frames = config.frames
        size = config.frames * (config.channels + config.haptic_channels)
        self._lent, self._mixed = Loan(size), Loan(size)

    def forgive(self) -> None:
        """Lift the bypass and lend new arrays; the counters continue."""
        self._lent.recall()
        self._mixed.recall()
        self.fault = ""
        self._late = 0

    def blame(self, reason: str, *, bypass: bool = True) -> None:
        """Count a failure, keep its reason and, where asked, bypass the engine."""
        self.faults += 1
        self.complaint = reason
        if bypass and not self.fault:
            self.fault = reason

    def command(self, code: int, data: object = None) -> tuple[int, object]:
        """Return the engine's status and reply; EINVAL and None where it failed."""
        bypass = code not in READING
        name = Command(code).name if code < Command.FIRST_PROPRIETARY else f"command {code:#x}"
        try:
            with np.errstate(all="ignore"):
                answer: object = self._engine.command(code, data)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            self.blame(f"raised {said(error)} in {name}", bypass=bypass)
            return EINVAL, None
        if type(answer) is not tuple or len(answer) != 2 or not is_status(answer[0]):
            self.blame(f"answered {name} with nonsense", bypass=bypass)
            return EINVAL, None
        return answer

    def process(self, source: MixBuffer, target: MixBuffer) -> int | None:
        """Treat one buffer and return OK or ENODATA, or None where `target` is unchanged.

        Both may be the same object, at most as large as the configuration says.
        """
        lent = self._lent.of(source)
        mixed = lent if source is target else self._mixed.of(target)
        began = self._clock()
        try:
            with np.errstate(all="ignore"):
                status: object = self._engine.process(lent, mixed)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            self.blame(f"raised {said(error)} in process")
            return None
        self._count_time(self._clock() - began, source.frames)
        if not is_status(status) or status not in (OK, ENODATA):
            self.blame("answered process with nonsense")
            return None
        if not self._lent.is_back(source) or not (mixed is lent or self._mixed.is_back(target)):
            self.blame("exchanged or reshaped the arrays that it was lent")
            return None
        if self._spoiled(mixed, source, target):
            self.blame("made samples that are not finite")
            return None
        np.copyto(target.samples, mixed.samples)
        return OK if status == OK else ENODATA

    def _count_time(self, spent_s: float, frames: int) -> None:
        self.buffers += 1
        self.worst_s = max(self.worst_s, spent_s)
        if spent_s <= self.budget_s * frames / self._frames:
            self._late = 0
            return
        self.overruns += 1
        self._late += 1
        if self._late == LATE_IN_A_ROW:
            self.blame(
                f"took more than the {self.budget_s * 1e3:g} ms allowed for {self._frames} frames, "
                f"{LATE_IN_A_ROW} buffers in a row"
            )

    def _spoiled(self, made: MixBuffer, source: MixBuffer, target: MixBuffer) -> bool:
        """Return whether the engine made finite sound or vibration non-finite."""
        if all_finite(made.samples):
            return False
        for after, first, second in (
            (made.audio, source.audio, target.audio),
            (made.haptic, source.haptic, target.haptic),
        ):
            if not all_finite(after) and all_finite(first) and all_finite(second):
                return True
        return False


class Loan:
    """A copy of a buffer, lent to an engine, in memory that the next copy uses again.

    samples: of the largest buffer. An engine that keeps its arrays and changes them later harms
    only its own next copy.
    """

    def __init__(self, samples: int) -> None:
        self._storage = np.zeros(samples, np.float32)
        self._own = self._storage[:0]
        self._layout: tuple[tuple[int, ...], tuple[int, ...]] | None = None
        self.recall()

    def of(self, buffer: MixBuffer) -> MixBuffer:
        """Return a copy of a buffer."""
        layout = (buffer.audio.shape, buffer.haptic.shape)
        if layout != self._layout:
            boundary, size = buffer.audio.size, buffer.samples.size
            self._own = self._storage[:size]
            samples = self._storage[:size]
            audio = samples[:boundary].reshape(layout[0])
            haptic = samples[boundary:].reshape(layout[1])
            self._copy = MixBuffer(0, 0)
            self._copy.samples, self._copy.audio, self._copy.haptic = samples, audio, haptic
            self._arrays, self._layout = (samples, audio, haptic), layout
        np.copyto(self._own, buffer.samples)
        return self._copy

    def is_back(self, original: MixBuffer) -> bool:
        """Return whether the copy still has its own arrays in the same layout."""
        lent, (samples, audio, haptic) = self._copy, self._arrays
        try:
            same = lent.samples is samples and lent.audio is audio and lent.haptic is haptic
        except AttributeError:
            same = False
        return same and same_layout(lent, original)

    def recall(self) -> None:
        """Use new arrays for the next copy."""
        self._copy = MixBuffer(0, 0)
        self._arrays = (self._copy.samples, self._copy.audio, self._copy.haptic)
        self._layout = None


def same_layout(one: MixBuffer, other: MixBuffer) -> bool:
    """Return whether two buffers have equal shapes and types."""
    return (
        one.samples.shape == other.samples.shape
        and one.samples.dtype == other.samples.dtype
        and one.audio.shape == other.audio.shape
        and one.audio.dtype == other.audio.dtype
        and one.haptic.shape == other.haptic.shape
        and one.haptic.dtype == other.haptic.dtype
    )


def all_finite(samples: NDArray[np.float32]) -> bool:
    """Return whether all samples are finite."""
    return math.isfinite(peak(samples))


def is_status(answer: object) -> bool:
    """Return whether an engine's answer is one of Android's status codes."""
    return type(answer) is int and answer in STATUSES


def said(error: BaseException) -> str:
    """Return an exception's type and message on one line; never raises."""
    try:
        words = " ".join(str(error).split())[:REASON_MAX]
    except BaseException:
        words = ""
    return f"{type(error).__name__}: {words}".removesuffix(": ")
