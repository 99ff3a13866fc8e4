"""Section on profiles: strength, lag and range with each, on the same sounds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.scenes.chord import chord
from audioflinger_hook.scenes.demo import DEMO_TRACKS
from audioflinger_hook.scenes.engine import engine
from audioflinger_hook.scenes.impacts import explosion
from audioflinger_hook.scenes.speech import speech as spoken_scene
from audioflinger_hook.transform import FloatArray, HapticTransform, TransformParameters
from tools.bench.measures.similarity import envelope_correlation
from tools.bench.report import Row, Section
from tools.bench.sections.fidelity import BURST_HZ, BURST_ONSET_S, burst_lag_s
from tools.bench.sounds.signals import SAMPLERATE, Recording, speech
from tools.bench.workbench import Subject, Workbench

TITLE = "Profiles"
BY_ENERGY = "by energy"
QUIETER_DB = -20.0
LOUDEST_SHARE = 0.1
AUDIBLE_DB = -60.0
"""A quieter unit of a recording counts as a pause."""
BURSTS, BURST_STREAM_S = 9, 0.8

SPEECH = "speech"
RANGE = "range of speech, median to loudest twentieth"


@dataclass(frozen=True)
class Way:
    """A profile, or an amplitude mapping on its own: its name and parameters."""

    name: str
    parameters: TransformParameters

    @property
    def subject(self) -> Subject:
        """What is measured."""
        return Subject(self.name, partial(HapticTransform, parameters=self.parameters))

    def felt(self, sound: FloatArray) -> FloatArray:
        """Return the vibration of (frames,) at 48 kHz, its latency taken out, (frames,)."""
        transform = HapticTransform(SAMPLERATE, 1, self.parameters)
        vibration = np.concatenate((transform.process(sound[:, None]), transform.finish()))
        return vibration[transform.latency_frames :, 0]

    def settled(self, sound: FloatArray, settled_s: float) -> FloatArray:
        """Return the vibration of a sound after it has been repeated for that long."""
        times = round(settled_s * SAMPLERATE / sound.size) if self.parameters.loudness_db else 0
        felt = self.felt(np.resize(sound, (times + 1) * sound.size))
        return felt[times * sound.size :]


def ways() -> tuple[Way, ...]:
    """Return the profile `paper`, the mapping by energy alone, and all other profiles."""
    profiles = tuple(Way(name, parameters_of(name)) for name in PROFILES)
    by_energy = Way(BY_ENERGY, TransformParameters(amplitude_mapping="energy"))
    return profiles[0], by_energy, *profiles[1:]


def profiles(bench: Workbench) -> Section:
    """Level, lag, similarity and range of every profile."""
    sounds, settled_s = sounds_of(bench.recordings), bench.effort.settled_s
    rows = [
        *_level_rows(sounds, settled_s),
        Row(RANGE, _range_db(sounds[SPEECH]), "dB", "in"),
    ]
    for way in ways():
        latency_s = HapticTransform(SAMPLERATE, 1, way.parameters).latency_s
        felt = {name: way.settled(sound, settled_s) for name, sound in sounds.items()}
        alike = [envelope_correlation(sounds[name], felt[name], SAMPLERATE) for name in sounds]
        measured = {
            "latency": (1e3 * latency_s, "ms"),
            "onset lag, mean": (1e3 * _mean_lag_s(way), "ms"),
            "envelope correlation, median sound": (float(np.median(alike)), ""),
            RANGE: (_range_db(felt[SPEECH]), "dB"),
        }
        rows += [Row(name, value, unit, way.name) for name, (value, unit) in measured.items()]
    missing = () if bench.recordings else (bench.missing_recordings("spoken recordings"),)
    return Section(
        TITLE,
        "Level of the loudest tenth of the 46 ms units in sound and vibration. 0 dB is a sine of "
        f"full scale. Volumes are full and 20 dB lower, after {settled_s:g} s. *By energy* "
        "is that amplitude mapping without the loudness follower of the other profiles.",
        tuple(rows),
        missing,
        footnote=f"Sounds: the demo's own{'' if missing else ', and spoken recordings as speech'}.",
    )


def _level_rows(sounds: dict[str, FloatArray], settled_s: float) -> Iterator[Row]:
    """Yield the loudest tenths in and out at two volumes."""
    for name, sound in sounds.items():
        for volume_db in (0.0, QUIETER_DB):
            title = f"{name}, loudest tenth" + (f", {volume_db:g} dB" if volume_db else "")
            played = 10.0 ** (volume_db / 20.0) * sound
            yield Row(title, loudest_db(played), "dB", "in")
            for way in ways():
                yield Row(title, loudest_db(way.settled(played, settled_s)), "dB", way.name)


def sounds_of(recordings: tuple[Recording, ...]) -> dict[str, FloatArray]:
    """Return the sounds by name, (frames,) float64 at 48 kHz: the demo's; recorded speech."""
    makers: dict[str, Callable[..., np.ndarray]] = {
        "explosion": explosion,
        "engine": engine,
        "chord": chord,
        "spoken scene": spoken_scene,
    }
    peaks = {track.name: track.peak for track in DEMO_TRACKS} | {"spoken scene": 0.42}
    sounds = {
        name: make(SAMPLERATE, np.random.default_rng(1), peaks[name])
        .mean(axis=1)
        .astype(np.float64)
        for name, make in makers.items()
    }
    spoken = speech(recordings)
    sounds[SPEECH] = sounds["spoken scene"] if spoken is None else spoken[:, 0].astype(np.float64)
    return sounds


def units_db(signal: FloatArray) -> FloatArray:
    """Return the level of every whole unit of 46 ms, a full-scale sine at 0 dB."""
    frames = TransformParameters().window_frames(SAMPLERATE)
    whole = signal[: signal.size - signal.size % frames].reshape(-1, frames)
    levels: FloatArray = 10.0 * np.log10(2.0 * (whole**2).mean(axis=1) + 1e-20)
    return levels


def loudest_db(signal: FloatArray) -> float:
    """Return the level of the loudest tenth of a signal's units."""
    levels = np.sort(units_db(signal))
    loudest = levels[-max(1, round(LOUDEST_SHARE * levels.size)) :]
    return float(10.0 * np.log10((10.0 ** (loudest / 10.0)).mean()))


def _mean_lag_s(way: Way) -> float:
    places = np.random.default_rng(4).permutation(BURSTS) / BURSTS
    bursts = zip(np.geomspace(*BURST_HZ, BURSTS).tolist(), places.tolist(), strict=True)
    stream_s = BURST_ONSET_S + BURST_STREAM_S
    return float(np.mean([burst_lag_s(way.subject, hz, place, stream_s) for hz, place in bursts]))


def _range_db(signal: FloatArray) -> float:
    levels = units_db(signal)
    audible = levels[levels > AUDIBLE_DB]
    return float(np.percentile(audible, 95) - np.percentile(audible, 50))
