"""Taps, which deliver sound: interface, base class, part; and the interface of clients."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

from audioflinger_hook.mixer import Mixer
from device.errors import CushionError, UsageError
from device.units import Float32Array


class Tap(Protocol):
    """A source of sound: buffers in order, until it ends."""

    samplerate: int  # Hz, of the buffer read last; before the first buffer, of the first
    channels: int
    format_changed: bool  # whether this format differs from the one before
    discontinuity: bool  # whether frames are missing before the buffer read last

    @property
    def frames_expected(self) -> int | None:
        """Total number of frames, if known; only for showing progress."""

    def read(self) -> Float32Array | None:
        """Return the next buffer, (frames, channels) float32, or None when the sound has ended.

        Called by the thread that steps the chain.
        """

    def close(self) -> None:
        """Let go of the source. May be called more than once."""


class Client(Protocol):
    """Fills tracks of one mixer and paces its cycles. Use from the thread that steps the chain."""

    samplerate: int  # Hz, of a mix that suits the client's sound
    channels: int

    @property
    def frames_expected(self) -> int | None:
        """Total frames of the mix, if known; only for showing progress."""

    def connect(self, mixer: Mixer) -> None:
        """Make the client's tracks. Called once, before the first `play`."""

    def play(self) -> int | None:
        """Write the sound of the next cycle and return its frames; 0: none yet, None: the end."""

    def close(self) -> None:
        """Let go of the source. May be called more than once."""


class SteadyTap:
    """A tap of one format without discontinuities.

    The first buffer is taken at once, because a header may promise frames that are missing.
    buffers: (frames, channels) each. warnings: for the user, one line each; complete at the end.
    """

    format_changed = False
    discontinuity = False

    def __init__(
        self,
        samplerate: int,
        channels: int,
        buffers: Iterator[Float32Array],
        frames_expected: int | None,
    ) -> None:
        self.samplerate, self.channels = samplerate, channels
        self.frames_expected = frames_expected
        self.warnings: list[str] = []
        self._buffers = buffers
        self._next = next(buffers, None)

    def read(self) -> Float32Array | None:
        """Return the next buffer, or None at the end."""
        buffer, self._next = self._next, next(self._buffers, None)
        return buffer

    def close(self) -> None:
        """Let go of the source. May be called more than once."""


class PartTap(SteadyTap):
    """A part in time of another tap, and some of its channels.

    start_s, duration_s: beginning and length of the part; None: to the end. picked: channels to
    take, from 0; none: all. skipped: frames at the beginning that the tap has left out. UsageError:
    the sound ends before the part begins, or has no such channel.
    """

    def __init__(
        self,
        tap: SteadyTap,
        start_s: float = 0.0,
        duration_s: float | None = None,
        picked: Sequence[int] = (),
        skipped: int = 0,
    ) -> None:
        self._tap = tap
        self._picked = list(picked)
        rate, whole = tap.samplerate, tap.frames_expected
        if picked and max(picked) >= tap.channels:
            raise UsageError(
                f"channel {max(picked)} is not in the sound; allowed: 0 to {tap.channels - 1}"
            )
        first = round(start_s * rate)
        length = None if duration_s is None else max(1, round(duration_s * rate))
        left = None if whole is None else max(0, whole - first)
        known = [frames for frames in (left, length) if frames is not None]
        buffers = self._cut(first - skipped, length)
        super().__init__(rate, len(picked) or tap.channels, buffers, min(known, default=None))
        self.warnings = tap.warnings
        if self._next is None:
            raise UsageError(f"start_s={start_s:g} is not in the sound, which ends before")

    def close(self) -> None:
        """Close the whole sound."""
        self._tap.close()

    def _cut(self, skipped: int, length: int | None) -> Iterator[Float32Array]:
        """Yield the buffers after some frames, up to a length."""
        while length != 0 and (buffer := self._tap.read()) is not None:
            part = buffer[skipped:] if length is None else buffer[skipped : skipped + length]
            skipped = max(0, skipped - len(buffer))
            if length is not None:
                length -= len(part)
            if len(part):
                yield part[:, self._picked] if self._picked else part


def named(error: CushionError, source: object) -> CushionError:
    """Return the error with the name of its source, if it lacks it."""
    return error if str(source) in str(error) else type(error)(f"{source}: {error}")


def reason_of(error: Exception) -> str:
    """Return the reason that a library gives for an error, without its code."""
    text = getattr(error, "error_string", None) or getattr(error, "strerror", None) or str(error)
    return str(text).strip().rstrip(".") or type(error).__name__
