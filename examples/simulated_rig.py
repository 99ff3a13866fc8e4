"""Predict the motion of the seats of two rigs, for tones of several frequencies."""

import numpy as np

from device import rig_by_name
from device.rig.simulated_rig import SimulatedRig

RATE = 48_000
time_s = np.arange(RATE) / RATE

for name in ("paper", "consumer"):
    rig = rig_by_name(name)
    for frequency_hz in (20, 40, 80, 160):
        simulated = SimulatedRig(rig, RATE, channels=1)
        tone = 0.2 * np.sin(2 * np.pi * frequency_hz * time_s)
        simulated.write(tone[:, np.newaxis])
        share = simulated.peak_displacement_m / rig.actuator.x_max_m
        print(
            f"{name}, {frequency_hz} Hz: {simulated.peak_acceleration_m_s2:.1f} m/s^2, "
            f"{share:.2f} of Xmax"
        )
