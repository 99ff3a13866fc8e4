"""The live form in NumPy: overlapped, phase-continuous and early."""

from audioflinger_hook.transform.live.transform import LiveTransform

__all__ = ["LiveTransform"]
