"""One effect in a chain: lets its engine process buffers, and bypasses a failing engine."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from audioflinger_hook.effect.control import (
    EffectControl,
    EffectState,
    answer_text,
    error_text,
    is_status,
    place_text,
)
from audioflinger_hook.effect.interface import ENODATA, OK, Access, EffectConfig, EffectEngine
from audioflinger_hook.mixer.mix_buffer import MixBuffer
from device.blocks import peak
from device.units import Float32Array

LATE_IN_A_ROW = 3  # an engine is bypassed after this many consecutive overruns

BLOCKED_S, BLOCKED_LOOKS = 0.4, 4
"""An effect is bypassed if one call lasts BLOCKED_S seconds and BLOCKED_LOOKS checks. With the time
limit alone, an effect would be bypassed after the process was suspended."""

ALWAYS_LOOKS = 30  # an effect is bypassed if this many checks in a row find it in `process`
APART_S = 0.05  # shortest interval between two checks that count separately

PROCESSING = (EffectState.ACTIVE, EffectState.STOPPING, EffectState.STOPPED, EffectState.RESTART)


class EffectModule(EffectControl):
    """Lets one engine process the mixer's buffers.

    The engine processes copies of the buffers, and only valid results are copied back. An engine is
    bypassed if it raises an exception, returns an invalid answer, makes non-finite samples,
    replaces a buffer's arrays or is too slow. A bypassed engine does not change the sound.

    budget_s: allowed processing time of a full buffer in seconds, measured by `clock`.
    inside: whether the engine's `process` runs now.
    misfits: number of buffers whose layout differs from the configuration.
    """

    def __init__(
        self, engine: EffectEngine, *, session: int, clock: Callable[[], float], budget_s: float
    ) -> None:
        self.budget_s = budget_s
        self.misfits = self.buffers = self.overruns = self.calls = 0
        self.inside = False
        self.worst_s = 0.0
        self._clock = clock
        self._late = 0
        self._lent = self._mixed = Loan(0)
        super().__init__(engine, session)

    def process(self, source: MixBuffer, target: MixBuffer) -> None:
        """Process a buffer in place if `source` is `target`, else add the result to `target`.

        If the effect does not run, the result equals `source`. Call this once per cycle.
        """
        in_place = source is target
        if not in_place and not same_layout(source, target):
            self.misfits += 1
            return
        if self.state in PROCESSING and self._ready(source, in_place):
            status = self._run(source, target)
            if status == ENODATA and self.state is EffectState.STOPPED:
                self._tail_buffers = 1
            if status is not None:
                return
        if not in_place:
            np.add(target.samples, source.samples, out=target.samples)

    def _ready(self, source: MixBuffer, in_place: bool) -> bool:
        """Return whether the engine is configured for the buffer and is not bypassed."""
        if self.config is None or not self._accepted or self.bypassed:
            return False
        access = Access.WRITE if in_place else Access.ACCUMULATE
        if access is not self.access:
            self.access = access
            if self.set_config(self.config) != OK:
                return False
        config, frames = self.config, source.frames
        shapes = (frames, config.channels), (frames, config.haptic_channels)
        fits = (source.audio.shape, source.haptic.shape) == shapes and 1 <= frames <= config.frames
        self.misfits += not fits
        return fits

    def _run(self, source: MixBuffer, target: MixBuffer) -> int | None:
        """Run the engine. Return its status, or None after a failure, without changing `target`."""
        lent = self._lent.of(source)
        mixed = lent if source is target else self._mixed.of(target)
        began = self._clock()
        self.calls += 1
        self.inside = True
        try:
            with np.errstate(all="ignore"):
                status: object = self._engine.process(lent, mixed)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            self._blame(f"raised {error_text(error)} in process{place_text(error)}")
            return None
        finally:
            self.inside = False
        if self.given_up:
            self._blame(self.given_up)
            return None
        self._count_time(self._clock() - began, source.frames)
        if not is_status(status) or status not in (OK, ENODATA):
            self._blame(f"answered process with {answer_text(status)}; allowed: OK (0), ENODATA")
            return None
        if not self._lent.is_back(source) or not (mixed is lent or self._mixed.is_back(target)):
            self._blame("exchanged or reshaped its arrays; write into them: target.audio[:] = ...")
            return None
        if _spoiled(mixed, source, target):
            self._blame("made samples that are not finite")
            return None
        np.copyto(target.samples, mixed.samples)
        return OK if status == OK else ENODATA

    def _count_time(self, spent_s: float, frames: int) -> None:
        assert self.config is not None
        self.buffers += 1
        self.worst_s = max(self.worst_s, spent_s)
        if spent_s <= self.budget_s * frames / self.config.frames:
            self._late = 0
            return
        self.overruns += 1
        self._late += 1
        if self._late == LATE_IN_A_ROW:
            self._blame(
                f"took more than the {self.budget_s * 1e3:g} ms allowed for "
                f"{self.config.frames} frames, {LATE_IN_A_ROW} buffers in a row"
            )

    def _make_room(self, config: EffectConfig) -> None:
        size = config.frames * (config.channels + config.haptic_channels)
        self._lent, self._mixed = Loan(size), Loan(size)

    def _forgive(self) -> None:
        super()._forgive()
        self._late = 0


class Loan:
    """Memory for the copy of a buffer; an engine processes the copy."""

    def __init__(self, samples: int) -> None:
        self._memory = np.zeros(samples, np.float32)

    def of(self, buffer: MixBuffer) -> MixBuffer:
        """Copy a buffer into the memory and return the copy."""
        self._lent = MixBuffer.like(buffer, self._memory)
        self._arrays = self._lent.samples, self._lent.audio, self._lent.haptic
        np.copyto(self._lent.samples, buffer.samples)
        return self._lent

    def is_back(self, original: MixBuffer) -> bool:
        """Return whether the engine has neither replaced nor reshaped the arrays of the copy."""
        lent, (samples, audio, haptic) = self._lent, self._arrays
        try:
            same = lent.samples is samples and lent.audio is audio and lent.haptic is haptic
        except AttributeError:
            return False
        return same and same_layout(lent, original)


def same_layout(one: MixBuffer, other: MixBuffer) -> bool:
    """Return whether two buffers have equal shapes and types."""
    pairs = (one.samples, other.samples), (one.audio, other.audio), (one.haptic, other.haptic)
    return all((a.shape, a.dtype) == (b.shape, b.dtype) for a, b in pairs)


def _all_finite(samples: Float32Array) -> bool:
    return math.isfinite(peak(samples))


def _spoiled(made: MixBuffer, source: MixBuffer, target: MixBuffer) -> bool:
    """Return whether an engine made non-finite samples from finite sound or vibration."""
    if _all_finite(made.samples):
        return False
    return any(
        not _all_finite(after) and _all_finite(first) and _all_finite(second)
        for after, first, second in (
            (made.audio, source.audio, target.audio),
            (made.haptic, source.haptic, target.haptic),
        )
    )


@dataclass
class _Found:
    """Successive checks, all of which found the same effect in `process`. Times are in seconds."""

    first_s: float  # first check
    since_s: float  # first check during the present call
    latest_s: float  # latest check
    calls: int
    looks: int = 1  # number of checks
    looks_at_call: int = 1  # number of checks during the present call


class BlockWatch:
    """Bypasses effects that block the audio thread. It runs in another thread."""

    def __init__(self) -> None:
        self._found: dict[int, _Found] = {}

    def look(self, effects: Iterable[EffectModule], now_s: float) -> None:
        """Check all effects at the time `now_s` in seconds; bypass those that block the thread."""
        for effect in effects:
            calls = effect.calls
            if not effect.inside or effect.bypassed:
                self._found.pop(id(effect), None)
                continue
            found = self._found.setdefault(id(effect), _Found(now_s, now_s, now_s, calls))
            if now_s - found.latest_s < APART_S:
                continue
            if calls != found.calls:
                found.calls, found.since_s, found.looks_at_call = calls, now_s, 0
            found.latest_s = now_s
            found.looks += 1
            found.looks_at_call += 1
            if now_s - found.since_s >= BLOCKED_S and found.looks_at_call >= BLOCKED_LOOKS:
                effect.given_up = f"kept the audio thread for over {BLOCKED_S:g} s in process"
            elif found.looks >= ALWAYS_LOOKS:
                effect.given_up = (
                    "kept the audio thread in process at all times in the last "
                    f"{now_s - found.first_s:.0f} s"
                )
