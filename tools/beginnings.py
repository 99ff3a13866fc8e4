"""Measures vibration lost at the start of new PipeWire streams: tools/beginnings.py [--count N].

The program starts a private sound server and `cushion run`. It then plays a short file several
times with each player. The players are pw-play, paplay, mpv, a JACK client (mpv with pw-jack), and
pw-play through a loopback. The file contains the same tone twice. By the second tone, PipeWire has
made all links of the new stream. For both tones, the delay from sound to vibration is measured. The
result is the number of graph cycles by which the delay of the first tone is longer.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import soundfile

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from audioflinger_hook.transform import FloatArray
from device.errors import CushionError, LostError
from tools.live_latency.bursts import GraphOnce, onsets, recorded_together
from tools.live_latency.daemon import running_daemon
from tools.live_latency.recording import end, server_name, spawn
from tools.sound_server import ServerError, SoundServer

RATE_HZ = 48_000
QUANTUM = 1_024
TONE_S, APART_S = 0.25, 0.5

QUIET = ("--no-video", "--no-terminal", "--no-config")
PLAYERS: dict[str, tuple[str, ...]] = {
    "pw-play": ("pw-play", "--target=desktop"),
    "paplay": ("paplay", "--device=desktop"),
    "mpv": ("mpv", *QUIET, "--ao=pipewire"),
    "JACK": ("pw-jack", "mpv", *QUIET, "--ao=jack", "--jack-port=desktop", "--jack-connect=yes"),
    "loopback": ("pw-play", "--target=loop"),
}


def main() -> int:
    """Print the number of lost graph cycles for each player. Return 0, or 1 after an error."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--count", type=int, default=20, help="number of streams for each player")
    parser.add_argument("--player", choices=PLAYERS, nargs="+", default=list(PLAYERS))
    options = parser.parse_args()
    try:
        with (
            tempfile.TemporaryDirectory(prefix="begin-") as folder,
            SoundServer("pipewire", Path(folder)) as server,
        ):
            server.set_clock("force-quantum", QUANTUM)
            with running_daemon(
                "haptic", server.environment, server.folder, arguments=("--engine", "native")
            ):
                for player in options.player:
                    lost = lost_cycles(player, options.count, Path(folder), server.environment)
                    name = server_name(server.environment)
                    print(f"{name}, {player}: {told(lost)}", flush=True)
    except (CushionError, ServerError) as error:
        print(f"beginnings: error: {error}", file=sys.stderr)
        return 1
    return 0


def told(lost: list[int]) -> str:
    """Return a summary as text. lost: number of graph cycles that each stream lost."""
    whole = sum(one == 0 for one in lost)
    most = max(lost, default=0)
    return f"{whole} of {len(lost)} lost nothing" + (f", the others up to {most}" if most else "")


def lost_cycles(player: str, count: int, folder: Path, environment: Mapping[str, str]) -> list[int]:
    """Return the number of graph cycles that each of `count` new streams lost at its start.

    LostError: a player is not installed, or the recording contains fewer than `count` streams, or a
    stream with one tone.
    """
    command = PLAYERS[player]
    if missing := [one for one in command[:2] if one[0] != "-" and not shutil.which(one)]:
        raise LostError(f"{missing[0]} is not installed; run tools/fetch_servers.sh")
    path = folder / "tone.wav"
    times_s = np.arange(round(TONE_S * RATE_HZ)) / RATE_HZ
    tone = 0.4 * np.cos(2.0 * np.pi * 440.0 * times_s)
    tone = np.concatenate([tone, np.zeros_like(tone), tone])
    soundfile.write(path, np.column_stack([tone, tone]), RATE_HZ, subtype="FLOAT")
    with ExitStack() as stack:
        if player == "loopback":
            stack.enter_context(_loopback(environment))
        monitors = ("desktop", "monitor_FL"), ("haptic", "monitor_FL")
        together = stack.enter_context(recorded_together(*monitors, folder, environment, RATE_HZ))
        time.sleep(0.5)
        for _ in range(count):
            process = spawn([*command, str(path)], environment)
            process.wait(10.0)
            end(process)
            time.sleep(APART_S)
        time.sleep(0.5)
    recording, _ = soundfile.read(together, always_2d=True)
    torn = _shortened(recording[:, 0])
    if torn:
        print(f"{player}: {torn} of {count} began late at the speakers, too", flush=True)
    lost = list(_lost(recording[:, 0], recording[:, 1]))
    if len(lost) < count:
        raise LostError(f"{player}: {len(lost)} of {count} streams were heard")
    return lost


def _lost(heard: FloatArray, felt: FloatArray) -> Iterator[int]:
    begins = onsets(heard, RATE_HZ)
    if len(begins) % 2:
        raise LostError(f"{len(begins)} tones were heard, but each stream has 2; measure again")
    for first, second in zip(begins[::2], begins[1::2], strict=True):
        late = _delay_frames(felt, first) - _delay_frames(felt, second)
        yield max(0, round(late / QUANTUM))


def _shortened(heard: FloatArray) -> int:
    begins = onsets(heard, RATE_HZ)
    loud = np.abs(heard) > 0.01
    sizes = [np.count_nonzero(loud[at : at + round(TONE_S * RATE_HZ)]) for at in begins]
    return sum(int(a < b - QUANTUM // 8) for a, b in zip(sizes[::2], sizes[1::2], strict=False))


def _delay_frames(felt: FloatArray, onset: int) -> int:
    # The monitor of a sink that drives the graph is a cycle late, so the delay may be negative.
    part = np.abs(felt[max(0, onset - QUANTUM) : onset + round(TONE_S * RATE_HZ)])
    return int(np.argmax(part >= 0.1 * part.max(initial=1e-9))) - min(onset, QUANTUM)


@contextmanager
def _loopback(environment: Mapping[str, str]) -> Iterator[None]:
    """A context with a loopback that plays the sound of its sink `loop` to the sink `desktop`."""
    process = spawn(
        [
            *("pw-loopback", "--capture-props=media.class=Audio/Sink node.name=loop"),
            "--playback-props=node.target=desktop target.object=desktop node.name=loop-out",
        ],
        environment,
    )
    try:
        GraphOnce(environment).ports("loop", "playback_")
        time.sleep(0.5)
        yield
    finally:
        end(process)


if __name__ == "__main__":
    sys.exit(main())
