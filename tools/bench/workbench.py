"""What every bench is given: how much effort to spend, which forms to measure, and on what."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

from audioflinger_hook.transform import FloatArray, Frames, HapticTransform, kernel_warning
from tools.bench.report import Missing, Section
from tools.bench.sounds.signals import RECORDINGS_COMMAND, SAMPLERATE, Recording

LIVE, TWIN, REFERENCE = "live", "live in NumPy", "reference"

BUILD_COMMAND = "rm -rf .venv && make run"


class Stream(Protocol):
    """One stream through anything that turns sound into vibration."""

    def process(self, frames: Frames) -> FloatArray:
        """Return (frames, channels_out) of vibration for (frames, channels) of sound."""
        ...

    def finish(self) -> FloatArray:
        """Return the vibration still owed."""
        ...


@dataclass(frozen=True)
class Subject:
    """Something that is measured: its name in the tables, and how a stream of it begins.

    start: (samplerate in Hz, channels) to a new stream.
    """

    name: str
    start: Callable[[int, int], Stream]

    def vibration(self, sound: Frames, samplerate: int) -> FloatArray:
        """Return the vibration of a whole sound, (frames,), late as it comes out."""
        frames = sound if sound.ndim == 2 else sound[:, None]
        return self.start(samplerate, frames.shape[1]).process(frames)[:, 0]


class Playback:
    """A sound for a subject, again and again: `open` a new stream, then `play` it, block by block.

    sound: (frames, channels). So what it costs to open a stream is no part of what is timed.
    """

    def __init__(self, subject: Subject, sound: Frames, blocksize: int) -> None:
        self._subject = subject
        self._sound = sound
        self._blocksize = blocksize
        self.open()

    def open(self) -> None:
        """Begin a new stream."""
        self._stream = self._subject.start(SAMPLERATE, self._sound.shape[1])

    def play(self) -> None:
        """Pass the whole sound through the stream."""
        for first in range(0, len(self._sound), self._blocksize):
            self._stream.process(self._sound[first : first + self._blocksize])


SUBJECTS: tuple[Subject, ...] = (
    Subject(LIVE, partial(HapticTransform, form="live")),
    Subject(REFERENCE, partial(HapticTransform, form="reference")),
)
"""What is compared, side by side; the first is what the limits are asked of."""

SPEED_SUBJECTS: tuple[Subject, ...] = (
    SUBJECTS[0],
    Subject(TWIN, partial(HapticTransform, form="live", implementation="numpy")),
    SUBJECTS[1],
)
"""What is compared in speed: the live form compiled, what stands in for it, and the reference."""


def speed_subjects() -> tuple[Subject, ...]:
    """Return `SPEED_SUBJECTS`, without the first where it is not compiled and so is the second."""
    return SPEED_SUBJECTS if kernel_warning() is None else SPEED_SUBJECTS[1:]


def not_compiled(name: str) -> tuple[Missing, ...]:
    """Return what to say where a row is of the compiled live form and there is none."""
    why = kernel_warning()
    return () if why is None else (Missing(f"{name}, {LIVE}, compiled", why, BUILD_COMMAND),)


@dataclass(frozen=True)
class Effort:
    """How much is measured: counts, and durations in seconds. More narrows the spread.

    slow_repeats: of everything but the compiled live form; saving_s: of each sound that savings
    are tried on, in NumPy; rig_timed_s: of the drives that the ladder, and what protects a rig,
    are timed on.
    """

    tones: int
    low_tones: int
    tone_s: float
    gain_tones: int
    bursts: int
    onsets_a_burst: int
    onsets_made: int
    noisy_tones: int
    frontier_sounds: int
    compared_bursts: int
    compared_recordings: int
    settled_s: float
    split_s: float
    cost_repeats: int
    slow_repeats: int
    cost_s: float
    cold_s: float
    saving_repeats: int
    saving_s: float
    mix_rounds: int
    mix_repeats: int
    growth_s: float
    channels_s: float
    hops_timed: int
    hops_timed_in_numpy: int
    hops_held: int
    render_s: tuple[float, ...]
    rig_s: float
    rig_timed_s: float
    rung_repeats: int
    integrator_repeats: int
    random_rigs: int

    def repeats_of(self, subject: Subject) -> int:
        """Return how often a subject is timed: what is not compiled costs some ten times more."""
        return self.cost_repeats if subject.name == LIVE else self.slow_repeats


QUICK = Effort(
    tones=6,
    low_tones=3,
    tone_s=3.0,
    gain_tones=8,
    bursts=25,
    onsets_a_burst=4,
    onsets_made=30,
    noisy_tones=100,
    frontier_sounds=2,
    compared_bursts=9,
    compared_recordings=3,
    settled_s=3.0,
    split_s=0.2,
    cost_repeats=3,
    slow_repeats=1,
    cost_s=0.5,
    cold_s=0.4,
    saving_repeats=1,
    saving_s=1.0,
    mix_rounds=15,
    mix_repeats=1,
    growth_s=8.0,
    channels_s=1.0,
    hops_timed=3_000,
    hops_timed_in_numpy=1_000,
    hops_held=5_000,
    render_s=(60.0,),
    rig_s=4.0,
    rig_timed_s=0.5,
    rung_repeats=3,
    integrator_repeats=2,
    random_rigs=3,
)
FULL = Effort(
    tones=40,
    low_tones=16,
    tone_s=4.0,
    gain_tones=24,
    bursts=40,
    onsets_a_burst=16,
    onsets_made=150,
    noisy_tones=400,
    frontier_sounds=8,
    compared_bursts=30,
    compared_recordings=31,
    settled_s=10.0,
    split_s=4.0,
    cost_repeats=15,
    slow_repeats=5,
    cost_s=6.0,
    cold_s=4.0,
    saving_repeats=3,
    saving_s=3.0,
    mix_rounds=400,
    mix_repeats=9,
    growth_s=64.0,
    channels_s=4.0,
    hops_timed=30_000,
    hops_timed_in_numpy=2_000,
    hops_held=100_000,
    render_s=(60.0, 600.0),
    rig_s=60.0,
    rig_timed_s=10.0,
    rung_repeats=7,
    integrator_repeats=5,
    random_rigs=40,
)


@dataclass(frozen=True)
class Workbench:
    """The effort, the subjects and the recordings of one run.

    absent: why some recordings are not among them, by name.
    """

    effort: Effort
    subjects: tuple[Subject, ...]
    recordings: tuple[Recording, ...]
    absent: Mapping[str, str] = field(default_factory=dict)

    def subject(self, name: str) -> Subject:
        """Return the subject of that name."""
        return {subject.name: subject for subject in self.subjects}[name]

    def missing_recordings(self, name: str) -> Missing:
        """Return what to say where a row needs recordings and there are none."""
        return Missing(name, "there are no recordings to measure it on", RECORDINGS_COMMAND)


Bench = Callable[[Workbench], Section]
"""One section of the report: measured when called."""
