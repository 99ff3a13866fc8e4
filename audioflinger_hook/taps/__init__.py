"""Taps: where the sound comes from. Each delivers buffers of frames as they are played."""

from audioflinger_hook.taps.file import FileTap
from audioflinger_hook.taps.scene import SceneTap
from audioflinger_hook.taps.tap import Tap

__all__ = ["FileTap", "SceneTap", "Tap"]
