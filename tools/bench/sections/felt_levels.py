"""How strongly sounds are felt against how loud they are heard: crescendo, pairs, classes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from audioflinger_hook.transform import FloatArray
from tools.bench.measures.felt import (
    NOTHING_DB,
    STEPS_A_SECOND,
    TAIL_S,
    felt_db,
    running_db,
    weighted,
)
from tools.bench.measures.loudness import n5_phon, slow_phon
from tools.bench.methods import Method
from tools.bench.report import Row
from tools.bench.sounds.real_sounds import KINDS, RealSound
from tools.bench.sounds.signals import SAMPLERATE, pink_noise

VOLUMES_DB = (0.0, -20.0)
PAUSE_S = 0.5
SETTLE_S = 60.0
"""So much of the programme's end is played before it, for the transform to know the programme."""

SWELL_S, SWELL_TOP_DB = 16.0, -9.0
SWELLS_DB = {0.0: 30.0, -20.0: 20.0}
"""Range of the swell by volume: a wider one would begin in what counts as noise of the room."""
END_S = 1.0
LAW = 0.63
"""The dB of vibration for a phon of loudness that is wanted: felt in proportion to loudness is 0.6,
since ten phons double loudness and a seat's vibration feels twice as strong at 6 dB more."""
WITHIN_DB, PAIRS = 3.0, 75.0

Series = dict[str, tuple[float, ...]]
SWELL, HEARD, FELT, KIND = "swell, ", "heard", "felt, ", "class"
"""How the names in the section's series begin: seconds of the swell; one number a sound."""


def law_of(method: Method) -> float:
    """Return the dB of vibration for a phon that a method promises: of its follower, or LAW."""
    parameters = method.parameters
    return parameters.dynamics if parameters and parameters.loudness_db else LAW


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
    return np.asarray(
        10.0 ** (level_db / 20.0) * np.sqrt(0.5) * pink_noise(time_s.size, np.random.default_rng(7))
    )


def crescendo_rows(methods: Sequence[Method], series: Series) -> Iterator[Row]:
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
                moved, wanted = (_risen(each, end) for each in (felt, law_of(method) * heard))
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


def pair_errors_db(heard_phon: FloatArray, felt: FloatArray, law: float) -> FloatArray:
    """Return for every pair of sounds how far their difference in strength is off the law, dB."""
    off = felt - law * heard_phon
    one, other = np.triu_indices(off.size, 1)
    errors: FloatArray = off[one] - off[other]
    return errors


def pairs_within(heard_phon: FloatArray, felt: FloatArray) -> float:
    """Return the share of pairs of sounds within 3 dB of the law, %."""
    errors = pair_errors_db(heard_phon, felt, LAW)
    return 100.0 * float(np.mean(np.abs(errors) <= WITHIN_DB))


def level_rows(
    methods: Sequence[Method], sounds: Sequence[RealSound], series: Series
) -> Iterator[Row]:
    """Yield pairs within the law and sounds that are lost; the series gets heard and felt."""
    heard = heard_phons(sounds)
    series[HEARD] = tuple(heard.tolist())
    series[KIND] = tuple(float(KINDS.index(each.kind)) for each in sounds)
    played, places = programme(sounds)
    for volume_db in VOLUMES_DB:
        for method in methods:
            vibration = method.vibration(played, volume_db)
            felt = at_places_db(weighted(vibration, SAMPLERATE), places)
            if not volume_db:
                series[f"{FELT}{method.name}"] = tuple(np.round(felt, 2).tolist())
            share, must = pairs_within(heard, felt), method.must_of_whole(">=", PAIRS)
            name = at_volume("in a programme: pairs within 3 dB", volume_db)
            yield Row(name, share, "%", method.name, must)
            lost = float(np.count_nonzero(felt <= NOTHING_DB))
            name = at_volume("sounds not felt at all", volume_db)
            yield Row(name, lost, f"of {felt.size}", method.name)
