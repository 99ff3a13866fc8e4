"""Captures: PCM buffers stored as delivered, for replay bit for bit.

    audio thread -> recorder.py -> writer.py -> folder -> reader.py -> taps/capture.py
                    queue+thread   segment.py  format.py  segment.py

format.py describes the folder's files; rebuild.py reads a folder without its index. Times are
arguments.
"""

from audioflinger_hook.capture.buffer import CaptureBuffer
from audioflinger_hook.capture.format import STREAMS
from audioflinger_hook.capture.reader import Capture
from audioflinger_hook.capture.recorder import CaptureRecorder
from audioflinger_hook.capture.writer import CaptureWriter

__all__ = ["STREAMS", "Capture", "CaptureBuffer", "CaptureRecorder", "CaptureWriter"]
