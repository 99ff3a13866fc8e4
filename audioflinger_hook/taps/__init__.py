"""Taps: where the sound comes from. Each delivers buffers of frames as they are played."""

from audioflinger_hook.taps.capture import CaptureTap
from audioflinger_hook.taps.file import FileTap
from audioflinger_hook.taps.frames import FramesTap
from audioflinger_hook.taps.push import PushTap
from audioflinger_hook.taps.tap import Tap

__all__ = ["CaptureTap", "FileTap", "FramesTap", "PushTap", "Tap"]
