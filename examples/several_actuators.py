"""Write the vibration for three actuators to one file: several_actuators.py SOUND OUT.wav."""

import sys
from pathlib import Path

import soundfile

from audioflinger_hook import Settings, render_file
from device.drive import ActuatorSettings

source, target = map(Path, sys.argv[1:])
settings = Settings(
    profile="cinema",
    actuators=(
        ActuatorSettings(channels=(0,), source="left"),
        ActuatorSettings(channels=(1,), source="right"),
        ActuatorSettings(channels=(3,), source="mix", gain_db=-6, delay_ms=10),
    ),
)
render_file(source, target, settings)

vibration, rate = soundfile.read(target)
for channel, peak in enumerate(abs(vibration).max(axis=0)):
    print(f"channel {channel}: peak {peak:.2f}")
