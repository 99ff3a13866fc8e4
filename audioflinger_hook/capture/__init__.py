"""Captures: recorded audio buffers, stored unchanged for bit-exact replay.

    audio thread -> recorder -> writer -> folder -> reader -> sources/file
                    queue+thread segment   format    segment

The module `format` describes the files.
"""

from audioflinger_hook.capture.format import STREAMS
from audioflinger_hook.capture.reader import Capture
from audioflinger_hook.capture.recorder import CaptureRecorder
from audioflinger_hook.capture.segment import CaptureBuffer
from audioflinger_hook.capture.writer import CaptureWriter

__all__ = ["STREAMS", "Capture", "CaptureBuffer", "CaptureRecorder", "CaptureWriter"]
