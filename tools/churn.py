"""Measures the daemon's load on a busy PipeWire graph: tools/churn.py [--seconds S].

The program starts a private sound server with 200 additional sinks, and `cushion run`. It plays a
steady tone. Each second, it also starts 20 silent streams that last 0.5 s. It prints the daemon's
CPU time, the growth of its memory and of the number of links, and the duration of all gaps in tone
and vibration.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import soundfile

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from audioflinger_hook.transform import FloatArray
from device.errors import CushionError, LostError
from tools.live_latency.bursts import GraphOnce, recorded_together
from tools.live_latency.daemon import running_daemon, status_of_daemon
from tools.live_latency.recording import end, server_name, spawn
from tools.live_latency.usage import ProcessUse
from tools.sound_server import ServerError, SoundServer

NODES, STREAMS_PER_S = 200, 20
RATE_HZ = 48_000
LASTS_S = 0.5
PLAYED_S = 10.0
WINDOW_S = 0.01


@dataclass(frozen=True)
class Churn:
    """The result of a measurement.

    cpu_percent: CPU time of the daemon, in percent of one core.
    heard_gaps_ms, felt_gaps_ms: total duration of gaps in the tone and in its vibration.
    """

    cpu_percent: float
    memory_growth_kb: float
    links_growth: int
    heard_gaps_ms: float
    felt_gaps_ms: float

    def __str__(self) -> str:
        return (
            f"daemon {self.cpu_percent:.1f} % of a core, memory {self.memory_growth_kb:+.0f} kB, "
            f"links {self.links_growth:+d}; interrupted: tone {self.heard_gaps_ms:.0f} ms, "
            f"vibration {self.felt_gaps_ms:.0f} ms"
        )


def main() -> int:
    """Measure and print the result. Return 0, or 1 after an error."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seconds", type=float, default=60.0, help="duration of the measurement")
    options = parser.parse_args()
    try:
        with (
            tempfile.TemporaryDirectory(prefix="churn-") as folder,
            SoundServer("pipewire", Path(folder)) as server,
        ):
            print(f"{server_name(server.environment)}: {churned(server, options.seconds)}")
    except (CushionError, ServerError) as error:
        print(f"churn: error: {error}", file=sys.stderr)
        return 1
    return 0


def churned(server: SoundServer, seconds: float) -> Churn:
    """Measure for `seconds` while streams start and end.

    LostError: a PipeWire program or the daemon fails.
    """
    environment, folder = server.environment, server.folder
    tone, silence = folder / "steady.wav", folder / "silent.wav"
    times_s = np.arange(round((seconds + 2.0 * PLAYED_S) * RATE_HZ)) / RATE_HZ
    _write(tone, 0.3 * np.cos(2.0 * np.pi * 440.0 * times_s))
    _write(silence, np.zeros(round(LASTS_S * RATE_HZ)))
    with (
        _many_nodes(environment),
        running_daemon("haptic", environment, folder, arguments=("--engine", "native")),
    ):
        player = spawn(["pw-play", "--target=desktop", str(tone)], environment)
        try:
            time.sleep(2.0)
            status = status_of_daemon(environment)
            process_id = status.pid if status else 0
            monitors = ("desktop", "monitor_FL"), ("haptic", "monitor_FL")
            before = _link_count(environment)
            with recorded_together(*monitors, folder, environment, RATE_HZ) as together:
                used = _come_and_go(silence, seconds, process_id, environment)
                time.sleep(1.0)
            grown = _link_count(environment) - before
        finally:
            end(player)
    if used.cpu_percent is None or used.memory_growth_kb is None:
        raise LostError("the daemon has ended, so its CPU time is unknown; see its messages")
    heard, felt = soundfile.read(together, always_2d=True)[0].T
    return Churn(
        cpu_percent=used.cpu_percent,
        memory_growth_kb=used.memory_growth_kb,
        links_growth=grown,
        heard_gaps_ms=_gaps_ms(heard),
        felt_gaps_ms=_gaps_ms(felt),
    )


def _come_and_go(
    silence: Path, seconds: float, process_id: int, environment: Mapping[str, str]
) -> ProcessUse:
    used, began_s = ProcessUse(), time.monotonic()
    streams: list[subprocess.Popen[bytes]] = []
    for count in range(round(seconds * STREAMS_PER_S)):
        streams.append(spawn(["pw-play", "--target=desktop", str(silence)], environment))
        streams = [stream for stream in streams if stream.poll() is None]
        if count % STREAMS_PER_S == 0:
            used.sample(process_id, time.monotonic())
        time.sleep(max(0.0, began_s + (count + 1) / STREAMS_PER_S - time.monotonic()))
    used.sample(process_id, time.monotonic())
    for stream in streams:
        stream.wait(10.0 * LASTS_S)
    return used


@contextmanager
def _many_nodes(environment: Mapping[str, str]) -> Iterator[None]:
    process = spawn(["pw-cli"], environment, stdin=subprocess.PIPE)
    assert process.stdin is not None
    try:
        for number in range(NODES):
            known = f"node.name=other-{number} media.class=Audio/Sink audio.position=[FL FR]"
            process.stdin.write(
                f"create-node adapter {{ factory.name=support.null-audio-sink {known} }}\n".encode()
            )
        process.stdin.flush()
        GraphOnce(environment).ports(f"other-{NODES - 1}", "playback_")
        yield
    finally:
        process.stdin.close()
        end(process)


def _link_count(environment: Mapping[str, str]) -> int:
    return len(GraphOnce(environment).read().links)


def _write(path: Path, sound: FloatArray) -> None:
    soundfile.write(path, np.column_stack([sound, sound]), RATE_HZ, subtype="FLOAT")


def _gaps_ms(sound: FloatArray) -> float:
    """Return the total duration in ms of 10 ms pieces with a peak under half of the median peak."""
    window = round(WINDOW_S * RATE_HZ)
    inner = sound[RATE_HZ // 2 : -RATE_HZ // 2]
    peaks = np.abs(inner[: len(inner) // window * window].reshape(-1, window)).max(axis=1)
    return 1e3 * WINDOW_S * float(np.sum(peaks < 0.5 * np.median(peaks)))


if __name__ == "__main__":
    sys.exit(main())
