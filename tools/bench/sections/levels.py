"""Section on level: how strong a sound is felt with each amplitude mapping and profile."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.scenes.chord import chord
from audioflinger_hook.scenes.demo import DEMO_TRACKS
from audioflinger_hook.scenes.engine import engine
from audioflinger_hook.scenes.impacts import explosion
from audioflinger_hook.scenes.speech import speech as spoken_scene
from audioflinger_hook.transform import FloatArray, HapticTransform, TransformParameters
from tools.bench.measures.similarity import level_db
from tools.bench.report import Row, Section
from tools.bench.sounds.signals import SAMPLERATE, Recording, speech
from tools.bench.workbench import Subject, Workbench

TITLE = "Level"
BY_ENERGY = "by energy"
QUIETER_DB = -20.0
LOUDEST_SHARE = 0.1
AUDIBLE_DB = -60.0
"""A quieter unit of a recording counts as a pause."""
NOT_FELT_DB = -90.0
MOMENTARY_S, STEP_S = 0.4, 0.1
"""Momentary loudness of EBU Tech 3341."""
FELT_SAME_DB = 1.0
"""Smallest change of strength that is felt."""

HEARD = "heard"
EXPLOSION, SPEECH = "explosion", "speech"
CONTRAST = "explosion over speech"
SILENT = "silent units at -20 dB"
SETTLES = "felt the same again after -20 dB"
SETTLED_DIFFERENCE = "the same programme 20 dB lower, settled"


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
    return profiles[0], Way(BY_ENERGY, TransformParameters(level_law="energy")), *profiles[1:]


def level(bench: Workbench) -> Section:
    """Loudest tenths in and out, explosion against speech, and the effect of the volume."""
    sounds, settled_s = sounds_of(bench.recordings), bench.effort.settled_s
    rows: list[Row] = []
    silent: dict[str, list[NDArray[np.bool_]]] = {way.name: [] for way in ways()}
    for name, sound in sounds.items():
        for volume_db in (0.0, QUIETER_DB):
            title = f"{name}, loudest tenth{_at(volume_db)}"
            volume = 10.0 ** (volume_db / 20.0)
            rows.append(Row(title, loudest_db(volume * sound), "dB", "in"))
            for way in ways():
                felt = way.settled(volume * sound, settled_s)
                rows.append(Row(title, loudest_db(felt), "dB", way.name))
                if volume_db < 0.0:
                    audible = units_db(sound) > AUDIBLE_DB
                    silent[way.name].append(units_db(felt)[audible] < NOT_FELT_DB)
    rows += _contrast_rows(sounds, settled_s)
    for way_name, units in silent.items():
        rows.append(Row(SILENT, 100.0 * float(np.concatenate(units).mean()), "%", way_name))
    rows += _volume_rows(sounds[SPEECH], settled_s)
    missing = () if bench.recordings else (bench.missing_recordings("level of spoken recordings"),)
    return Section(
        TITLE,
        "Level of the loudest tenth of the 46 ms units in sound and vibration (0 dB: full-scale "
        f"sine), at full volume and 20 dB lower, after {settled_s:g} s of the sound. *By energy* "
        "is that amplitude mapping without the loudness follower of the other profiles. Explosion "
        "over speech: the loudest 0.4 s of an explosion against the speech before it; heard, as "
        "K-weighted loudness (BS.1770) in phon. The follower aims at a quarter of that, in `music` "
        "at a half, which is how people match strength to loudness. Silent units: the share of "
        "audible units that are not felt at all.",
        tuple(rows),
        missing,
        footnote=f"Sounds: the demo's own{'' if missing else ', and spoken recordings as speech'}. "
        f"Felt the same: within {FELT_SAME_DB:g} dB, in pieces of 2 s.",
    )


def sounds_of(recordings: tuple[Recording, ...]) -> dict[str, FloatArray]:
    """Return the sounds by name, (frames,) float64 at 48 kHz: the demo's; recorded speech."""
    makers: dict[str, Callable[..., np.ndarray]] = {
        EXPLOSION: explosion,
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


def k_weighted(sound: FloatArray) -> FloatArray:
    """Return sound at 48 kHz through the two filters that BS.1770-4 prints."""
    shelf_b = [1.53512485958697, -2.69169618940638, 1.19839281085285]
    shelf = lfilter(shelf_b, [1.0, -1.69065929318241, 0.73248077421585], sound)
    passed: FloatArray = lfilter(
        [1.0, -2.0, 1.0], [1.0, -1.99004745483398, 0.99007225036621], shelf
    )
    return passed


def momentary_db(signal: FloatArray) -> FloatArray:
    """Return the level of every 0.4 s, at steps of 0.1 s."""
    frames, step = round(MOMENTARY_S * SAMPLERATE), round(STEP_S * SAMPLERATE)
    energy = np.concatenate(([0.0], np.cumsum(signal**2)))
    first = np.arange(0, signal.size - frames, step)
    levels: FloatArray = 10.0 * np.log10(
        2.0 * (energy[first + frames] - energy[first]) / frames + 1e-20
    )
    return levels


def _at(volume_db: float) -> str:
    return f", {volume_db:g} dB" if volume_db else ""


def _contrast_rows(sounds: dict[str, FloatArray], settled_s: float) -> list[Row]:
    rows = []
    for name in (SPEECH, "spoken scene"):
        before = np.resize(sounds[name], round(settled_s * SAMPLERATE))
        programme = np.concatenate((before, sounds[EXPLOSION]))
        boundary = round(settled_s / STEP_S)

        def stands_db(signal: FloatArray, boundary: int = boundary) -> float:
            levels = momentary_db(signal)
            talk = np.sort(levels[boundary // 2 : boundary - 4])
            loudest = talk[-max(1, round(LOUDEST_SHARE * talk.size)) :]
            return float(levels[boundary - 1 :].max() - loudest.mean())

        for volume_db in (0.0, QUIETER_DB):
            title = f"{CONTRAST}{' of the scene' * (name != SPEECH)}{_at(volume_db)}"
            volume = 10.0 ** (volume_db / 20.0)
            heard = stands_db(k_weighted(volume * programme))
            rows.append(Row(title, heard, "dB", "in", note=f"{heard:.1f} phon {HEARD}"))
            for way in ways():
                felt = way.felt(volume * programme)[: programme.size]
                rows.append(Row(title, stands_db(felt), "dB", way.name))
    return rows


def _volume_rows(sound: FloatArray, turned_s: float) -> list[Row]:
    """Return how long speech that is 20 dB lower is felt weaker, and by how much in the end."""
    programme = np.resize(sound, round(3.0 * turned_s * SAMPLERATE))
    volume = np.where(np.arange(programme.size) < turned_s * SAMPLERATE, 1.0, 0.1)
    piece = 2 * SAMPLERATE
    rows = []
    for way in ways():
        loud, low = (
            [
                level_db(float(np.mean(felt[first : first + piece] ** 2)))
                for first in range(round(turned_s * SAMPLERATE), programme.size - piece + 1, piece)
            ]
            for felt in (way.felt(programme), way.felt(volume * programme))
        )
        weaker = np.array(low) - np.array(loud)
        off = np.flatnonzero(np.abs(weaker) > FELT_SAME_DB)
        settled = not off.size or off[-1] + 1 < weaker.size
        after_s = 2.0 * float(off[-1] + 1) if off.size else 0.0
        note = "" if settled else "never"
        rows += [
            Row(SETTLES, after_s if settled else None, "s", way.name, note=note),
            Row(SETTLED_DIFFERENCE, float(np.mean(weaker[-4:])), "dB", way.name),
        ]
    return rows
