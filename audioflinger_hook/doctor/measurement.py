"""Measures the delay from bursts of sound to their vibration, at the monitors of both sinks.

A separate program plays the bursts, so that the daemon treats them as any other sound.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import replace

import numpy as np
import soundfile
from numpy.typing import NDArray

from audioflinger_hook.doctor.facts import Delay, Facts
from audioflinger_hook.service.state import READY
from device.errors import CushionError
from device.process import memory_file
from device.stream import CaptureStream, PcmConfig
from device.stream.pcms import ServerDevice
from device.units import Float32Array

RATE_HZ = 48_000
BURST_S, BURSTS_AT_S, LASTS_S = 0.2, (0.8, 1.4, 2.0, 2.6), 3.0
BURST_HZ, LEVEL = 150.0, 0.25
PLAYS_WITHIN_S = 8.0  # longest time for a program to play LASTS_S
PLAYERS = (("pw-play", "--target"), ("paplay", "--device"))

SILENT = 1e-4  # amplitude of a recording without a burst
FELT_WITHIN_S = 0.5  # time after a burst's start in which its vibration is looked for
NEAR_S = 0.25  # arrivals so near to a frame tell when it was recorded


class Recording:
    """The first channel of a monitor, with the times at which its blocks arrived."""

    def __init__(self) -> None:
        self._blocks: list[tuple[Float32Array, float]] = []

    def add(self, block: Float32Array, now_s: float) -> None:
        """Store a block. The capturing thread calls it; the other methods are for later."""
        self._blocks.append((block[:, 0], now_s))

    @property
    def samples(self) -> NDArray[np.float32]:
        """All samples, (frames,)."""
        blocks = [block for block, _ in self._blocks]
        return np.concatenate(blocks) if blocks else np.zeros(0, np.float32)

    def start_s(self, near_frame: int) -> float:
        """Return the time of frame 0, from the arrivals near a frame: the earliest is right."""
        ends = np.cumsum([len(block) for block, _ in self._blocks])
        arrivals = np.array([now_s for _, now_s in self._blocks])
        near = np.abs(ends - near_frame) < NEAR_S * RATE_HZ
        return float(np.min((arrivals - ends / RATE_HZ)[near], initial=np.inf))


def delay_between(heard: Recording, felt: Recording) -> Delay:
    """Return the median delay from the start of each burst to half of its vibration's peak."""
    sound, vibration = np.abs(heard.samples), np.abs(felt.samples)
    if sound.max(initial=0.0) < SILENT:
        return Delay(was_played=True, reason="the output of the sound stayed silent")
    if vibration.max(initial=0.0) < SILENT:
        return Delay(was_played=True, reason="the output of the vibration stayed silent")
    loud = np.flatnonzero(sound > 0.1 * sound.max())
    found = []
    for onset in loud[np.diff(loud, prepend=-RATE_HZ) > 0.5 * BURST_S * RATE_HZ]:
        apart_s = heard.start_s(onset) - felt.start_s(onset)
        if not np.isfinite(apart_s):
            continue
        first = max(0, onset + round(apart_s * RATE_HZ))
        part = vibration[first : first + round(FELT_WITHIN_S * RATE_HZ)]
        if part.max(initial=0.0) > 0.2 * vibration.max():
            found.append(1e3 * float(np.argmax(part > 0.5 * part.max())) / RATE_HZ)
    if not found:
        return Delay(was_played=True, reason="no vibration follows the bursts")
    return Delay(round(float(np.median(found)), 2), len(found), was_played=True)


def measure(facts: Facts) -> Delay:
    """Play bursts to the output of the sound for LASTS_S, and measure the vibration's delay.

    Only the main thread may call it, before other audio streams exist. It raises nothing.
    """
    if reason := _why_not(facts):
        return Delay(reason=reason)
    player = next(player for player in PLAYERS if shutil.which(player[0]))
    recordings = Recording(), Recording()
    try:
        with ExitStack() as stack:
            pcms = stack.enter_context(closing(PcmConfig("cushion_heard", "cushion_felt")))
            names = facts.heard, facts.felt
            for recording, name, pcm in zip(recordings, names, pcms.pcms.values(), strict=True):
                pcm.target = ServerDevice(f"{name}.monitor")
                stream = CaptureStream(pcm, RATE_HZ, 1, recording.add)
                stack.callback(stream.close)
            _play([*player, facts.heard])
    except CushionError as error:
        return Delay(reason=str(error))
    except (OSError, subprocess.SubprocessError) as error:
        return Delay(reason=f"{player[0]} cannot play ({error})")
    found = delay_between(*recordings)
    graph = facts.server.graph
    if graph is None or not graph.clock_hz:
        return found
    return replace(found, cycle_ms=round(1e3 * graph.cycle_frames / graph.clock_hz, 2))


def _why_not(facts: Facts) -> str:
    """Return why nothing can be measured, or ""."""
    status, sink = facts.daemon.status, facts.server.sink(facts.heard)
    if status is None or status.state not in READY:
        return "not measured: no daemon plays; start `cushion run`"
    if sink is None or facts.server.sink(facts.felt) is None or facts.heard == facts.felt:
        return "not measured: the outputs of sound and vibration are not two sinks"
    if sink.is_playing:
        return "not measured: a program plays now; pause it"
    if not any(shutil.which(program) for program, _ in PLAYERS):
        return "not measured: pw-play and paplay are missing; install pipewire-bin"
    return ""


def _play(command: Sequence[str]) -> None:
    """Play the bursts. OSError, SubprocessError: the program fails or hangs."""
    time_s = np.arange(round(BURST_S * RATE_HZ)) / RATE_HZ
    sound = np.zeros((round(LASTS_S * RATE_HZ), 2), np.float32)
    for start_s in BURSTS_AT_S:
        first = round(start_s * RATE_HZ)
        burst = LEVEL * np.sin(2.0 * np.pi * BURST_HZ * time_s)
        sound[first : first + len(burst)] = burst[:, None]
    file = memory_file("bursts")
    try:
        path = f"/proc/{os.getpid()}/fd/{file}"
        soundfile.write(path, sound, RATE_HZ, format="WAV", subtype="FLOAT")
        subprocess.run(
            [*command, path],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=PLAYS_WITHIN_S,
            check=True,
        )
    finally:
        os.close(file)
