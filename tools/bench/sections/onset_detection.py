"""Bench on onsets: how many of those that are there are found, how soon, and how many are not.

What is measured is what the live form births partials by (`transform/onsets.py`), tick by tick.
Recordings tell no onsets of their own, so onsets are planted in them: 10 dB over what sounds there.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import gcd

import numpy as np
from scipy.signal import resample_poly

from audioflinger_hook.transform import FloatArray, TransformParameters
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.live.transform import LiveTransform
from tools.bench.report import Must, Row, Section
from tools.bench.sounds.signals import (
    SAMPLERATE,
    chord,
    demo_sound,
)
from tools.bench.workbench import Workbench

REACH_S = 0.024
"""An onset is found where one is told within so long of it."""

F1 = Must(">=", 0.95)
ONSET_HZ = (80.0, 8_000.0)
LEVELS_DB = (-40.0, -6.0)
SPACING_S = (0.06, 1.0)
RISE_S, FALL_S = 0.001, 0.005
CLICK_S, HEARD_S = 0.001, 0.005
"""A click's length, and the time over which its level is taken."""
PLANTED_DB = 10.0
PLANTED_EVERY_S = 0.2
PLANTED_S = 0.05
AROUND_S = 0.05
"""What sounds where an onset is planted is the r.m.s. from so long before to so long after it."""
FAINTEST = 1e-3
"""Of full scale: an onset planted in silence is 10 dB over this."""
LONGEST_S = 3.0
"""So much of a recording is listened to."""
STEADY_S = 2.0
STEADY_FROM_S = 0.1
"""What begins with a steady sound is an onset, what comes later is not."""


@dataclass(frozen=True)
class Found:
    """How many onsets were there, were told, and were told within reach; and how late, s each."""

    there: int
    told: int
    hits: int
    late_s: tuple[float, ...]

    @property
    def precision(self) -> float:
        """Share of those told that were there."""
        return self.hits / self.told if self.told else float("nan")

    @property
    def recall(self) -> float:
        """Share of those there that were told."""
        return self.hits / self.there if self.there else float("nan")

    @property
    def f1(self) -> float:
        """The harmonic mean of both."""
        return 2.0 * self.hits / max(1, self.there + self.told)


def onset_times_s(sound: FloatArray) -> FloatArray:
    """Return when onsets are told in a sound (frames,) at 48 kHz, in seconds."""
    form = LiveTransform(LiveDesign.of(TransformParameters(), SAMPLERATE))
    onsets, detector = form.design.onsets, form._detector
    tick_frames, rest_ticks = form.design.grid.tick_frames, onsets.rest_ticks
    filtered = form._bandpass.process(sound)
    ticks = filtered.size // tick_frames
    past = onsets.short_frames - tick_frames
    joined = np.concatenate((np.zeros(past), filtered[: ticks * tick_frames]))
    windows = np.lib.stride_tricks.sliding_window_view(joined, onsets.short_frames)
    seen = detector.measure(
        windows[::tick_frames], filtered[: ticks * tick_frames].reshape(ticks, -1)
    )
    heard = [tick + 1 for tick in range(ticks) if detector.detect(seen, tick)]
    # What is told anew within the rest is the same onset.
    told = [tick for tick, last in zip(heard, [-rest_ticks, *heard], strict=False)
            if tick - last >= rest_ticks]  # fmt: skip
    return np.array(told, dtype=np.float64) * (tick_frames / SAMPLERATE)


def found(sound: FloatArray, onsets_s: FloatArray) -> Found:
    """Return how far the onsets told are those that are there, each told for one at most."""
    told = onset_times_s(sound)
    free = np.ones(told.size, dtype=bool)
    late = []
    for onset_s in onsets_s.tolist():
        away = np.where(free, np.abs(told - onset_s), np.inf)
        if away.size and away.min() <= REACH_S:
            nearest = int(away.argmin())
            free[nearest] = False
            late.append(float(told[nearest]) - onset_s)
    return Found(onsets_s.size, told.size, len(late), tuple(late))


def _spread(rng: np.random.Generator, bounds: tuple[float, float], count: int) -> FloatArray:
    """Return numbers spread evenly over a range by their logarithm."""
    spread: FloatArray = np.exp(rng.uniform(np.log(bounds[0]), np.log(bounds[1]), count))
    return spread


def onset_train(count: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return tones, clicks and bursts of noise amid silence, (frames,), and when each begins, s.

    Levels of -40 to -6 dBFS, 60 ms to 1 s apart; each sounds for a third to two thirds of that.
    """
    rng = np.random.default_rng(seed)
    gaps_s = _spread(rng, SPACING_S, count)
    starts = np.round((0.3 + np.cumsum(gaps_s) - gaps_s) * SAMPLERATE).astype(int)
    sound = np.zeros(int(starts[-1]) + 2 * SAMPLERATE)
    for which, (start, gap_s) in enumerate(zip(starts.tolist(), gaps_s.tolist(), strict=True)):
        level = 10 ** (rng.uniform(*LEVELS_DB) / 20)
        wave = level * _wave(which, gap_s * rng.uniform(1 / 3, 2 / 3), rng)
        sound[start : start + wave.size] += wave
    return sound, starts / SAMPLERATE


def planted(sound: FloatArray, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return a sound (frames,) with onsets planted in it 10 dB over it, and when they begin, s."""
    rng = np.random.default_rng(seed)
    mixed, starts_s = sound.copy(), []
    around = round(AROUND_S * SAMPLERATE)
    for which, at_s in enumerate(np.arange(0.1, sound.size / SAMPLERATE - 0.15, PLANTED_EVERY_S)):
        start = round((float(at_s) + rng.uniform(0.0, 0.05)) * SAMPLERATE)
        near = sound[max(0, start - around) : start + around]
        level = max(FAINTEST, float(np.sqrt(np.mean(near**2)))) * 10 ** (PLANTED_DB / 20)
        wave = _wave(which, PLANTED_S, rng)
        heard = max(wave.size, round(HEARD_S * SAMPLERATE))
        wave *= level / float(np.sqrt(np.sum(wave**2) / heard))
        mixed[start : start + wave.size] += wave
        starts_s.append(start / SAMPLERATE)
    return mixed, np.array(starts_s)


def _wave(kind: int, duration_s: float, rng: np.random.Generator) -> FloatArray:
    """Return a tone, a click, or a burst of noise, with a peak of about 1."""
    since_s = np.arange(round(duration_s * SAMPLERATE)) / SAMPLERATE
    swell = np.clip(since_s / RISE_S, 0.0, 1.0) * np.clip((duration_s - since_s) / FALL_S, 0.0, 1.0)
    if kind % 3 == 0:
        (frequency_hz,) = _spread(rng, ONSET_HZ, 1)
        tone: FloatArray = swell * np.sin(2.0 * np.pi * frequency_hz * since_s)
        return tone
    if kind % 3 == 1:
        return rng.uniform(-1.0, 1.0, round(CLICK_S * SAMPLERATE))
    noise: FloatArray = swell * rng.uniform(-1.0, 1.0, since_s.size)
    return noise


def steady_sounds() -> dict[str, FloatArray]:
    """Return sounds in which nothing begins after their start, each (frames,), by name."""
    time_s = np.arange(round(STEADY_S * SAMPLERATE)) / SAMPLERATE
    rng = np.random.default_rng(3)

    def tone(frequency_hz: float) -> FloatArray:
        wave: FloatArray = 0.3 * np.sin(2.0 * np.pi * frequency_hz * time_s)
        return wave

    def swelling(swell_hz: float) -> FloatArray:
        swell: FloatArray = tone(1_000.0) * (0.5 + 0.5 * np.sin(2.0 * np.pi * swell_hz * time_s))
        return swell

    octaves = 2.0**time_s
    return {
        "tones of 60 to 8 000 Hz": sum(
            (tone(hz) / 4.0 for hz in (60.0, 200.0, 1_000.0, 8_000.0)), np.zeros(time_s.size)
        ),
        "white noise": rng.uniform(-0.5, 0.5, time_s.size),
        "chord, its levels modulated": chord(STEADY_S)[:, 0].astype(np.float64),
        "chirp, an octave a second": 0.3
        * np.sin(2.0 * np.pi * 200.0 / np.log(2.0) * (octaves - 1.0)),
        "vibrato of 6 Hz": 0.3
        * np.sin(2.0 * np.pi * 1_000.0 * time_s + 8.0 * np.sin(2.0 * np.pi * 6.0 * time_s)),
        "level swelling from nothing at 4 Hz": swelling(4.0),
        "level swelling from nothing at 10 Hz": swelling(10.0),
        "level swelling from nothing at 30 Hz": swelling(30.0),
    }


def onsets_found(bench: Workbench) -> Section:
    """Precision and recall of onsets, made and planted; and what fires without one."""
    made = found(*onset_train(bench.effort.onsets_made, seed=1))
    rows = _rows("made", made)
    scene = demo_sound().astype(np.float64).mean(axis=1)
    hidden = [found(*planted(scene, seed=2))]
    hidden += [
        found(*planted(_at_48_khz(item.frames.astype(np.float64).mean(axis=1), item.samplerate), 4))
        for item in bench.recordings[: bench.effort.compared_recordings]
    ]
    rows += _planted_rows(hidden)
    for name, sound in steady_sounds().items():
        later = onset_times_s(sound) > STEADY_FROM_S
        rows.append(Row(f"told without one: {name}", float(later.sum()) / STEADY_S, "a second"))
    return Section(
        "Onsets found",
        f"What begins is told within {1e3 * REACH_S:g} ms or missed. Made: "
        f"{bench.effort.onsets_made} tones, clicks and bursts of noise of {LEVELS_DB[0]:g} to "
        f"{LEVELS_DB[1]:g} dBFS, {1e3 * SPACING_S[0]:g} ms to {SPACING_S[1]:g} s apart. Planted: "
        f"the like, {PLANTED_DB:g} dB over what sounds around them in the demo scene and in "
        "recordings, whose own onsets are there besides and nobody has written down: so only "
        "recall can be told. What is told of a steady sound only gives birth where partials lack.",
        tuple(rows),
    )


def _rows(name: str, one: Found) -> list[Row]:
    late_ms = 1e3 * np.array(one.late_s)
    return [
        Row(f"{name}: F1", one.f1, must=F1),
        Row(f"{name}: precision", one.precision),
        Row(f"{name}: recall", one.recall),
        Row(f"{name}: told after, median", float(np.median(late_ms)), "ms"),
        Row(f"{name}: told after, 95th percentile", float(np.percentile(late_ms, 95)), "ms"),
    ]


def _planted_rows(hidden: list[Found]) -> list[Row]:
    there, hits = sum(one.there for one in hidden), sum(one.hits for one in hidden)
    late_ms = 1e3 * np.array([late for one in hidden for late in one.late_s])
    note = f"{there} onsets, {len(hidden)} sounds"
    return [
        Row("planted: recall", hits / there, must=F1, note=note),
        Row("planted: told after, median", float(np.median(late_ms)), "ms"),
        Row("planted: told after, 95th percentile", float(np.percentile(late_ms, 95)), "ms"),
    ]


def _at_48_khz(mono: FloatArray, samplerate: int) -> FloatArray:
    mono = mono[: round(LONGEST_S * samplerate)]
    if samplerate == SAMPLERATE:
        return mono
    shared = gcd(SAMPLERATE, samplerate)
    resampled: FloatArray = resample_poly(mono, SAMPLERATE // shared, samplerate // shared)
    return resampled
