"""Measurements in the audio threads: levels, and computing times of buffers."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.service.figure import figure
from device.units import Float32Array, FloatArray, amplitude_to_db

FLOOR_DBFS = -150.0  # lowest reported level, also for silence
RMS_TIME_S = 0.3  # time constant of the RMS
PEAK_FALL_DB_PER_S = 20.0  # decay rate of a displayed peak

GATHERED_S = 0.06  # shortest measured block; longer blocks need less CPU time
SHORTEST_S = 1e-6  # upper edge of the first bin of computing times
LONGEST_S = 10.0  # about the upper edge of the last bin, which also counts longer times
STEP = 1.04  # ratio of the edges of a bin, which limits the error of percentiles to 4 %
BINS = math.ceil(math.log(LONGEST_S / SHORTEST_S) / math.log(STEP)) + 1
_BINS_PER_E = 1.0 / math.log(STEP)
TIME_BOUNDS_S = (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2)  # bins for Prometheus
_BOUND_BINS = [math.ceil(math.log(bound / SHORTEST_S) * _BINS_PER_E) for bound in TIME_BOUNDS_S]
_BELOW = math.pow(10.0, (FLOOR_DBFS - 1.0) / 20.0)


@dataclass(frozen=True)
class Level:
    """Peak and RMS in dBFS. A square wave of amplitude 1 has 0 dBFS."""

    peak_dbfs: float = figure("peak", FLOOR_DBFS, metric="cushion_level_peak_ratio{^signal}")
    rms_dbfs: float = figure("RMS", FLOOR_DBFS, metric="cushion_level_rms_ratio{^signal}")


Reading = tuple[float, float]  # peak and mean square, 1.0 for full scale


class LevelMeter:
    """Measures peak and RMS of a signal, of all channels together and of each channel.

    The peak rises immediately, and falls by 20 dB per second of signal. The RMS has a time constant
    of 0.3 s. Blocks with non-finite samples are ignored. One thread calls `add` and `reset`. Any
    thread may call the other methods.
    """

    def __init__(self, samplerate: float) -> None:
        self._rms_rate = -1.0 / (RMS_TIME_S * samplerate)
        self._fall_rate = -PEAK_FALL_DB_PER_S * math.log(10.0) / (20.0 * samplerate)
        # Peaks and mean squares are one object, so other threads read consistent values.
        self._of_channels: tuple[FloatArray, FloatArray] = (np.zeros(1), np.zeros(1))

    def add(self, block: Float32Array) -> float:
        """Measure a block of shape (frames, channels) or (frames,); return its peak."""
        if not block.size:
            return 0.0
        block = block.reshape(len(block), -1)
        peaks = np.maximum(block.max(axis=0), -block.min(axis=0)).astype(np.float64)
        squares = np.einsum("ij,ij->j", block, block, dtype=np.float64) / len(block)
        loudest = float(peaks.max())
        if not math.isfinite(loudest + float(squares.sum())):
            return loudest
        held, mean = self._of_channels
        if held.size != peaks.size:
            held, mean = np.full(peaks.size, held.max()), np.full(peaks.size, mean.mean())
        keep = math.exp(len(block) * self._rms_rate)
        held = np.maximum(peaks, math.exp(len(block) * self._fall_rate) * held)
        mean = keep * mean + (1.0 - keep) * squares
        # Values below the floor become 0, since subnormal numbers are slow.
        held = np.where(held > _BELOW, held, 0.0)
        self._of_channels = (held, np.where(mean > _BELOW**2, mean, 0.0))
        return loudest

    def reset(self) -> None:
        """Restart with silence."""
        self._of_channels = (np.zeros(1), np.zeros(1))

    def level(self) -> Level:
        """Return the current level, at least FLOOR_DBFS."""
        return level_of(*self.reading())

    def reading(self) -> Reading:
        """Return the current peak and mean square."""
        held, mean = self._of_channels
        return float(held.max()), float(mean.mean())

    def channel_readings(self) -> list[Reading]:
        """Return the current peak and mean square of each channel."""
        held, mean = self._of_channels
        return list(zip(held.tolist(), mean.tolist(), strict=True))


class BufferedLevelMeter:
    """A level meter that gathers frames into blocks of at least 60 ms.

    One thread calls `add` and `reset`. Any thread may read `meter`. loudest: peak of the latest
    measured block. measured: whether the latest `add` completed a block.
    """

    def __init__(self, samplerate: int) -> None:
        self.meter = LevelMeter(samplerate)
        self.loudest = 0.0
        self.measured = False
        self._frames_least = max(1, round(GATHERED_S * samplerate))
        self._blocks: list[Float32Array] = []
        self._frames = 0

    def add(self, frames: Float32Array) -> None:
        """Append an array (frames, channels), which must not change afterwards."""
        self._blocks.append(frames)
        self._frames += len(frames)
        self.measured = self._frames >= self._frames_least
        if self.measured:
            self.loudest = self.meter.add(np.concatenate(self._blocks))
            self._blocks, self._frames = [], 0

    def reset(self) -> None:
        """Restart with silence."""
        self._blocks, self._frames = [], 0
        self.loudest = 0.0
        self.meter.reset()


@dataclass(frozen=True)
class BufferTimes:
    """Computing times of buffers; 0 before the first buffer."""

    p50_ms: float = figure("median", 0.0)
    p99_ms: float = figure("99th percentile", 0.0)
    max_ms: float = figure("longest", 0.0)
    buffer_ms: float = figure("playing time of the last buffer", 0.0)
    share_percent: float = figure("computing time as a share of playing time", 0.0)
    counts: tuple[int, ...] = figure("buffers under each of `TIME_BOUNDS_S`, then all", ())
    busy_s: float = figure("sum of all", 0.0, show="")
    late: int = figure(
        "buffers that took longer to compute than to play",
        0,
        quiet=0,
        tone="wait",
        metric="cushion_late_callbacks",
    )


class BufferClock:
    """Histogram of computing times. One thread calls `add`; any thread may call `times`."""

    def __init__(self) -> None:
        self._counts = [0] * BINS
        self._max_s = self._busy_s = self._played_s = self._buffer_s = 0.0
        self._late = 0

    def add(self, busy_s: float, buffer_s: float) -> None:
        """Count a buffer with computing time `busy_s` and playing time `buffer_s` in s."""
        busy_s = max(0.0, busy_s)
        ratio = min(busy_s, LONGEST_S) / SHORTEST_S
        index = math.ceil(math.log(ratio) * _BINS_PER_E) if ratio > 1.0 else 0
        self._counts[min(index, BINS - 1)] += 1
        self._max_s = max(self._max_s, busy_s)
        self._busy_s += busy_s
        self._played_s += buffer_s
        self._buffer_s = buffer_s
        self._late += busy_s > buffer_s

    def times(self) -> BufferTimes:
        """Return statistics since the start. Percentiles above 1 µs are up to 4 % too high."""
        counted = np.cumsum(self._counts)
        longest_s = self._max_s
        if not counted[-1]:
            return BufferTimes()
        return BufferTimes(
            p50_ms=1e3 * min(longest_s, _percentile_s(counted, 0.50)),
            p99_ms=1e3 * min(longest_s, _percentile_s(counted, 0.99)),
            max_ms=1e3 * longest_s,
            buffer_ms=1e3 * self._buffer_s,
            share_percent=100.0 * self._busy_s / self._played_s if self._played_s else 0.0,
            counts=(*(int(counted[last]) for last in _BOUND_BINS), int(counted[-1])),
            busy_s=self._busy_s,
            late=self._late,
        )


def level_of(peak: float, square: float) -> Level:
    """Return the level for a peak and a mean square (full scale 1), at least FLOOR_DBFS."""
    return Level(*(max(FLOOR_DBFS, amplitude_to_db(one)) for one in (peak, math.sqrt(square))))


def _percentile_s(counted: NDArray[np.int_], share: float) -> float:
    """Return a percentile in seconds, rounded up to the upper edge of its bin. share: 0 to 1."""
    index = int(np.searchsorted(counted, math.ceil(share * int(counted[-1]))))
    return SHORTEST_S * STEP**index if index < BINS - 1 else math.inf
