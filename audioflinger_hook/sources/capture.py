"""A tap on a capture."""

from __future__ import annotations

from pathlib import Path

from audioflinger_hook.capture import Capture, CaptureBuffer
from audioflinger_hook.sources.tap import named
from audioflinger_hook.transform.parameters import check_format
from device.errors import UsageError
from device.units import Float32Array


class CaptureTap:
    """The sound of a capture, buffer by buffer as delivered, with every change of format.

    A `Tap`, for the thread that steps the pipeline; reads are from disk.

    folder: the capture.
    time_s: delivery of the buffer read last, in seconds of the recorder's monotonic clock.
    warnings: for the user, one line each; complete once `read` has returned None.
    facts: settings that the recorder stored, by name.
    frames_expected: total frames in the capture's WAV files.
    UsageError: the folder is no readable capture or has no sound. `read` raises it, too, if the
        transform does not support the rate or channel count.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._capture = Capture(folder)
        self._buffers = self._capture.buffers("tap")
        self._next: CaptureBuffer | None = next(self._buffers, None)
        self.warnings = self._capture.warnings
        self.facts = self._capture.facts
        self.frames_expected = self._capture.frames_expected("tap")
        if self._next is None or not self.frames_expected:
            self.close()
            why = "".join(f" ({text})" for text in self.warnings)
            raise UsageError(
                f"{folder} has no sound (0 frames){why}; give a capture with sound in it"
            )
        self.samplerate, self.channels = self._next.format
        self._check_format()
        self.format_changed = False
        self.discontinuity = self._next.discontinuity
        self.time_s = self._next.time_s

    def read(self) -> Float32Array | None:
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
        """Close the capture."""
        self._next = None
        self._buffers.close()

    def _check_format(self) -> None:
        try:
            check_format(self.samplerate, self.channels)
        except UsageError as error:
            self.close()
            raise named(error, self.folder) from None
