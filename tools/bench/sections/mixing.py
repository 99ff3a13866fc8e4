"""Section on the mixer: what a cycle costs, by tracks, and what it adds to the transform."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from audioflinger_hook.mixer import Mixer, PcmFormat
from audioflinger_hook.pipeline.framework import Framework
from audioflinger_hook.pipeline.step import Pipeline
from audioflinger_hook.scenes import demo_scene
from audioflinger_hook.sources import Client, FramesTap, SceneClient, TapClient, mixdown
from tools.bench.cost import Timings, interleaved
from tools.bench.report import Must, Row, Section
from tools.bench.sounds.signals import SAMPLERATE, Stereo
from tools.bench.workbench import LIVE, Subject, Workbench

HAL_FRAMES = 240
"""The mixer makes cycles of 960 frames, 20 ms, of it."""
TRACKS = (1, 8, 32)
OTHER_RATE = 44_100
CYCLES_AT_ONCE = 10
"""Cycles in one timing, from rings filled before it."""
BLOCKSIZE = 256

TIME, SHARE, UNITS = "µs a cycle", "part of its length", "FFTs"
LINEAR = Must("<=", 1.25)


class TrackBank:
    """A mixer with equal stereo float tracks, whose rings `fill` fills and `run` empties."""

    def __init__(self, tracks: int, samplerate: int = SAMPLERATE) -> None:
        self._mixer = Mixer(SAMPLERATE, 2, hal_frames=HAL_FRAMES, standby_delay_s=math.inf)
        self.frames = self._mixer.frames
        period = -(-self.frames * samplerate // SAMPLERATE) + 1
        room = (CYCLES_AT_ONCE + 1) * period
        noise = np.random.default_rng(2).uniform(-1.0, 1.0, (room, 2)) / tracks
        self._sound: Stereo = noise.astype(np.float32)
        self._tracks = [
            self._mixer.create_track(
                f"track {number}",
                PcmFormat.FLOAT,
                samplerate,
                2,
                ring_frames=room,
                start_threshold=1,
            )
            for number in range(tracks)
        ]
        for track in self._tracks:
            track.start()

    def fill(self) -> None:
        """Fill every track's ring, as its client would."""
        for track in self._tracks:
            track.write(self._sound[: track.room])

    def run(self) -> int:
        """Do the cycles of one timing and return how many tracks they mixed."""
        return sum(self._mixer.cycle(0.0).tracks_mixed for _ in range(CYCLES_AT_ONCE))


class _Run:
    """One way to play the demo scene; `begin` opens it anew, `run` plays it to the end."""

    def __init__(self, begin: Callable[[], Callable[[], None]]) -> None:
        self._begin = begin
        self.begin()

    def begin(self) -> None:
        """Open the stream."""
        self.run = self._begin()


def mixing(bench: Workbench) -> Section:
    """CPU time of mix cycles by tracks, and of the demo scene with and without the mixer."""
    rows = _cycle_rows(bench.effort.mix_rounds)
    rows += _demo_rows(bench.subject(LIVE), bench.effort.mix_repeats)
    return Section(
        "The mixer",
        "CPU time of the mixer's thread for a cycle of 20 ms, 48 kHz stereo, from float tracks "
        "that their clients have filled, without effects and sinks. Each track should cost the "
        "same: one more track among 8 to 32 is compared with one more among 1 to 8. Then the demo "
        f"scene in cycles of {BLOCKSIZE} frames, to its vibration: the transform alone on the "
        "finished mix; the mix as one track through client, mixer and effect; and the scene's "
        "five tracks, mixed and resampled. Shares are of the cycle's length.",
        tuple(rows),
    )


def _cycle_rows(rounds: int) -> list[Row]:
    """Return the cost of a cycle by tracks, how it scales, and that of a resampled track."""
    banks = {f"{count} track{'s' * (count > 1)} of 48 kHz": TrackBank(count) for count in TRACKS}
    banks["1 track of 44.1 kHz, resampled"] = TrackBank(1, OTHER_RATE)
    works = list(banks.values())
    timings = interleaved(
        [bank.run for bank in works], rounds, before=[bank.fill for bank in works]
    )
    length_s = CYCLES_AT_ONCE * works[0].frames / SAMPLERATE
    rows: list[Row] = []
    for name, timing in zip(banks, timings, strict=True):
        rows += _cost_rows(name, timing, CYCLES_AT_ONCE, length_s)
    one, eight, many = (1e6 * timing.median_s / CYCLES_AT_ONCE for timing in timings[:3])
    first_us = (eight - one) / (TRACKS[1] - TRACKS[0])
    later_us = (many - eight) / (TRACKS[2] - TRACKS[1])
    ratio = later_us / first_us if first_us > 0.0 else math.nan
    name = "one more of 8 to 32 over one more of 1 to 8"
    return [*rows, Row(name, ratio, "times", TIME, LINEAR)]


def _demo_rows(subject: Subject, repeats: int) -> list[Row]:
    """Return the cost of the demo scene with and without client, mixer and effect."""
    scene = demo_scene()
    sound = mixdown(scene)

    def bare() -> Callable[[], None]:
        stream = subject.start(SAMPLERATE, sound.shape[1])

        def run() -> None:
            for first in range(0, len(sound), BLOCKSIZE):
                stream.process(sound[first : first + BLOCKSIZE])
            stream.finish()

        return run

    runs = {
        "demo scene, transform alone": _Run(bare),
        "demo scene, through mixer and effect": _Run(
            lambda: _chain(TapClient(FramesTap(sound, SAMPLERATE, BLOCKSIZE)))
        ),
        "demo scene, five tracks mixed": _Run(lambda: _chain(SceneClient(scene, BLOCKSIZE))),
    }
    timings = interleaved(
        [lambda each=each: each.run() for each in runs.values()],  # type: ignore[misc]
        repeats,
        [each.begin for each in runs.values()],
    )
    cycles, length_s = len(sound) / BLOCKSIZE, len(sound) / SAMPLERATE
    return [
        row
        for name, timing in zip(runs, timings, strict=True)
        for row in _cost_rows(name, timing, cycles, length_s)
    ]


def _chain(client: Client) -> Callable[[], None]:
    """Return what plays a client through mixer and effect, to no device."""
    framework = Framework(client.samplerate, client.channels)
    return partial(_play, Pipeline(client, framework, ()))


def _play(chain: Pipeline) -> None:
    while chain.step() is not None:
        pass


def _cost_rows(name: str, timings: Timings, cycles: float, length_s: float) -> list[Row]:
    """Return a cost by the cycle, as a share of the length of all cycles, and in FFTs."""
    low_s, high_s = min(timings.seconds), max(timings.seconds)

    def row(factor: float, unit: str, column: str) -> Row:
        spread = factor * low_s, factor * high_s
        return Row(name, factor * timings.median_s, unit, column, low=spread[0], high=spread[1])

    return [
        row(1e6 / cycles, "µs", TIME),
        row(100.0 / length_s, "%", SHARE),
        Row(name, timings.median_units / cycles, "FFTs", UNITS),
    ]
