"""How strongly sounds are felt against how loud they are heard: crescendo, pairs, classes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform import FloatArray, TransformParameters
from tools.bench.measures.felt import NOTHING_DB, TAIL_S, felt_db, running_db, weighted
from tools.bench.measures.loudness import STEP_S, loudness_sone, n5_phon, phon
from tools.bench.report import Must, Row
from tools.bench.sections.profiles import QUIETER_DB
from tools.bench.sounds.real_sounds import RealSound
from tools.bench.sounds.signals import SAMPLERATE
from tools.bench.workbench import Subject

VOLUMES_DB = (0.0, QUIETER_DB)
PAUSE_S = 0.5
SETTLE_S = 60.0
"""So much of the programme's end is played before it, for the transform to know the programme."""

SWELL_DB, SWELL_S, SWELL_TOP_DB = 30.0, 16.0, -15.0
END_S = 1.0
WITHIN_DB = 3.0


@dataclass(frozen=True)
class Felt:
    """A method that is measured. law: dB of vibration that it promises for a phon of loudness.

    limited: whether the limits are asked of it. parameters: of a profile.
    """

    subject: Subject
    law: float
    limited: bool = False
    parameters: TransformParameters | None = None

    @property
    def name(self) -> str:
        """Its column."""
        return self.subject.name

    def must(self, relation: str, bound: float) -> Must | None:
        """Return the limit where limits are asked."""
        return Must(relation, bound) if self.limited else None  # type: ignore[arg-type]

    def vibration(self, sound: FloatArray, volume_db: float = 0.0) -> FloatArray:
        """Return the vibration of a sound at a volume, with its latency, (frames,)."""
        return self.subject.vibration(10.0 ** (volume_db / 20.0) * sound, SAMPLERATE)


def law_of(parameters: TransformParameters) -> float:
    """Return the dB of vibration for a phon: the follower's slope, or 1 where none is followed."""
    return parameters.dynamics if parameters.loudness_db else 1.0


def at_volume(name: str, volume_db: float) -> str:
    """Return a row's name at a volume."""
    return f"{name}, at {volume_db:g} dB" if volume_db else name


# ---------------------------------------------------------------------------------- crescendo


def swell() -> tuple[FloatArray, FloatArray]:
    """Return pink noise (frames,) that falls 15 dB, rises 30 dB and falls 30 dB; its level in dB.

    It rises and falls in 16 s each, so that it begins in the middle of its range.
    """
    half = SWELL_DB / 2.0
    seconds = np.array([0.0, 0.5, 1.5, 2.5]) * SWELL_S
    level = np.array([-half, -SWELL_DB, 0.0, -SWELL_DB]) + SWELL_TOP_DB
    time_s = np.arange(round(seconds[-1] * SAMPLERATE)) / SAMPLERATE
    level_db = np.interp(time_s, seconds, level)
    return 10.0 ** (level_db / 20.0) * pink_noise(time_s.size), level_db


def pink_noise(frames: int) -> FloatArray:
    """Return pink noise from 20 Hz up, r.m.s. 0.71 as a full-scale sine, (frames,)."""
    spectrum = np.fft.rfft(np.random.default_rng(7).standard_normal(frames))
    hz = np.fft.rfftfreq(frames, 1.0 / SAMPLERATE)
    spectrum[hz < 20.0] = 0.0
    spectrum[1:] /= np.sqrt(hz[1:])
    noise = np.fft.irfft(spectrum, frames)
    pink: FloatArray = noise / (np.sqrt(2.0) * noise.std())
    return pink


def swell_phon() -> FloatArray:
    """Return the loudness level in phon in the three turning points: low, high, low again."""
    sone = loudness_sone(swell()[0])
    ends = _ends(round(1.0 / STEP_S), sone.size)
    return np.array([float(phon(sone[each].mean())) for each in ends])


def _ends(rate: int, size: int) -> list[slice]:
    """Return a second around the low, the high and the last point of the swell."""
    points = [round(part * SWELL_S * rate) for part in (0.5, 1.5)]
    half = round(0.5 * END_S * rate)
    return [*(slice(at - half, at + half) for at in points), slice(size - half, size)]


def crescendo_rows(methods: Sequence[Felt], heard_phon: FloatArray) -> Iterator[Row]:
    """Yield how far a slow swell moves the vibration, up and down, and how far off the law."""
    sound, _ = swell()
    for volume_db in VOLUMES_DB:
        for method in methods:
            felt = weighted(method.vibration(sound, volume_db), SAMPLERATE)
            low, high, end = (
                10.0 * np.log10(np.mean(felt[each] ** 2) + 1e-20)
                for each in _ends(SAMPLERATE, felt.size)
            )
            moved = {"up": float(high - low), "down": float(high - end)}
            heard = {"up": heard_phon[1] - heard_phon[0], "down": heard_phon[1] - heard_phon[2]}
            for way, moved_db in moved.items():
                name = at_volume(f"crescendo of 30 dB in 16 s, {way}", volume_db)
                yield Row(name, moved_db, "dB", method.name)
                wanted = method.law * float(heard[way])
                off = 100.0 * abs(moved_db - wanted) / wanted
                yield Row(f"{name}: off the law", off, "%", method.name, method.must("<=", 25.0))


# -------------------------------------------------------------------------------------- pairs


def programme(sounds: Sequence[RealSound]) -> tuple[FloatArray, list[slice]]:
    """Return all sounds one after another in a fixed random order, and where each one is.

    Between them are pauses of 0.5 s. The last minute of the sounds is played before them, too. The
    places are in the order of `sounds`.
    """
    order = np.random.default_rng(11).permutation(len(sounds))
    pause = np.zeros(round(PAUSE_S * SAMPLERATE))
    played = np.concatenate([part for one in order for part in (sounds[one].sound, pause)])
    before = played[-round(SETTLE_S * SAMPLERATE) :]
    starts = before.size + np.cumsum([0, *(sounds[one].sound.size + pause.size for one in order)])
    tail = round(TAIL_S * SAMPLERATE)
    places = [slice(0)] * len(sounds)
    for one, start in zip(order.tolist(), starts.tolist(), strict=False):
        places[one] = slice(start, start + sounds[one].sound.size + tail)
    return np.concatenate((before, played)), places


def heard_phons(sounds: Sequence[RealSound]) -> FloatArray:
    """Return the loudness level N5 of every sound in phon, at full volume."""
    return np.array([n5_phon(each.sound, TAIL_S) for each in sounds])


def in_programme_db(
    method: Felt, played: FloatArray, places: Sequence[slice], volume_db: float
) -> FloatArray:
    """Return how strongly every sound of a programme is felt, in dB."""
    felt = weighted(method.vibration(played, volume_db), SAMPLERATE)
    running = running_db(felt, SAMPLERATE)
    return np.array([felt_db(running[place]) for place in places])


def alone_db(method: Felt, sounds: Sequence[RealSound], volume_db: float) -> FloatArray:
    """Return how strongly every sound is felt by itself, each in a new stream, in dB."""
    tail = np.zeros(round(TAIL_S * SAMPLERATE))
    levels = []
    for each in sounds:
        vibration = method.vibration(np.concatenate((each.sound, tail)), volume_db)
        levels.append(felt_db(running_db(weighted(vibration, SAMPLERATE), SAMPLERATE)))
    return np.array(levels)


def pair_errors_db(heard_phon: FloatArray, felt: FloatArray, law: float) -> FloatArray:
    """Return for every pair of sounds how far their difference in strength is off the law, dB."""
    off = felt - law * heard_phon
    one, other = np.triu_indices(off.size, 1)
    errors: FloatArray = off[one] - off[other]
    return errors


def pair_rows(name: str, heard_phon: FloatArray, felt: FloatArray, method: Felt) -> Iterator[Row]:
    """Yield the error of pairs against the law, and the share of pairs within 3 dB."""
    errors = pair_errors_db(heard_phon, felt, method.law)
    rms = float(np.sqrt(np.mean(errors**2)))
    share = 100.0 * float(np.mean(np.abs(errors) <= WITHIN_DB))
    yield Row(f"{name}: error of pairs, r.m.s.", rms, "dB", method.name, method.must("<=", 3.0))
    yield Row(f"{name}: pairs within 3 dB", share, "%", method.name, method.must(">=", 75.0))


def level_rows(
    methods: Sequence[Felt], sounds: Sequence[RealSound], series: dict[str, tuple[float, ...]]
) -> Iterator[Row]:
    """Yield the rows of pairs and classes; what is heard and felt goes into the series."""
    heard = heard_phons(sounds)
    kinds = np.array([each.kind for each in sounds])
    series["heard"] = tuple(heard)
    played, places = programme(sounds)
    for volume_db in VOLUMES_DB:
        for method in methods:
            felt = in_programme_db(method, played, places, volume_db)
            if not volume_db:
                series[f"felt, {method.name}"] = tuple(felt)
                yield from _class_rows(kinds, heard, felt, method)
            yield from pair_rows(at_volume("in a programme", volume_db), heard, felt, method)
            alone = alone_db(method, sounds, volume_db)
            yield from pair_rows(at_volume("each alone", volume_db), heard, alone, method)


def _class_rows(
    kinds: np.ndarray, heard: FloatArray, felt: FloatArray, method: Felt
) -> Iterator[Row]:
    """Yield explosions over speech, what drums lose against the law, and what is not felt."""
    over_phon, over_db = (
        float(np.median(values[kinds == "explosions"]) - np.median(values[kinds == "speech"]))
        for values in (heard, felt)
    )
    yield Row("explosions over speech, heard", over_phon, "phon", method.name)
    beyond = over_db - method.law * over_phon
    yield Row("explosions over speech, felt", over_db, "dB", method.name)
    name = "explosions over speech: beyond the law"
    yield Row(name, beyond, "dB", method.name, method.must(">=", -0.5))
    off = felt - method.law * heard
    drums = float(np.median(off[kinds == "drums"]) - np.median(off))
    yield Row("drums: beyond the law", drums, "dB", method.name, method.must(">=", -1.0))
    lost = float(np.count_nonzero(felt <= NOTHING_DB))
    yield Row("sounds not felt at all", lost, f"of {felt.size}", method.name)
