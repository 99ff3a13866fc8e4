"""A tap on a part of another tap's sound."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.sources.tap import Tap
from device.errors import UsageError


class PartTap:
    """A part in time of another tap, and some of its channels.

    Parameters
    ----------
    tap : Tap
        The whole sound. Its format must not change.
    start_s, duration_s : float
        Where the part begins, and how long it is. None: to the end. A part that would go on after
        the end of the sound ends there.
    picked : sequence of int
        Channels to take, counted from 0; none: all.
    skipped : int
        Frames at the beginning of the sound that the tap has left out.

    Attributes
    ----------
    warnings : list of str
        Warnings about the sound; the caller may set another list.

    Raises
    ------
    UsageError
        The sound ends before the part begins, or has no such channel.
    """

    format_changed = False
    discontinuity = False

    def __init__(
        self,
        tap: Tap,
        start_s: float = 0.0,
        duration_s: float | None = None,
        picked: Sequence[int] = (),
        skipped: int = 0,
    ) -> None:
        self._tap = tap
        self.warnings: list[str] = []
        self.samplerate = tap.samplerate
        if picked and max(picked) >= tap.channels:
            raise UsageError(
                f"channel {max(picked)} is not in the sound; allowed: 0 to {tap.channels - 1}"
            )
        self._picked = list(picked)
        self.channels = len(picked) or tap.channels
        first = round(start_s * tap.samplerate)
        whole = tap.frames_expected
        left = None if whole is None else max(0, whole - first)
        self._left = None if duration_s is None else max(1, round(duration_s * tap.samplerate))
        known = [frames for frames in (left, self._left) if frames is not None]
        self.frames_expected = min(known) if known else None
        self._next = self._begin(first - skipped)
        if self._next is None:
            raise UsageError(f"start_s={start_s:g} is not in the sound, which ends before")

    def read(self) -> NDArray[np.float32] | None:
        """Return the next buffer, or None at the end of the part."""
        buffer = self._next
        if buffer is None:
            return None
        if self._left is None:
            self._next = self._tap.read()
        else:
            buffer = buffer[: self._left]
            self._left -= len(buffer)
            self._next = self._tap.read() if self._left else None
        return buffer[:, self._picked] if self._picked else buffer

    def close(self) -> None:
        """Close the whole sound."""
        self._tap.close()

    def _begin(self, skipped: int) -> NDArray[np.float32] | None:
        """Return the first buffer, from the frame on with which the part begins."""
        while (buffer := self._tap.read()) is not None:
            if skipped < len(buffer):
                return buffer[skipped:]
            skipped -= len(buffer)
        return None
