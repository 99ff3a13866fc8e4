"""Delay from bursts of sound to their vibration, both recorded in one PipeWire stream.

The monitor of a sink that drives PipeWire's graph is one cycle late, so this monitor cannot be the
reference. Therefore the player is also linked to an additional sink, which never drives the graph.
The monitors of this sink and of the sink for the vibration are recorded in the same cycle.
"""

from __future__ import annotations

import json
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import soundfile

from audioflinger_hook.transform import FloatArray
from device.errors import LostError
from device.server.graph import Graph
from tools.live_latency.recording import end, spawn

BURSTS_HZ = (150.0, 440.0, 900.0)
BURST_S, APART_S = 0.25, 0.75
LEAD_S = 1.5  # silence in s before the first burst, during which links are made
REFERENCE = "reference"
APPEARS_S = 10.0
ONSET = 1e-3  # a burst starts where, after silence, a sample exceeds this share of the peak


@dataclass(frozen=True)
class BurstDelays:
    """Delays in ms from the start of each burst to its vibration.

    tenth_ms: until the vibration reaches a tenth of its peak.
    half_ms: until the vibration reaches half of its peak.
    """

    tenth_ms: FloatArray
    half_ms: FloatArray

    @classmethod
    def of(cls, heard: FloatArray, felt: FloatArray, samplerate: int) -> BurstDelays:
        """Return the delays in recordings of the sound and of the vibration, both (frames,)."""
        tenth: list[float] = []
        half: list[float] = []
        for onset in onsets(heard, samplerate):
            part = np.abs(felt[onset : onset + round((APART_S - 0.05) * samplerate)])
            if part.size < round(BURST_S * samplerate) or part.max(initial=0.0) < 1e-4:
                continue
            before = np.abs(felt[max(0, onset - round(0.005 * samplerate)) : onset])
            if before.max(initial=0.0) > 0.05 * part.max():  # the previous burst still vibrates
                continue
            for found, share in ((tenth, 0.1), (half, 0.5)):
                found.append(1e3 * int(np.argmax(part >= share * part.max())) / samplerate)
        return cls(np.array(tenth), np.array(half))


def burst_sound(count: int, samplerate: int, seed: int = 1) -> FloatArray:
    """Return a sound with bursts of constant level at random times, (frames,).

    count: number of bursts.
    """
    random = np.random.default_rng(seed)
    frames = round((LEAD_S + count * (APART_S + 0.05) + 1.0) * samplerate)
    sound = np.zeros(frames)
    time_s = np.arange(round(BURST_S * samplerate)) / samplerate
    start_s = LEAD_S
    for number in range(count):
        burst = 0.4 * np.cos(2.0 * np.pi * BURSTS_HZ[number % len(BURSTS_HZ)] * time_s)
        first = round(start_s * samplerate)
        sound[first : first + burst.size] = burst
        start_s += APART_S + 0.05 * random.random()
    return sound


def onsets(heard: FloatArray, samplerate: int) -> list[int]:
    """Return the frame at which each burst starts in a recording."""
    loud = np.flatnonzero(np.abs(heard) > ONSET * np.abs(heard).max(initial=1e-9))
    if not loud.size:
        return []
    begins = np.diff(loud, prepend=-samplerate) > 0.2 * samplerate
    return [int(frame) for frame in loud[begins]]


class GraphOnce:
    """Reads and changes PipeWire's graph of nodes, ports and links.

    environment: environment variables that select the server.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._environment = dict(environment)

    def read(self) -> Graph:
        """Return the current graph."""
        graph, decoder = Graph(), json.JSONDecoder()
        shown = self._run("pw-dump", "--no-colors")
        while shown := shown.lstrip():  # changes during the dump follow as further arrays
            objects, length = decoder.raw_decode(shown)
            graph.apply(objects)
            shown = shown[length:]
        return graph

    def ports(self, name: str, prefix: str) -> dict[str, int]:
        """Wait for ports whose names start with `prefix`, and return their IDs.

        The keys of the result are the names of the ports without `prefix`.

        name: name of the node that has the ports.
        """
        return wait_for(lambda: self._ports(name, prefix), f"ports {prefix}* of {name}")

    def link(self, output: int, put: int) -> None:
        """Link two ports. output: ID of the output port. put: ID of the input port."""
        self._run("pw-link", str(output), str(put))

    def _ports(self, name: str, prefix: str) -> dict[str, int]:
        graph = self.read()
        node = graph.node_named(name)
        return graph.ports_of(node.id, prefix) if node else {}

    def _run(self, *command: str) -> str:
        done = subprocess.run(
            command, env=self._environment, capture_output=True, text=True, timeout=APPEARS_S
        )
        if done.returncode:
            raise LostError(f"{' '.join(command)}: {done.stderr.strip()}")
        return done.stdout


def wait_for(
    look: Callable[[], dict[str, int]], what: str, limit_s: float = APPEARS_S
) -> dict[str, int]:
    """Call `look` until it returns a result that is not empty, and return this result.

    what: description of the result for the message of an error.

    LostError: there is no result within `limit_s`.
    """
    limit_s += time.monotonic()
    while not (found := look()):
        if time.monotonic() > limit_s:
            raise LostError(f"PipeWire does not show {what}")
        time.sleep(0.02)
    return found


@contextmanager
def recorded_together(
    left: tuple[str, str],
    right: tuple[str, str],
    folder: Path,
    environment: Mapping[str, str],
    samplerate: int,
) -> Iterator[Path]:
    """Record two ports in one stream within a `with` block, which gets the path of the WAV file.

    left, right: for each channel of the file, name of a node and name of the node's port.

    The file is complete only after the block.
    """
    path, name = folder / "together.wav", "burst-recorder"
    process = spawn(
        [
            *("pw-record", "--target=0", "--channels=2", f"--rate={samplerate}", "--format=f32"),
            *("--latency=256", f"--properties={{ node.name = {name} }}", str(path)),
        ],
        environment,
    )
    try:
        graph = GraphOnce(environment)
        inputs = graph.ports(name, "input_")
        for (node, port), channel in ((left, "FL"), (right, "FR")):
            graph.link(graph.ports(node, port)[""], inputs[channel])
        yield path
    finally:
        process.send_signal(signal.SIGINT)  # makes pw-record write the length
        try:
            process.wait(APPEARS_S)
        except subprocess.TimeoutExpired:
            end(process)


def burst_delays(
    count: int,
    samplerate: int,
    folder: Path,
    environment: Mapping[str, str],
    *,
    sink: str = "desktop",
    device: str = "haptic",
    direct: bool = False,
    midway: Callable[[], object] = lambda: None,
) -> BurstDelays:
    """Play bursts while a daemon runs, and return the delays of the daemon's vibration.

    A sink named `reference` must exist and must never drive PipeWire's graph.

    count: number of bursts.
    folder: folder for the recording.
    environment: environment variables that select the server.
    sink: name of the sink that plays the bursts.
    device: name of the sink that plays the daemon's vibration.
    direct: whether to link the player to `device` too; a correct measurement then gives 0 ms.
    midway: function to call while the bursts play.

    LostError: a port does not appear, the player does not end, or a PipeWire program fails.
    """
    path = folder / "bursts.wav"
    soundfile.write(path, burst_sound(count, samplerate), samplerate, subtype="FLOAT")
    graph = GraphOnce(environment)
    monitors = (REFERENCE, "monitor_FL"), (device, "monitor_FL")
    with recorded_together(*monitors, folder, environment, samplerate) as together:
        name = "burst-player"
        command = ["pw-play", f"--target={sink}", f"--properties={{ node.name = {name} }}"]
        process = spawn([*command, str(path)], environment)
        try:
            outputs = graph.ports(name, "output_")
            for node in (REFERENCE, device) if direct else (REFERENCE,):
                inputs = graph.ports(node, "playback_")
                output = next(iter(outputs.values()))
                graph.link(outputs.get("FL", output), inputs["FL"])
            with suppress(subprocess.TimeoutExpired):
                process.wait(LEAD_S + 2.0)
            midway()
            process.wait(count * (APART_S + 0.05) + LEAD_S + APPEARS_S)
        except subprocess.TimeoutExpired:
            raise LostError("pw-play does not end") from None
        finally:
            end(process)
    recording, rate = soundfile.read(together, always_2d=True)
    return BurstDelays.of(recording[:, 0], recording[:, 1], rate)
