"""The effect: what the mixer's output passes through, leaving vibration beside it."""

from audioflinger_hook.effect.haptic import HapticEffect

__all__ = ["HapticEffect"]
