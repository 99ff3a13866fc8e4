"""Rows for the report: syllables, soft words, and speech over music."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from audioflinger_hook.transform import FloatArray
from tools.bench.measures.contrasts import STEPS_A_SECOND, felt_levels_db, loud_db
from tools.bench.measures.felt import NOTHING_DB, weighted
from tools.bench.measures.steadiness import syllables_alike
from tools.bench.methods import PARTIAL, Method
from tools.bench.report import Must, Row
from tools.bench.sounds.films import DIALOGUE_DB, db, going_on, spoken
from tools.bench.sounds.real_sounds import RealSound, of_kinds
from tools.bench.sounds.signals import SAMPLERATE

ALIKE, UNDER_DB = 0.9, 6.0
SOFTER_DB, SOFTER_EVERY = -20.0, 3
MUSIC_UNDER_DB, MUSIC_S = -10.0, 6.0  # level relative to speech; time in s of music before speech


def speech_rows(profiles: Sequence[Method], sounds: Sequence[RealSound]) -> Iterator[Row]:
    """Yield rows on the envelope of speech, on soft words, and on speech over music."""
    words = [spoken(one) for one in of_kinds(sounds, "speech")]
    music = [one.sound for one in of_kinds(sounds, "music")]
    said = np.concatenate(words)
    soft, places = softened(words * SOFTER_EVERY)
    for profile in profiles:
        name = profile.name
        alike = syllables_alike(said, weighted(profile.vibration(said), SAMPLERATE), SAMPLERATE)
        must = _must(profile, ">=", ALIKE)
        yield Row("speech: r of the envelope at 2 to 16 Hz", alike, "", name, must)
        levels = felt_levels_db(profile.vibration(soft), SAMPLERATE)
        felt = [loud_db(levels[place]) for place in places]
        share = 100.0 * float(np.mean(np.array(felt) > NOTHING_DB))
        title = f"speech: words {-SOFTER_DB:g} dB softer that are felt"
        yield Row(title, share, "%", name, _must(profile, ">=", 100.0))
        over = [speech_over_music_db(profile, said, each) for each in music]
        title = f"speech over music {-MUSIC_UNDER_DB:g} dB under it"
        yield Row(title, float(np.mean(over)), "dB", name, _must(profile, ">=", UNDER_DB))


def _must(profile: Method, relation: str, bound: float) -> Must | None:
    return profile.must(relation, bound) if profile.name == PARTIAL else None


def softened(words: Sequence[FloatArray]) -> tuple[FloatArray, list[slice]]:
    """Join all words, every third 20 dB softer; return the sound and the range of each soft word.

    The ranges are in ms.
    """
    played, places, at = [], [], 0
    for number, word in enumerate(words):
        soft = number % SOFTER_EVERY == SOFTER_EVERY - 1
        played.append(word * db(SOFTER_DB) if soft else word)
        if soft:
            ends = (at, at + word.size)
            places.append(slice(*(each * STEPS_A_SECOND // SAMPLERATE for each in ends)))
        at += word.size
    return np.concatenate(played), places


def speech_over_music_db(profile: Method, said: FloatArray, music: FloatArray) -> float:
    """Return the level of the vibration of speech over music relative to the music alone, in dB.

    The level of speech over music is the level that is exceeded 5 % of the time. The level of the
    music alone is the median.
    """
    alone = round(MUSIC_S * SAMPLERATE)
    frames = alone + min(said.size, 2 * alone)
    sound = going_on(music, frames, DIALOGUE_DB + MUSIC_UNDER_DB)
    sound[alone:] += said[: frames - alone]
    levels = felt_levels_db(profile.vibration(sound), SAMPLERATE)
    step = alone * STEPS_A_SECOND // SAMPLERATE
    return loud_db(levels[step:]) - float(np.median(levels[step // 2 : step]))
