"""Print the principal frequencies of a sound, with frequency and amplitude of their vibration."""

import numpy as np

from audioflinger_hook import HapticTransform

RATE = 48_000
CHORD_HZ = (220.0, 277.2, 329.6)

time_s = np.arange(RATE) / RATE
sound = sum(0.2 * np.sin(2 * np.pi * hz * time_s) for hz in CHORD_HZ)
transform = HapticTransform(RATE, channels=1)
transform.process(np.asarray(sound))

for sound_hz, vibration_hz, amplitude in sorted(transform.principal):
    print(f"{sound_hz:7.1f} Hz of sound -> {vibration_hz:6.1f} Hz, amplitude {amplitude:.3f}")
