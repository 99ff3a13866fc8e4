"""How strongly sounds are felt against how loud they are heard: crescendo, pairs, classes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from audioflinger_hook.transform import FloatArray, TransformParameters
from tools.bench.measures.felt import (
    NOTHING_DB,
    STEPS_A_SECOND,
    TAIL_S,
    felt_db,
    running_db,
    weighted,
)
from tools.bench.measures.loudness import n5_phon, slow_phon
from tools.bench.report import Must, Row
from tools.bench.sections.profiles import QUIETER_DB
from tools.bench.sounds.real_sounds import KINDS, RealSound
from tools.bench.sounds.signals import SAMPLERATE
from tools.bench.workbench import Subject

VOLUMES_DB = (0.0, QUIETER_DB)
PAUSE_S = 0.5
SETTLE_S = 60.0
"""So much of the programme's end is played before it, for the transform to know the programme."""

SWELL_S, SWELL_TOP_DB = 16.0, -9.0
SWELLS_DB = {0.0: 30.0, QUIETER_DB: 20.0}
"""Range of the swell by volume: a wider one would begin in what counts as noise of the room."""
END_S = 1.0
WITHIN_DB = 3.0
PASSAGE_PIECE_S = 3.0

Series = dict[str, tuple[float, ...]]
SWELL, HEARD, FELT, KIND, LAW = "swell, ", "heard", "felt, ", "class", "law, "
"""How the names in the section's series begin: seconds of the swell; one number a sound; a law."""


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


def swell(range_db: float) -> FloatArray:
    """Return pink noise (frames,) that falls half of a range in 8 s, rises in 16 s, falls in 16 s.

    It begins in the middle of its range; its loudest moment has 9 dB less than a full-scale sine.
    """
    seconds = np.array([0.0, 0.5, 1.5, 2.5]) * SWELL_S
    level = SWELL_TOP_DB - range_db * np.array([0.5, 1.0, 0.0, 1.0])
    time_s = np.arange(round(seconds[-1] * SAMPLERATE)) / SAMPLERATE
    level_db = np.interp(time_s, seconds, level)
    return np.asarray(10.0 ** (level_db / 20.0) * pink_noise(time_s.size))


def pink_noise(frames: int) -> FloatArray:
    """Return pink noise from 20 Hz up, r.m.s. 0.71 as a full-scale sine, (frames,)."""
    spectrum = np.fft.rfft(np.random.default_rng(7).standard_normal(frames))
    hz = np.fft.rfftfreq(frames, 1.0 / SAMPLERATE)
    spectrum[hz < 20.0] = 0.0
    spectrum[1:] /= np.sqrt(hz[1:])
    noise = np.fft.irfft(spectrum, frames)
    pink: FloatArray = noise / (np.sqrt(2.0) * noise.std())
    return pink


def crescendo_rows(methods: Sequence[Felt], series: Series) -> Iterator[Row]:
    """Yield how far a slow swell moves the vibration, up and down, and how far off the law."""
    for volume_db, range_db in SWELLS_DB.items():
        sound = swell(range_db)
        heard = slow_phon(sound, END_S)
        if not volume_db:
            series[f"{SWELL}sound"] = tuple(heard.tolist())
        for method in methods:
            felt = pieces_db(weighted(method.vibration(sound, volume_db), SAMPLERATE), END_S)
            if not volume_db:
                series[f"{SWELL}{method.name}"] = tuple(np.round(felt, 2).tolist())
            for way, end in (("up", SWELL_S / 2.0), ("down", SWELL_S * 2.5)):
                name = f"crescendo of {range_db:g} dB in 16 s, {way}"
                name = at_volume(name, volume_db)
                moved, wanted = (_risen(each, end) for each in (felt, method.law * heard))
                yield Row(name, moved, "dB", method.name)
                off = 100.0 * abs(moved - wanted) / wanted
                yield Row(f"{name}: off the law", off, "%", method.name, method.must("<=", 25.0))


def _risen(level: FloatArray, end_s: float) -> float:
    """Return the level of a swell around its loudest moment over that at one of its ends.

    Both are means of the two whole seconds beside the moment.
    """
    top, end = round(1.5 * SWELL_S / END_S), round(end_s / END_S)
    return float(level[top - 1 : top + 1].mean() - level[end - 1 : end + 1].mean())


def pieces_db(signal: FloatArray, piece_s: float) -> FloatArray:
    """Return the level of each whole piece of (frames,) at 48 kHz, a full-scale sine at 0 dB."""
    frames = round(piece_s * SAMPLERATE)
    pieces = signal[: signal.size // frames * frames].reshape(-1, frames)
    levels: FloatArray = 10.0 * np.log10(2.0 * (pieces**2).mean(axis=1) + 1e-10)
    return levels


# ------------------------------------------------------------------------------ slow dynamics


def orchestral_rows(methods: Sequence[Felt], passages: Sequence[FloatArray]) -> Iterator[Row]:
    """Yield how the vibration of minutes of music follows their loudness, in pieces of 3 s.

    It is the slope of the straight line through all pieces of a passage; the median is shown.
    """
    heard = [slow_phon(sound, PASSAGE_PIECE_S) for sound in passages]
    for method in methods if passages else ():
        slopes = []
        for sound, phons in zip(passages, heard, strict=True):
            felt = weighted(method.vibration(sound), SAMPLERATE)
            slopes.append(float(np.polyfit(phons, pieces_db(felt, PASSAGE_PIECE_S), 1)[0]))
        slope = float(np.median(slopes))
        yield Row("minutes of music: felt for a phon", slope, "dB", method.name)
        share = 100.0 * slope / method.law
        yield Row("minutes of music: share of the law", share, "%", method.name)


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


def at_places_db(vibration: FloatArray, places: Sequence[slice]) -> FloatArray:
    """Return how strong a programme's vibration is in every sound's place, in dB."""
    running = running_db(vibration, SAMPLERATE)
    step = SAMPLERATE // STEPS_A_SECOND
    within = [slice(place.start // step, place.stop // step) for place in places]
    return np.array([felt_db(running[place]) for place in within])


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
    methods: Sequence[Felt], sounds: Sequence[RealSound], series: Series
) -> Iterator[Row]:
    """Yield the rows of pairs and classes; what is heard and felt goes into the series."""
    heard = heard_phons(sounds)
    kinds = np.array([each.kind for each in sounds])
    series[HEARD] = tuple(heard.tolist())
    series[KIND] = tuple(float(KINDS.index(each.kind)) for each in sounds)
    played, places = programme(sounds)
    for volume_db in VOLUMES_DB:
        for method in methods:
            vibration = method.vibration(played, volume_db)
            felt = at_places_db(weighted(vibration, SAMPLERATE), places)
            if not volume_db:
                series[f"{FELT}{method.name}"] = tuple(np.round(felt, 2).tolist())
                series[f"{LAW}{method.name}"] = (method.law,)
                plain = replace(method, limited=False)
                level = at_places_db(vibration, places)
                yield from pair_rows("in a programme, unweighted", heard, level, plain)
            yield from _class_rows(kinds, heard, felt, method, volume_db)
            yield from pair_rows(at_volume("in a programme", volume_db), heard, felt, method)
            alone = alone_db(method, sounds, volume_db)
            yield from pair_rows(at_volume("each alone", volume_db), heard, alone, method)


def _class_rows(
    kinds: np.ndarray, heard: FloatArray, felt: FloatArray, method: Felt, volume_db: float
) -> Iterator[Row]:
    """Yield explosions over speech, what drums lose against the law, and what is not felt."""
    over_phon, over_db = (
        float(np.median(values[kinds == "explosions"]) - np.median(values[kinds == "speech"]))
        for values in (heard, felt)
    )
    name = at_volume("explosions over speech", volume_db)
    if not volume_db:
        yield Row(f"{name}, heard", over_phon, "phon", method.name)
    yield Row(f"{name}, felt", over_db, "dB", method.name)
    beyond, must = over_db - method.law * over_phon, method.must(">=", -0.5)
    yield Row(f"{name}: beyond the law", beyond, "dB", method.name, must)
    off = felt - method.law * heard
    drums, must = float(np.median(off[kinds == "drums"]) - np.median(off)), method.must(">=", -1.0)
    yield Row(at_volume("drums: beyond the law", volume_db), drums, "dB", method.name, must)
    lost = float(np.count_nonzero(felt <= NOTHING_DB))
    name = at_volume("sounds not felt at all", volume_db)
    yield Row(name, lost, f"of {felt.size}", method.name)
