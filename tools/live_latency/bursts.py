"""How late bursts of sound are felt: sound and vibration recorded in one stream of PipeWire.

The monitor of a sink that drives the graph is read one cycle late, so it cannot be the reference.
The player is linked to a third sink as well, which never drives. Its monitor and that of the
device's sink are read in the same cycle, sample by sample.
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
LEAD_S = 1.5
"""Silence before the first burst, in which links are made."""

REFERENCE = "reference"
APPEARS_S = 10.0
ONSET = 1e-3
"""A sample over this share of the highest one, after silence, begins a burst."""


@dataclass(frozen=True)
class BurstDelays:
    """Delays of the vibration of bursts in ms: to a tenth and to half of each one's peak."""

    tenth_ms: FloatArray
    half_ms: FloatArray

    @classmethod
    def of(cls, heard: FloatArray, felt: FloatArray, samplerate: int) -> BurstDelays:
        """Return the delays in two recordings of equal length, (frames,) each."""
        tenth: list[float] = []
        half: list[float] = []
        for onset in onsets(heard, samplerate):
            part = np.abs(felt[onset : onset + round((APART_S - 0.05) * samplerate)])
            if part.size < round(BURST_S * samplerate) or part.max(initial=0.0) < 1e-4:
                continue
            before = np.abs(felt[max(0, onset - round(0.005 * samplerate)) : onset])
            if before.max(initial=0.0) > 0.05 * part.max():  # it still vibrates
                continue
            for found, share in ((tenth, 0.1), (half, 0.5)):
                found.append(1e3 * int(np.argmax(part >= share * part.max())) / samplerate)
        return cls(np.array(tenth), np.array(half))


def burst_sound(count: int, samplerate: int, seed: int = 1) -> FloatArray:
    """Return (frames,) of bursts of constant level, at random places of the graph's cycle."""
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
    """Return the first frame of each burst."""
    loud = np.flatnonzero(np.abs(heard) > ONSET * np.abs(heard).max(initial=1e-9))
    if not loud.size:
        return []
    begins = np.diff(loud, prepend=-samplerate) > 0.2 * samplerate
    return [int(frame) for frame in loud[begins]]


class GraphOnce:
    """PipeWire's graph as `pw-dump` prints it now, and links in it. environment: of programs."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._environment = dict(environment)

    def read(self) -> Graph:
        """Return the graph as it is."""
        graph, decoder = Graph(), json.JSONDecoder()
        shown = self._run("pw-dump", "--no-colors")
        while shown := shown.lstrip():  # what changes meanwhile is an array of its own
            objects, length = decoder.raw_decode(shown)
            graph.apply(objects)
            shown = shown[length:]
        return graph

    def ports(self, name: str, prefix: str) -> dict[str, int]:
        """Return a node's ports by their names after the prefix, once it has some."""
        return wait_for(lambda: self._ports(name, prefix), f"ports {prefix}* of {name}")

    def link(self, output: int, put: int) -> None:
        """Link two ports."""
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
    """Return what `look` finds once it finds something. LostError: it does not."""
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
    """Record two ports, (node, port) each, in one stream; the file is whole after the context."""
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
        process.send_signal(signal.SIGINT)  # the file gets its length
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
    """Play bursts to a sink while a daemon runs, and return how late its device vibrates.

    There must be a sink `reference` that never drives the graph. direct: the player is linked to
    the device, too, so that all delays should be 0. midway: called while bursts play.

    LostError: a program or a port did not come.
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
