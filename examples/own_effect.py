"""Apply an effect before the transform. docs/effects.md explains how `cushion` uses effects."""

import uuid

import numpy as np

from audioflinger_hook import HapticTransform
from audioflinger_hook.effect.chain import EffectChains
from audioflinger_hook.effect.interface import ENOSYS, OK, Command, EffectDescriptor
from audioflinger_hook.mixer.mix_buffer import OUTPUT_MIX, MixBuffer

RATE, FRAMES = 48_000, 480


class Gentle:
    """Halves the amplitude of the sound, which also weakens the vibration."""

    descriptor = EffectDescriptor(uuid.uuid4(), uuid.uuid4(), name="Gentle", implementor="You")

    def process(self, source: MixBuffer, target: MixBuffer) -> int:
        """Write the sound of the source to the target, at half of its amplitude."""
        target.audio[:] = 0.5 * source.audio
        return OK

    def command(self, code: int, data: object = None) -> tuple[int, object]:
        """Accept the commands that every effect must accept."""
        return (OK, None) if code <= Command.DISABLE else (ENOSYS, None)


chains = EffectChains(lambda: 0.0, budget_share=float("inf"))
chains.set_format(RATE, channels=1, haptic_channels=0, frames=FRAMES)
chains.add(Gentle(), OUTPUT_MIX).enable()
chains.end_of_cycle(0.0)
buffer, transform = MixBuffer(FRAMES, 1), HapticTransform(RATE, channels=1)
for start in range(0, RATE, FRAMES):
    buffer.audio[:, 0] = 0.4 * np.sin(2 * np.pi * 300 * np.arange(start, start + FRAMES) / RATE)
    chains.process(OUTPUT_MIX, buffer, now_s=0.0)
    vibration = transform.process(buffer.audio)
print(f"sound {np.abs(buffer.audio).max():.2f}, vibration {np.abs(vibration).max():.2f}")
