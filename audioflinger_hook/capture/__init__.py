"""Captures: PCM buffers kept exactly as they were delivered, to be played again bit for bit.

    audio thread -> recorder.py -> writer.py -> folder -> reader.py -> taps/capture.py
                    queue+thread   segment.py  format.py  segment.py

What lies in the folder is described in format.py; rebuild.py reads one that lost its index.
Times come in as arguments: nothing here reads a clock.
"""

from audioflinger_hook.capture.buffer import CaptureBuffer
from audioflinger_hook.capture.format import STREAMS
from audioflinger_hook.capture.reader import Capture
from audioflinger_hook.capture.recorder import CaptureRecorder
from audioflinger_hook.capture.writer import CaptureWriter

__all__ = ["STREAMS", "Capture", "CaptureBuffer", "CaptureRecorder", "CaptureWriter"]
