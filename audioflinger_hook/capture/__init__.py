"""Captures: PCM buffers stored as delivered, for a replay that is equal bit for bit.

    audio thread -> recorder -> writer -> folder -> reader -> sources/file
                    queue+thread segment   format    segment

`format` describes the folder's files. Times are arguments; no clock is read.
"""

from audioflinger_hook.capture.format import STREAMS
from audioflinger_hook.capture.reader import Capture
from audioflinger_hook.capture.recorder import CaptureRecorder
from audioflinger_hook.capture.segment import CaptureBuffer
from audioflinger_hook.capture.writer import CaptureWriter

__all__ = ["STREAMS", "Capture", "CaptureBuffer", "CaptureRecorder", "CaptureWriter"]
