"""A tap on a capture."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.capture import Capture, CaptureBuffer
from audioflinger_hook.transform.parameters import check_format
from device.errors import UsageError


class CaptureTap:
    """The sound of a capture, buffer by buffer as it was delivered, with every change of format.

    `samplerate` and `channels` are those of the buffer that `read` returned last; before the first,
    those that it will have. `format_changed`: that buffer has another format than the one before
    it. `discontinuity`: frames are missing before it. `time_s`: when it was delivered, in seconds
    of the recorder's monotonic clock. Read by the thread that steps the chain; reads from disk.

    Raises
    ------
    UsageError
        The folder is not a capture that can be read, holds no frame of sound, or, here or in
        `read`, has a rate or a channel count that the transform does not take.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._capture = Capture(folder)
        self._buffers = self._capture.buffers("tap")
        self._next: CaptureBuffer | None = next(self._buffers, None)
        self._frames_expected = self._capture.frames_expected("tap")
        if self._next is None or not self._frames_expected:
            self.close()
            why = "".join(f" ({text})" for text in self.warnings)
            raise UsageError(
                f"{folder} holds no sound (0 frames){why}; give a capture with sound in it"
            )
        self.samplerate, self.channels = self._next.format
        self._check_format()
        self.format_changed = False
        self.discontinuity = self._next.discontinuity
        self.time_s = self._next.time_s

    @property
    def warnings(self) -> list[str]:
        """What a user should know, one line each; complete once `read` has returned None."""
        return self._capture.warnings

    @property
    def facts(self) -> Mapping[str, str | int | float | bool]:
        """What the capture's maker said about it, by name."""
        return self._capture.facts

    @property
    def frames_expected(self) -> int:
        """The frames that the capture's WAV files hold."""
        return self._frames_expected

    def read(self) -> NDArray[np.float32] | None:
        """Return the next buffer, or None at the end."""
        buffer = self._next or next(self._buffers, None)
        self._next = None
        if buffer is None:
            return None
        self.format_changed = buffer.format != (self.samplerate, self.channels)
        self.discontinuity = buffer.discontinuity
        self.time_s = buffer.time_s
        if self.format_changed:
            self.samplerate, self.channels = buffer.format
            self._check_format()
        return buffer.frames

    def close(self) -> None:
        """Let go of the capture."""
        self._next = None
        self._buffers.close()

    def _check_format(self) -> None:
        try:
            check_format(self.samplerate, self.channels)
        except UsageError as error:
            self.close()
            raise UsageError(f"{self.folder}: {error}") from None
