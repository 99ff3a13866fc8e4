"""Section on profiles: strength, contrast, lag, range and cost with each, on the same sounds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.signal import lfilter

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.scenes.chord import chord
from audioflinger_hook.scenes.demo import DEMO_TRACKS
from audioflinger_hook.scenes.engine import engine
from audioflinger_hook.scenes.impacts import explosion
from audioflinger_hook.scenes.speech import speech as spoken_scene
from audioflinger_hook.transform import FloatArray, HapticTransform, TransformParameters
from device.rig import CONSUMER, PAPER, Rig
from device.rig.simulated_rig import SimulatedRig
from tools.bench.measures.similarity import envelope_correlation
from tools.bench.report import Row, Section
from tools.bench.sections.fidelity import BURST_HZ, BURST_ONSET_S, burst_lag_s
from tools.bench.sounds.signals import SAMPLERATE, Recording, speech, stereo
from tools.bench.workbench import Playback, Subject, Workbench, cost_rows, timed

TITLE = "Profiles"
BY_ENERGY = "by energy"
QUIETER_DB = -20.0
LOUDEST_SHARE = 0.1
AUDIBLE_DB = -60.0
"""A quieter unit of a recording counts as a pause."""
NOT_FELT_DB = -90.0
MOMENTARY_S, STEP_S = 0.4, 0.1
"""Momentary loudness of EBU Tech 3341."""
BURSTS, BURST_STREAM_S = 9, 0.8
BLOCKSIZE, COST_S = 256, 2.0
RIGS = (PAPER, CONSUMER)

EXPLOSION, SPEECH, SCENE = "explosion", "speech", "spoken scene"
CONTRAST = "explosion over speech"
SILENT = "silent units at -20 dB"
RANGE = "range of speech, median to loudest twentieth"
COST = "cost of a second of speech, blocks of 256"


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


def profiles(bench: Workbench) -> Section:
    """Level, contrast, lag, similarity, range and cost of every profile."""
    sounds, settled_s = sounds_of(bench.recordings), bench.effort.settled_s
    rows = [
        *_level_rows(sounds, settled_s),
        *_contrast_rows(sounds, settled_s),
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
        measured |= {
            f"acceleration on the {rig.name} rig": (_moved_m_s2(rig, felt["chord"]), "m/s²")
            for rig in RIGS
        }
        rows += [Row(name, value, unit, way.name) for name, (value, unit) in measured.items()]
    rows += _cost_rows(sounds[SPEECH], bench.effort.cost_repeats)
    missing = () if bench.recordings else (bench.missing_recordings("spoken recordings"),)
    reasons = "; ".join(
        f"*{name}*: "
        + ", ".join(f"`{key}` {said.value} ({said.reason})" for key, said in choices.items())
        for name, choices in PROFILES.items()
        if choices
    )
    return Section(
        TITLE,
        "Level of the loudest tenth of the 46 ms units in sound and vibration (0 dB: full-scale "
        f"sine), at full volume and 20 dB lower, after {settled_s:g} s of the sound. *By energy* "
        "is that amplitude mapping without the loudness follower of the other profiles. Explosion "
        "over speech: the loudest 0.4 s of an explosion against the speech before it; heard, as "
        "K-weighted loudness (BS.1770) in phon. The follower aims at a quarter of that, in `music` "
        "at a half, which is how people match strength to loudness. Silent units: the share of "
        "audible units that are not felt at all. Acceleration: r.m.s. of the chord on the "
        "simulated rigs.",
        tuple(rows),
        missing,
        footnote=f"Sounds: the demo's own{'' if missing else ', and spoken recordings as speech'}. "
        f"Values and their reasons: {reasons}.",
    )


def _level_rows(sounds: dict[str, FloatArray], settled_s: float) -> Iterator[Row]:
    """Yield the loudest tenths in and out at two volumes, then the share of silent units."""
    silent: dict[str, list[FloatArray]] = {way.name: [] for way in ways()}
    for name, sound in sounds.items():
        for volume_db in (0.0, QUIETER_DB):
            title = f"{name}, loudest tenth{_at(volume_db)}"
            volume = 10.0 ** (volume_db / 20.0)
            yield Row(title, loudest_db(volume * sound), "dB", "in")
            for way in ways():
                felt = way.settled(volume * sound, settled_s)
                yield Row(title, loudest_db(felt), "dB", way.name)
                if volume_db < 0.0:
                    silent[way.name].append(units_db(felt)[units_db(sound) > AUDIBLE_DB])
    for way_name, levels in silent.items():
        share = float((np.concatenate(levels) < NOT_FELT_DB).mean())
        yield Row(SILENT, 100.0 * share, "%", way_name)


def sounds_of(recordings: tuple[Recording, ...]) -> dict[str, FloatArray]:
    """Return the sounds by name, (frames,) float64 at 48 kHz: the demo's; recorded speech."""
    makers: dict[str, Callable[..., np.ndarray]] = {
        EXPLOSION: explosion,
        "engine": engine,
        "chord": chord,
        SCENE: spoken_scene,
    }
    peaks = {track.name: track.peak for track in DEMO_TRACKS} | {SCENE: 0.42}
    sounds = {
        name: make(SAMPLERATE, np.random.default_rng(1), peaks[name])
        .mean(axis=1)
        .astype(np.float64)
        for name, make in makers.items()
    }
    spoken = speech(recordings)
    sounds[SPEECH] = sounds[SCENE] if spoken is None else spoken[:, 0].astype(np.float64)
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


def _contrast_rows(sounds: dict[str, FloatArray], settled_s: float) -> Iterator[Row]:
    """Yield how far an explosion stands above speech, heard and felt, at two volumes."""
    for name in (SPEECH, SCENE):
        before = np.resize(sounds[name], round(settled_s * SAMPLERATE))
        programme = np.concatenate((before, sounds[EXPLOSION]))
        boundary = round(settled_s / STEP_S)

        def stands_db(signal: FloatArray, boundary: int = boundary) -> float:
            levels = momentary_db(signal)
            talk = np.sort(levels[boundary // 2 : boundary - 4])
            loudest = talk[-max(1, round(LOUDEST_SHARE * talk.size)) :]
            return float(levels[boundary - 1 :].max() - loudest.mean())

        for volume_db in (0.0, QUIETER_DB):
            title = f"{CONTRAST}, {name}{_at(volume_db)}"
            volume = 10.0 ** (volume_db / 20.0)
            heard = stands_db(k_weighted(volume * programme))
            yield Row(title, heard, "dB", "in", note=f"{heard:.1f} phon heard")
            for way in ways():
                felt = way.felt(volume * programme)[: programme.size]
                yield Row(title, stands_db(felt), "dB", way.name)


def _mean_lag_s(way: Way) -> float:
    places = np.random.default_rng(4).permutation(BURSTS) / BURSTS
    bursts = zip(np.geomspace(*BURST_HZ, BURSTS).tolist(), places.tolist(), strict=True)
    stream_s = BURST_ONSET_S + BURST_STREAM_S
    return float(np.mean([burst_lag_s(way.subject, hz, place, stream_s) for hz, place in bursts]))


def _range_db(signal: FloatArray) -> float:
    levels = units_db(signal)
    audible = levels[levels > AUDIBLE_DB]
    return float(np.percentile(audible, 95) - np.percentile(audible, 50))


def _moved_m_s2(rig: Rig, vibration: FloatArray) -> float:
    simulated = SimulatedRig(rig, SAMPLERATE, 1)
    simulated.write(vibration[:, None].astype(np.float32))
    return float(np.sqrt(np.mean(simulated.acceleration_m_s2**2)))


def _cost_rows(sound: FloatArray, repeats: int) -> Iterator[Row]:
    once = stereo(np.resize(sound, round(COST_S * SAMPLERATE)))
    playbacks = [Playback(way.subject, once, BLOCKSIZE) for way in ways()]
    for way, timing in zip(ways(), timed(playbacks, repeats), strict=True):
        yield from cost_rows(COST, way.name, timing, COST_S)[:1]
