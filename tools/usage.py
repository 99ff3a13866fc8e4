"""Measures memory and CPU time of `cushion run`: tools/usage.py [--seconds S] [--plain].

The program starts a PipeWire server and a daemon with protection, damping and the exposure cap;
`--plain` omits these three. It plays noise that is so loud that protection limits the drive signal.
It prints memory and CPU time of the daemon and of each child process.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from device.errors import CushionError, LostError
from tools.live_latency.daemon import running_daemon, status_of_daemon
from tools.live_latency.recording import playing
from tools.live_latency.usage import held_by_family, used_by_family
from tools.sound_server import ServerError, SoundServer

CARE = 'protection = "on"\ndamping = "auto"\nexposure_cap = "action"\n'
SAMPLERATE = 48_000
QUANTUM = 1_024
SETTLED_S = 3.0


def main() -> int:
    """Measure and print the results. Return 0, or 1 after an error."""
    parser = argparse.ArgumentParser(description="Measure what `cushion run` takes.")
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="duration")
    parser.add_argument("--engine", choices=("native", "python"), default="native")
    parser.add_argument("--plain", action="store_true", help="no protection, damping and cap")
    options = parser.parse_args()
    noise = np.random.default_rng(1).uniform(-0.3, 0.3, (10 * SAMPLERATE, 2))
    try:
        with (
            tempfile.TemporaryDirectory(prefix="memory-") as folder,
            SoundServer("pipewire", Path(folder)) as server,
        ):
            config = Path(folder) / "care.toml"
            config.write_text("" if options.plain else CARE)
            server.set_clock("force-quantum", QUANTUM)
            arguments = ("--engine", options.engine, "--config", str(config))
            with (
                running_daemon("haptic", server.environment, server.folder, arguments=arguments),
                playing("desktop", noise, SAMPLERATE, server.environment),
            ):
                time.sleep(SETTLED_S)
                status = status_of_daemon(server.environment)
                used = used_by_family(status.pid) if status else {}
                time.sleep(options.seconds)
                status = status_of_daemon(server.environment)
                if status is None or status.engine != options.engine:
                    raise LostError(f"the {options.engine} engine does not play: {status}")
                held, used_until = held_by_family(status.pid), used_by_family(status.pid)
                limited = status.protection.limited_blocks if status.protection else 0
    except (CushionError, ServerError) as error:
        print(f"usage: error: {error}", file=sys.stderr)
        return 1
    for process_id, (name, held_mb) in held.items():
        used_s = used_until[process_id] - used.get(process_id, 0.0)
        print(f"{held_mb:6.1f} MB {100.0 * used_s / options.seconds:6.2f} % of a core  {name}")
    together_mb = sum(held_mb for _, held_mb in held.values())
    print(f"{together_mb:6.1f} MB  together; protection has limited {limited} blocks")
    return 0


if __name__ == "__main__":
    sys.exit(main())
