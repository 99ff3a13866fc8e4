"""Print the level of the vibration that each profile gives for soft and loud tones."""

import numpy as np

from audioflinger_hook import HapticTransform
from audioflinger_hook.config.profiles import PROFILES, parameters_of

RATE, SECONDS = 48_000, 2
time_s = np.arange(SECONDS * RATE) / RATE
tone = np.sin(2 * np.pi * 200 * time_s)

print("r.m.s. of the vibration in dB, for a tone of 200 Hz")
for profile in PROFILES:
    levels = []
    for sound_db in (-50, -30, -10):
        transform = HapticTransform(RATE, channels=1, parameters=parameters_of(profile))
        vibration = transform.process(10 ** (sound_db / 20) * tone)[RATE:]
        levels.append(20 * np.log10(max(vibration.std(), 1e-6)))
    print(f"{profile:8}", *(f"{level:7.1f}" for level in levels))
