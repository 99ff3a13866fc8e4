"""Write the vibration of a sound file: file_to_vibration.py SOUND.wav VIBRATION.wav."""

import sys
from pathlib import Path

from audioflinger_hook import Settings, render_file

source, target = map(Path, sys.argv[1:])
report = render_file(source, target, Settings(profile="cinema"))
print(f"{target}: {report.frames / report.samplerate:.1f} s, peak {report.peak:.2f}")
for warning in report.warnings:
    print("warning:", warning)
