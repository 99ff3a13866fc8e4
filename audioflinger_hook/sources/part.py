"""A tap on a part of another tap's sound."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from audioflinger_hook.sources.tap import SteadyTap
from device.errors import UsageError
from device.units import Float32Array


class PartTap(SteadyTap):
    """A part in time of another tap, and some of its channels.

    tap: the whole sound. start_s, duration_s: beginning and length of the part; None: to the end,
    where every part ends at the latest. picked: channels to take, from 0; none: all. skipped:
    frames at the beginning that the tap has left out. UsageError: the sound ends before the part
    begins, or has no such channel.
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
        """Yield the buffers after some frames, up to a length; None: to the end."""
        while length != 0 and (buffer := self._tap.read()) is not None:
            part = buffer[skipped:] if length is None else buffer[skipped : skipped + length]
            skipped = max(0, skipped - len(buffer))
            if length is not None:
                length -= len(part)
            if len(part):
                yield part[:, self._picked] if self._picked else part
