"""Record a sound into a folder, then write its vibration: replay_capture.py FOLDER OUT.wav."""

import sys
from pathlib import Path

import numpy as np

from audioflinger_hook.capture import Capture, CaptureWriter
from audioflinger_hook.offline.render import render
from audioflinger_hook.sources import CaptureTap, TapClient

folder, target = map(Path, sys.argv[1:])
RATE = 48_000
sound = (0.3 * np.sin(2 * np.pi * 220 * np.arange(RATE) / RATE)).astype(np.float32)[:, np.newaxis]

with CaptureWriter(folder, streams=["tap"]) as writer:
    for start in range(0, RATE, 512):
        writer.write_buffer("tap", sound[start : start + 512], RATE, time_s=start / RATE)

read = np.concatenate([buffer.frames for buffer in Capture(folder).buffers("tap")])
print("the same bits:", read.tobytes() == sound.tobytes())

report = render(TapClient(CaptureTap(folder)), target)
print(f"{target}: {report.frames} frames, peak {report.peak:.2f}")
