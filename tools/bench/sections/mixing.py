"""Section "The mixer": CPU time of a cycle, by number of tracks."""

from __future__ import annotations

import math

import numpy as np

from audioflinger_hook.mixer import Mixer, PcmFormat
from tools.bench.cost import interleaved
from tools.bench.report import Must, Row, Section
from tools.bench.sounds.signals import SAMPLERATE, Stereo
from tools.bench.workbench import Workbench

HAL_FRAMES = 240  # frames of a HAL buffer; the mixer joins four into a cycle of 960 frames, 20 ms
TRACKS = (1, 8, 32)
OTHER_RATE = 44_100
CYCLES_AT_ONCE = 10  # cycles in one timing; rings are filled before it
TIME, UNITS = "µs a cycle", "FFTs"
LINEAR = Must("<=", 1.25)


class TrackBank:
    """A mixer with several equal stereo tracks of float samples."""

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
        """Fill the ring buffer of each track."""
        for track in self._tracks:
            track.write(self._sound[: track.ring.room])

    def run(self) -> int:
        """Run ten cycles of the mixer; return the sum of the numbers of mixed tracks."""
        return sum(self._mixer.cycle(0.0).tracks_mixed for _ in range(CYCLES_AT_ONCE))


def mixing(bench: Workbench) -> Section:
    """Measure the CPU time of a cycle of the mixer, for several numbers of tracks."""
    banks = {f"{count} track{'s' * (count > 1)} of 48 kHz": TrackBank(count) for count in TRACKS}
    banks["1 track of 44.1 kHz, resampled"] = TrackBank(1, OTHER_RATE)
    works = list(banks.values())
    timings = interleaved(
        [bank.run for bank in works], bench.effort.mix_rounds, before=[bank.fill for bank in works]
    )
    rows: list[Row] = []
    for name, timing in zip(banks, timings, strict=True):
        spread = (1e6 * end(timing.seconds) / CYCLES_AT_ONCE for end in (np.median, min, max))
        middle, low, high = map(float, spread)
        rows.append(Row(name, middle, "µs", TIME, low=low, high=high))
        rows.append(Row(name, timing.median_units / CYCLES_AT_ONCE, "FFTs", UNITS))
    one, eight, many = (1e6 * timing.median_s / CYCLES_AT_ONCE for timing in timings[:3])
    first_us = (eight - one) / (TRACKS[1] - TRACKS[0])
    later_us = (many - eight) / (TRACKS[2] - TRACKS[1])
    ratio = later_us / first_us if first_us > 0.0 else math.nan
    name = "one more of 8 to 32 over one more of 1 to 8"
    rows.append(Row(name, ratio, "times", TIME, LINEAR))
    return Section(
        "The mixer",
        "The table shows the CPU time of the mixer's thread for a cycle of 20 ms of 48 kHz stereo "
        "sound. The tracks are float tracks with full buffers; there are no effects and no sinks. "
        "Each additional track should have the same cost. The last row is a ratio: the cost of an "
        "additional track between 8 and 32 tracks, divided by its cost between 1 and 8 tracks.",
        tuple(rows),
    )
