"""What all sections share: measured methods, amount of measurement, recordings, CPU times."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

from audioflinger_hook.transform import FloatArray, Frames, HapticTransform
from tools.bench.cost import Timings, in_ffts, interleaved
from tools.bench.report import Missing, Must, Row, Section
from tools.bench.sounds.signals import RECORDINGS_COMMAND, SAMPLERATE, Recording

LIVE, REFERENCE = "live", "reference"


class Stream(Protocol):
    """A method of converting sound to vibration, applied block by block."""

    def process(self, frames: Frames) -> FloatArray:
        """Return the vibration (frames, channels_out) of a block of sound (frames, channels)."""
        ...

    def finish(self) -> FloatArray:
        """Return the last frames of the vibration, which the latency has delayed."""
        ...


@dataclass(frozen=True)
class Subject:
    """A method that the benchmarks measure.

    name: heading of the method's column.
    start: function of a sample rate in Hz and a number of channels that returns a stream.
    """

    name: str
    start: Callable[[int, int], Stream]

    def vibration(self, sound: Frames, samplerate: int) -> FloatArray:
        """Return the first channel of the vibration, (frames,); the latency is not removed."""
        frames = sound if sound.ndim == 2 else sound[:, None]
        return self.start(samplerate, frames.shape[1]).process(frames)[:, 0]


class Playback:
    """Passes a sound (frames, channels) in blocks through a stream of a measured method."""

    def __init__(self, subject: Subject, sound: Frames, blocksize: int) -> None:
        self._subject = subject
        self._sound = sound
        self._blocksize = blocksize
        self.open()

    def open(self) -> None:
        """Open a new stream."""
        self._stream = self._subject.start(SAMPLERATE, self._sound.shape[1])

    def play(self) -> None:
        """Pass the whole sound through the stream."""
        for first in range(0, len(self._sound), self._blocksize):
            self._stream.process(self._sound[first : first + self._blocksize])


def timed(playbacks: Sequence[Playback], repeats: int | Sequence[int]) -> list[Timings]:
    """Time the playbacks in turn and return their timings. Opening the streams is not timed."""
    return interleaved(
        [each.play for each in playbacks], repeats, [each.open for each in playbacks]
    )


def cost_rows(
    name: str, column: str, timings: Timings, duration_s: float, limit_ms: float | None = None
) -> list[Row]:
    """Return the CPU time for one second of sound as two rows: in ms, and in units of one FFT.

    timings: timings of a whole sound.
    duration_s: duration of this sound.
    limit_ms: upper limit of the CPU time for one second of sound.
    """
    middle = 1e3 * timings.median_s / duration_s
    low = high = None
    if len(timings.seconds) > 1:
        low, high = (1e3 * end(timings.seconds) / duration_s for end in (min, max))
    must = must_ffts = None
    if limit_ms is not None:
        must, must_ffts = Must("<=", limit_ms), Must("<=", in_ffts(1e-3 * limit_ms))
    ffts = f"{column}, FFTs"
    return [
        Row(name, middle, "ms", column, must, low=low, high=high, ffts_column=ffts),
        Row(name, round(timings.median_units / duration_s), "FFTs", ffts, must_ffts),
    ]


SUBJECTS: tuple[Subject, ...] = (
    Subject(LIVE, partial(HapticTransform, form="live")),
    Subject(REFERENCE, partial(HapticTransform, form="reference")),
)


@dataclass(frozen=True)
class Effort:
    """Amount of measurement: numbers of sounds and repeats, and durations in s.

    The defaults are for quick runs.

    slow_repeats: number of timings of each method except the live form.
    saving_s: duration of each sound in the section about savings.
    rig_timed_s: duration of the drive signals in timings of the rig.
    real_sounds, exported: upper limit of the number of sounds of each class.
    films: number of films of each kind.
    sitters: number of simulated people of each kind.
    catalogue_shared: duration in s and number of the files that two workers share.
    """

    tones: int = 4
    low_tones: int = 2
    tone_s: float = 2.0
    bursts: int = 20
    onsets_a_burst: int = 3
    noisy_tones: int = 80
    frontier_sounds: int = 2
    compared_bursts: int = 9
    compared_recordings: int = 3
    settled_s: float = 2.0
    cost_repeats: int = 3
    slow_repeats: int = 1
    cost_s: float = 0.5
    cold_s: float = 0.4
    saving_repeats: int = 5
    saving_s: float = 0.5
    mix_rounds: int = 10
    scaling_s: float = 4.0
    channels_s: float = 1.0
    hops_timed: int = 2_000
    render_s: tuple[float, ...] = (60.0,)
    catalogue_s: tuple[float, ...] = (1.0, 60.0)
    catalogue_shared: tuple[float, int] = (20.0, 16)
    rig_s: float = 3.0
    rig_timed_s: float = 0.5
    model_repeats: int = 3
    integrator_repeats: int = 1
    real_sounds: int = 3
    films: int = 1
    exported: int = 1
    sitters: int = 20

    def repeats_of(self, subject: Subject) -> int:
        """Return how often a method is timed."""
        return self.cost_repeats if subject.name == LIVE else self.slow_repeats


QUICK = Effort()
FULL = Effort(
    tones=40, low_tones=16, tone_s=4.0, bursts=40, onsets_a_burst=16,
    noisy_tones=400, frontier_sounds=8, compared_bursts=30,
    compared_recordings=31, settled_s=10.0, cost_repeats=15, slow_repeats=5,
    cost_s=6.0, cold_s=4.0, saving_repeats=31, saving_s=3.0, mix_rounds=400,
    scaling_s=64.0, channels_s=4.0, hops_timed=30_000,
    render_s=(60.0, 600.0), rig_s=60.0, rig_timed_s=10.0, model_repeats=7, integrator_repeats=5,
    real_sounds=99, films=20, exported=99, catalogue_s=(1.0, 60.0, 3_600.0),
    catalogue_shared=(60.0, 32), sitters=200,
)  # fmt: skip


@dataclass(frozen=True)
class Workbench:
    """What a section needs to measure: amount of measurement, methods and recordings.

    absent: names of missing or unreadable recordings, each with the reason.
    """

    effort: Effort
    subjects: tuple[Subject, ...]
    recordings: tuple[Recording, ...]
    absent: Mapping[str, str] = field(default_factory=dict)

    def subject(self, name: str) -> Subject:
        """Return the method with this name."""
        return {subject.name: subject for subject in self.subjects}[name]

    def missing_recordings(self, name: str) -> Missing:
        """Return an entry for a row that is missing because there are no recordings."""
        return Missing(name, "there are no recordings to measure it on", RECORDINGS_COMMAND)


Bench = Callable[[Workbench], Section]  # a function that measures one section of the report
