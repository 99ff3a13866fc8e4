"""Measures the delay from bursts of sound to their vibration, at the monitors of both sinks."""

import threading
from contextlib import ExitStack, closing

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.doctor.facts import Delay, Facts
from audioflinger_hook.service.state import READY
from device.errors import CushionError
from device.stream import CaptureStream, PcmConfig, PlaybackStream
from device.stream.pcms import ServerDevice
from device.units import Float32Array

RATE_HZ = 48_000
BURST_S, BURSTS_AT_S, LASTS_S = 0.2, (0.8, 1.4, 2.0, 2.6), 3.0
BURST_HZ, LEVEL = 150.0, 0.25
STARTS_WITHIN_S = 1.0  # longest time from opening the streams until the sound is heard
ROLE = "test"  # with this role, the daemon captures the bursts like any other sound

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
        return np.concatenate([np.zeros(0, np.float32), *(block for block, _ in self._blocks)])

    def start_s(self, near_frame: int) -> float:
        """Return the time of frame 0, from the arrivals near a frame: the earliest is right."""
        ends = np.cumsum([len(block) for block, _ in self._blocks])
        arrivals = np.array([now_s for _, now_s in self._blocks])
        near = np.abs(ends - near_frame) < NEAR_S * RATE_HZ
        return float(np.min((arrivals - ends / RATE_HZ)[near], initial=np.inf))


def delay_between(heard: Recording, felt: Recording) -> Delay:
    """Return the median delay from the start of each burst to half of its vibration's peak."""
    sound, vibration = np.abs(heard.samples), np.abs(felt.samples)
    for name, samples in (("sound", sound), ("vibration", vibration)):
        if samples.max(initial=0.0) < SILENT:
            return Delay(was_played=True, reason=f"the output of the {name} stayed silent")
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
    heard, felt = facts.heard, facts.felt
    if facts.status is None or facts.status.state not in READY:
        return Delay(reason="not measured: no daemon plays; start `cushion run`")
    if heard is None or felt is None or heard == felt:
        return Delay(reason="not measured: the outputs of sound and vibration are not two sinks")
    if facts.server and facts.server.playing_to(heard.name):
        return Delay(reason="not measured: a program plays now; pause it")
    recordings = Recording(), Recording()
    time_s = np.arange(round(LASTS_S * RATE_HZ)) / RATE_HZ
    is_on = [(time_s >= start_s) & (time_s < start_s + BURST_S) for start_s in BURSTS_AT_S]
    burst = LEVEL * np.sin(2.0 * np.pi * BURST_HZ * time_s)
    left = np.where(np.any(is_on, 0), burst, 0.0).astype(np.float32)

    def fill(out: Float32Array, now_s: float) -> None:  # only the output's thread calls it
        nonlocal left
        part, left = np.split(left, [len(out)])
        out[: part.size] = part[:, None]

    try:
        with ExitStack() as stack:
            config = stack.enter_context(closing(PcmConfig("heard", "felt", "bursts", role=ROLE)))
            *monitors, output = config.pcms.values()
            for recording, sink, pcm in zip(recordings, (heard, felt), monitors, strict=True):
                pcm.target = ServerDevice(f"{sink.name}.monitor")
                stack.enter_context(closing(CaptureStream(pcm, RATE_HZ, 1, recording.add)))
            output.target = ServerDevice(heard.name)
            bursts = PlaybackStream(output, RATE_HZ, 2, fill)
            stack.enter_context(closing(bursts))
            bursts.audible = True
            threading.Event().wait(STARTS_WITHIN_S + LASTS_S)
    except CushionError as error:
        return Delay(reason=str(error))
    return delay_between(*recordings)
