"""Interfaces of taps and clients, a base class of taps, and a tap for a part of another tap."""

from collections.abc import Iterator, Sequence
from typing import Protocol

from audioflinger_hook.mixer import Mixer
from device.errors import CushionError, UsageError
from device.units import Float32Array


class Tap(Protocol):
    """A source of sound that delivers buffers. Only the thread of the pipeline calls methods."""

    samplerate: int  # Hz, of the last buffer; before the first `read`, of the first buffer
    channels: int
    format_changed: bool  # whether the format changed with the last buffer
    discontinuity: bool  # whether frames are missing before the last buffer

    @property
    def frames_expected(self) -> int | None:
        """Total number of frames for a progress display, None if unknown."""

    def read(self) -> Float32Array | None:
        """Return the next buffer, (frames, channels), or None at the end."""

    def close(self) -> None:
        """Close the source. A second call has no effect."""


class Client(Protocol):
    """Writes sound to tracks of one mixer, and determines the length of each cycle."""

    samplerate: int  # Hz, recommended for the mix
    channels: int

    @property
    def frames_expected(self) -> int | None:
        """Total number of frames of the mix for a progress display, None if unknown."""

    def connect(self, mixer: Mixer) -> None:
        """Create the client's tracks. Called once, before the first `play`."""

    def play(self) -> int | None:
        """Write one cycle. Return its length in frames; 0: no sound has arrived; None: the end."""

    def close(self) -> None:
        """Close the source. A second call has no effect."""


class SteadyTap:
    """A tap of constant format without discontinuities.

    The constructor reads the first buffer, because a file's header may be wrong.

    buffers: the sound; each buffer is (frames, channels).
    warnings: lines for the user, complete at the end of the sound.
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
        """Close the source. A second call has no effect."""


class PartTap(SteadyTap):
    """A section of another tap's sound, with all or some of its channels.

    start_s: start of the section in seconds. duration_s: length of the section in seconds, or None
    for the rest. picked: channel numbers from 0; empty for all channels. skipped: number of frames
    at the start of the sound that `tap` has already omitted. UsageError: the sound ends before the
    section starts, or has no such channel.
    """

    def __init__(
        self,
        tap: SteadyTap,
        start_s: float,
        duration_s: float | None,
        picked: Sequence[int],
        skipped: int,
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
        """Close `tap`."""
        self._tap.close()

    def _cut(self, skipped: int, length: int | None) -> Iterator[Float32Array]:
        while length != 0 and (buffer := self._tap.read()) is not None:
            part = buffer[skipped:] if length is None else buffer[skipped : skipped + length]
            skipped = max(0, skipped - len(buffer))
            if length is not None:
                length -= len(part)
            if len(part):
                yield part[:, self._picked] if self._picked else part


def named(error: CushionError, source: object) -> CushionError:
    """Return the error with the name of the source in the message."""
    return error if str(source) in str(error) else type(error)(f"{source}: {error}")


def reason_of(error: Exception) -> str:
    """Return the text of a library's error, without an error code."""
    text = getattr(error, "error_string", None) or getattr(error, "strerror", None) or str(error)
    return str(text).strip().rstrip(".") or type(error).__name__
