"""Transform a stream of sound block by block, as an audio callback does."""

import numpy as np

from audioflinger_hook import HapticTransform

RATE, FRAMES = 48_000, 256

transform = HapticTransform(RATE, channels=2)
time_s = np.arange(RATE) / RATE
sound = np.stack([np.sin(2 * np.pi * 110 * time_s), np.sin(2 * np.pi * 880 * time_s)], axis=1)

vibration = []
for start in range(0, len(sound), FRAMES):
    vibration.append(transform.process(0.3 * sound[start : start + FRAMES]))
vibration.append(transform.finish())
aligned = np.concatenate(vibration)[transform.latency_frames :]

print(f"{len(sound)} frames of sound, {len(aligned)} of vibration")
print(f"latency {1e3 * transform.latency_s:.1f} ms, peak {np.abs(aligned).max():.2f}")
