"""A cushion on a test bench, simulated: what goes to one sink moves it, another hears its sensors.

A program of its own, `python -m tests.servers.cushion_on_a_bench HAPTIC INSTRUMENTS RIG`, until it
is killed. It reads the monitor of the sink HAPTIC and plays to the sink INSTRUMENTS, whose monitor
is the input of a measurement: acceleration, 5 mV per m/s^2, current across 0.1 ohm, and voltage
through a divider of 20, all at 1 V full scale. RIG may be a file, also of a coil with eddy
currents.
"""

import subprocess
import sys
from typing import Any

import numpy as np

from device.rig import rig_by_name
from device.rig.actuator import LinearActuator
from device.rig.electronics import Amplifier, Dac
from tests.support.eddy_coils import EddyActuator

RATE_HZ = 48_000
FRAMES = 480
CHANNELS = 4
MAP = "front-left,front-right,rear-left,rear-right"
NOISE = 1e-5
OPTIONS = (
    *("--input-full-scale-v", "1", "--acceleration-mv-per-m-s2", "5", "--shunt-ohm", "0.1"),
    *("--voltage-ratio", "20"),
)
NAMES = "acceleration,current,voltage"


def main(haptic: str, instruments: str, rig_name: str) -> None:
    rig, random = rig_by_name(rig_name), np.random.default_rng(1)
    dac, amplifier = Dac(rig.dac), Amplifier(rig.amplifier, RATE_HZ)
    source = rig.amplifier.source_impedance_ohm
    kind = EddyActuator if rig.actuator.inductance_eddy_h else LinearActuator
    actuator = kind(rig.actuator, RATE_HZ, source)
    form = ["--raw", "--format=float32le", f"--rate={RATE_HZ}"]
    listen = [f"--device={haptic}.monitor", "--channels=2", "--latency-msec=20"]
    show = [f"--device={instruments}", f"--channels={CHANNELS}", f"--channel-map={MAP}"]
    heard: Any = subprocess.Popen(["parec", *form, *listen], stdout=subprocess.PIPE)
    shown: Any = subprocess.Popen(
        ["pacat", "-p", *form, *show, "--latency-msec=200"], stdin=subprocess.PIPE
    )
    first = True
    while block := heard.stdout.read(FRAMES * 8):
        frames = np.frombuffer(block[: len(block) // 8 * 8], np.float32).reshape(-1, 2)
        drive = amplifier.drive(dac.volts(frames[:, 0]))
        motion = actuator.move(drive, ("acceleration_m_s2", "current_a"))
        sensors = NOISE * random.standard_normal((len(frames), CHANNELS))
        sensors[:, 0] += motion.acceleration_m_s2 * 0.005
        sensors[:, 1] += motion.current_a * 0.1
        sensors[:, 2] += (drive - source * motion.current_a) / 20.0
        shown.stdin.write(sensors.astype(np.float32).tobytes())
        shown.stdin.flush()
        if first:
            print("ready", flush=True)
            first = False


if __name__ == "__main__":
    main(*sys.argv[1:])
