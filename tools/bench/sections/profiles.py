"""Section "Profiles": level, range of levels, and lag of the vibration with each profile."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.scenes.demo import DEMO_TRACKS
from audioflinger_hook.scenes.sounds import chord, engine, explosion
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
AUDIBLE_DB = -60.0  # dB relative to a full-scale sine; quieter pieces of a recording are pauses
BURSTS, BURST_STREAM_S = 9, 0.8

SPEECH = "speech"
RANGE = "range of speech, median to loudest twentieth"


@dataclass(frozen=True)
class Way:
    """Parameters of the transform: those of a profile, or of `paper` with one change."""

    name: str
    parameters: TransformParameters

    @property
    def subject(self) -> Subject:
        """The transform with these parameters, as a measured method."""
        return Subject(self.name, partial(HapticTransform, parameters=self.parameters))

    def felt(self, sound: FloatArray) -> FloatArray:
        """Return the vibration of a sound at 48 kHz without latency, both (frames,)."""
        transform = HapticTransform(SAMPLERATE, 1, self.parameters)
        vibration = np.concatenate((transform.process(sound[:, None]), transform.finish()))
        return vibration[transform.latency_frames :, 0]

    def settled(self, sound: FloatArray, settled_s: float) -> FloatArray:
        """Return the vibration of a sound after loudness control has settled.

        A profile with loudness control first receives repetitions of the sound for about
        `settled_s` s.
        """
        times = round(settled_s * SAMPLERATE / sound.size) if self.parameters.loudness_db else 0
        felt = self.felt(np.resize(sound, (times + 1) * sound.size))
        return felt[times * sound.size :]


def ways() -> tuple[Way, ...]:
    """Return all profiles, and `paper` with its amplitude mapping changed to "energy"."""
    profiles = tuple(Way(name, parameters_of(name)) for name in PROFILES)
    by_energy = Way(BY_ENERGY, TransformParameters(amplitude_mapping="energy"))
    return profiles[0], by_energy, *profiles[1:]


def profiles(bench: Workbench) -> Section:
    """Measure level, lag, similarity and range of levels of the vibration with each profile."""
    sounds, settled_s = sounds_of(bench.recordings), bench.effort.settled_s
    rows = [*_level_rows(sounds, settled_s), Row(RANGE, _range_db(sounds[SPEECH]), "dB", "in")]
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
        "The sound (*in*) and its vibration with each profile are divided into units of 46 ms. "
        "Rows with *loudest tenth* show the mean level of the loudest tenth of these units. A "
        "sine of full scale has a level of 0 dB. In rows with *-20 dB*, the sound is 20 dB "
        f"softer. Before the measurement, the sound is repeated for {settled_s:g} s, so that "
        "loudness control adapts. The column *by energy* is for the profile `paper` with "
        '`amplitude_mapping = "energy"`.',
        tuple(rows),
        missing,
        footnote="Sounds: tracks of the demo scene"
        f"{'' if missing else '; the sound *speech* consists of spoken recordings'}.",
    )


def _level_rows(sounds: dict[str, FloatArray], settled_s: float) -> Iterator[Row]:
    for name, sound in sounds.items():
        for volume_db in (0.0, QUIETER_DB):
            title = f"{name}, loudest tenth" + (f", {volume_db:g} dB" if volume_db else "")
            played = 10.0 ** (volume_db / 20.0) * sound
            yield Row(title, loudest_db(played), "dB", "in")
            for way in ways():
                yield Row(title, loudest_db(way.settled(played, settled_s)), "dB", way.name)


def sounds_of(recordings: tuple[Recording, ...]) -> dict[str, FloatArray]:
    """Return tracks of the demo scene, and speech, by name, (frames,) float64 at 48 kHz."""
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
    """Return the level of each complete piece of 46 ms, in dB relative to a full-scale sine."""
    frames = TransformParameters().window_frames(SAMPLERATE)
    whole = signal[: signal.size - signal.size % frames].reshape(-1, frames)
    levels: FloatArray = 10.0 * np.log10(2.0 * (whole**2).mean(axis=1) + 1e-20)
    return levels


def loudest_db(signal: FloatArray) -> float:
    """Return the mean level in dB of the loudest tenth of the pieces of 46 ms."""
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
