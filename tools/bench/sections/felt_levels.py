"""Rows for the report: strength of vibration in relation to the loudness of the sound."""

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
SETTLE_S = 60.0  # duration in s of the part in which loudness control settles
SWELL_S, SWELL_TOP_DB = 16.0, -9.0
SWELLS_DB = {0.0: 30.0, -20.0: 20.0}  # range in dB of the swell, by volume in dB
END_S = 1.0
LAW = 0.63
"""Target slope in dB of vibration for each phon of loudness. A slope of 0.6 would make strength
proportional to loudness: 10 phon double the loudness, and 6 dB double the strength.
"""
WITHIN_DB, PAIRS = 3.0, 75.0

Series = dict[str, tuple[float, ...]]
SWELL, HEARD, FELT, KIND = "swell, ", "heard", "felt, ", "class"
"""Prefixes and names in the section's series."""


def law_of(method: Method) -> float:
    """Return the wanted change of the vibration's level in dB for each phon of loudness.

    A profile with loudness control defines this change. For all other methods, it is `LAW`.
    """
    parameters = method.parameters
    return parameters.dynamics if parameters and parameters.loudness_db else LAW


def at_volume(name: str, volume_db: float) -> str:
    """Return the name of a row, with the volume if it is not 0 dB."""
    return f"{name}, at {volume_db:g} dB" if volume_db else name


# ---------------------------------------------------------------------------------- crescendo


def swell(range_db: float) -> FloatArray:
    """Return pink noise (frames,) whose level falls for 8 s, rises for 16 s and falls for 16 s.

    The first fall covers half of the range. The highest level is 9 dB below a full-scale sine.

    range_db: difference between the highest and the lowest level.
    """
    seconds = np.array([0.0, 0.5, 1.5, 2.5]) * SWELL_S
    level = SWELL_TOP_DB - range_db * np.array([0.5, 1.0, 0.0, 1.0])
    time_s = np.arange(round(seconds[-1] * SAMPLERATE)) / SAMPLERATE
    level_db = np.interp(time_s, seconds, level)
    return np.asarray(
        10.0 ** (level_db / 20.0) * np.sqrt(0.5) * pink_noise(time_s.size, np.random.default_rng(7))
    )


def crescendo_rows(methods: Sequence[Method], series: Series) -> Iterator[Row]:
    """Yield the change of the vibration's level while the level of a sound rises or falls slowly.

    The deviation from the wanted change is also given, in % of the wanted change.

    series: the function adds the levels at full volume to it.
    """
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
    """Return the level at the loudest time of a crescendo relative to the level at `end_s`, in dB.

    Both levels are means over 2 s.
    """
    top, end = round(1.5 * SWELL_S / END_S), round(end_s / END_S)
    return float(level[top - 1 : top + 1].mean() - level[end - 1 : end + 1].mean())


def pieces_db(signal: FloatArray, piece_s: float) -> FloatArray:
    """Return the level of each complete piece of a signal, in dB relative to a full-scale sine."""
    frames = round(piece_s * SAMPLERATE)
    pieces = signal[: signal.size // frames * frames].reshape(-1, frames)
    levels: FloatArray = 10.0 * np.log10(2.0 * (pieces**2).mean(axis=1) + 1e-10)
    return levels


# -------------------------------------------------------------------------------------- pairs


def programme(sounds: Sequence[RealSound]) -> tuple[FloatArray, list[slice]]:
    """Join all sounds in random order; return the result and the range of frames of each sound.

    A pause of 0.5 s follows each sound. The result begins with a copy of its last minute, in which
    loudness control settles. The order of the sounds is the same in every run. The ranges are in
    the order of `sounds`.
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
    """Return the loudness level in phon that each sound exceeds 5 % of the time."""
    return np.array([n5_phon(each.sound, TAIL_S) for each in sounds])


def at_places_db(vibration: FloatArray, places: Sequence[slice]) -> FloatArray:
    """Return the level in dB that the vibration exceeds 5 % of the time, for each sound.

    places: frames of each sound.
    """
    running = running_db(vibration, SAMPLERATE)
    step = SAMPLERATE // STEPS_A_SECOND
    within = [slice(place.start // step, place.stop // step) for place in places]
    return np.array([felt_db(running[place]) for place in within])


def pair_errors_db(heard_phon: FloatArray, felt: FloatArray, law: float) -> FloatArray:
    """Return the error of the difference in strength for each pair of sounds, in dB.

    heard_phon: loudness level of each sound in phon.
    felt: strength of the vibration of each sound in dB.
    law: wanted change of strength in dB for each phon.
    """
    off = felt - law * heard_phon
    one, other = np.triu_indices(off.size, 1)
    errors: FloatArray = off[one] - off[other]
    return errors


def pairs_within(heard_phon: FloatArray, felt: FloatArray) -> float:
    """Return the percentage of pairs of sounds with an error within ±3 dB; see `pair_errors_db`."""
    errors = pair_errors_db(heard_phon, felt, LAW)
    return 100.0 * float(np.mean(np.abs(errors) <= WITHIN_DB))


def level_rows(
    methods: Sequence[Method], sounds: Sequence[RealSound], series: Series
) -> Iterator[Row]:
    """Yield the share of pairs of sounds whose difference in strength has an error of up to 3 dB.

    The number of sounds without vibration is also given.

    series: the function adds loudness, vibration level and class of each sound to it.
    """
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
