"""Films, games and concerts composed of recorded sounds, and impacts over music.

Sounds are (frames,) float64 at 48 kHz. Levels are r.m.s. values in dB relative to full scale, so a
full-scale sine has -3 dB.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform import FloatArray
from tools.bench.measures.impacts import envelope, is_impact, onset_frame
from tools.bench.sounds.real_sounds import RealSound, of_kinds
from tools.bench.sounds.signals import SAMPLERATE, pink_noise
from tools.bench.sounds.speech_sounds import LOUDNESS_DB, even

DIALOGUE_S, QUIET_S, ACTION_S, HISS_S, AGAIN_S = 16.0, 10.0, 40.0, 30.0, 10.0
DIALOGUE_DB, HISS_DB = -25.5, -70.0  # levels in dB of speech without pauses, and of the hiss
STROKES, STROKE_S, STROKE_FADE_S = 8, 3.0, 0.5
BUSY, BUSY_PEAK_DB, BUSY_S = 16, -12.0, 0.6
PAUSE_S, HISS_PIECE_S = 0.3, 10.0
JOIN_S = 0.05  # cross-fade in s of a repeated sound
FAINT_DB = -40.0  # level at which a sound starts, relative to its peak
MUSIC_DB, IMPACT_PEAK_DB, IMPACT_AT_S, MIX_S = -18.0, -3.0, 4.0, 5.0


@dataclass(frozen=True)
class Layout:
    """Classes and levels of the sounds in a kind of film.

    quiet, action: classes of continuous sounds in the quiet part and in the action.
    quiet_db, action_db: level of each of these sounds in dB.
    strokes: class of the strongest sudden sounds in the action.
    peak_db: peak of these sudden sounds in dB relative to full scale.
    busy: class of weaker sudden sounds in the action; empty for none.
    """

    quiet: tuple[str, ...]
    quiet_db: float
    action: tuple[str, ...]
    action_db: float
    strokes: str
    peak_db: float
    busy: str = ""


LAYOUTS = {
    "film": Layout(
        ("ambience", "ambience"), -46.0, ("music", "engines"), -22.0, "explosions", -3.0
    ),
    "game": Layout(
        ("ambience", "footsteps"), -47.0, ("music", "engines"), -22.0, "explosions", -3.0, "shots"
    ),
    "concert": Layout(("music",), -44.0, ("music", "music"), -22.0, "drums", 0.0),
}


@dataclass(frozen=True, eq=False)
class Film:
    """A film, and the ranges of frames of its parts.

    sound: (frames,).
    word: the last words of the dialogue.
    strokes: frames at which explosions or drums start in the action.
    again: the words of `word`, repeated after the hiss.
    """

    kind: str
    sound: FloatArray
    dialogue: slice
    word: slice
    quiet: slice
    action: slice
    strokes: tuple[int, ...]
    hiss: slice
    again: slice


def film(kind: str, sounds: Sequence[RealSound], seed: int) -> Film:
    """Compose a film. The same sounds and seed give the same film.

    The parts are dialogue, a quiet part, action with explosions or drums, 30 s of hiss alone, and
    dialogue. The film lasts 106 s. The hiss is soft pink noise that lasts for the whole film.

    kind: "film", "game" or "concert".
    sounds: sounds of all classes that this kind needs.
    """
    rng = np.random.default_rng([list(LAYOUTS).index(kind), seed])
    layout = LAYOUTS[kind]
    lasts = (DIALOGUE_S, QUIET_S, ACTION_S, HISS_S, AGAIN_S)
    ends = np.cumsum([round(each * SAMPLERATE) for each in lasts]).tolist()
    places = [slice(*ends_) for ends_ in zip([0, *ends], ends, strict=False)]
    dialogue, quiet, action, hiss, again = places
    sound = going_on(pink_noise(round(HISS_PIECE_S * SAMPLERATE), rng), ends[-1], HISS_DB)
    words = [spoken(each) for each in _some(rng, sounds, "speech", 12)]
    last = words[0]
    said = _filled(words[1:], dialogue.stop - dialogue.start - last.size)
    sound[dialogue] += np.concatenate((said, last))
    sound[again] += _filled(words, again.stop - again.start)
    for place, kinds, level_db in (
        (quiet, layout.quiet, layout.quiet_db),
        (action, layout.action, layout.action_db),
    ):
        for one in _each_other(rng, sounds, kinds):
            sound[place] += going_on(one.sound, place.stop - place.start, level_db)
    if layout.busy:
        for at, one in _spread(rng, sounds, layout.busy, BUSY, action):
            add(sound, at, _stroke(one.sound, BUSY_PEAK_DB, BUSY_S))
    strokes = _spread(rng, sounds, layout.strokes, STROKES, action)
    for at, one in strokes:
        add(sound, at, _stroke(one.sound, layout.peak_db, STROKE_S))
    return Film(
        kind, sound / max(1.0, float(np.abs(sound).max())), dialogue,
        slice(dialogue.stop - last.size, dialogue.stop), quiet, action,
        tuple(at for at, _ in strokes), hiss, slice(again.start, again.start + last.size),
    )  # fmt: skip


def _some(
    rng: np.random.Generator, sounds: Sequence[RealSound], kind: str, count: int
) -> list[RealSound]:
    there = of_kinds(sounds, kind)
    order = [int(one) for one in rng.permutation(len(there))]
    return [there[order[one % len(order)]] for one in range(count)]


def _each_other(
    rng: np.random.Generator, sounds: Sequence[RealSound], kinds: Sequence[str]
) -> list[RealSound]:
    return [
        one for kind in dict.fromkeys(kinds) for one in _some(rng, sounds, kind, kinds.count(kind))
    ]


def _spread(
    rng: np.random.Generator, sounds: Sequence[RealSound], kind: str, count: int, within: slice
) -> list[tuple[int, RealSound]]:
    part = (within.stop - within.start) // count
    early = rng.uniform(0.1, 0.4, count)
    places = [within.start + round(part * (one + early[one])) for one in range(count)]
    return list(zip(places, _some(rng, sounds, kind, count), strict=True))


def spoken(one: RealSound) -> FloatArray:
    """Return a speech sound at the level of dialogue, from its first word, followed by a pause."""
    sound = db(DIALOGUE_DB - LOUDNESS_DB) * even(from_onset(one.sound))
    return np.concatenate((sound, np.zeros(round(PAUSE_S * SAMPLERATE))))


def _filled(words: Sequence[FloatArray], frames: int) -> FloatArray:
    said = np.resize(np.concatenate(words), frames)
    fade = round(JOIN_S * SAMPLERATE)
    said[-fade:] *= np.linspace(1.0, 0.0, fade)
    return said


def _stroke(sound: FloatArray, peak_db: float, last_s: float) -> FloatArray:
    stroke = from_onset(sound)[: round(last_s * SAMPLERATE)]
    fade = min(stroke.size, round(STROKE_FADE_S * SAMPLERATE))
    shape = np.ones(stroke.size)
    shape[stroke.size - fade :] = np.linspace(1.0, 0.0, fade)
    return shape * stroke * (db(peak_db) / max(1e-9, float(np.abs(stroke).max())))


def going_on(sound: FloatArray, frames: int, level_db: float) -> FloatArray:
    """Return a sound of a given length and level, repeated with cross-fades if necessary."""
    join = min(round(JOIN_S * SAMPLERATE), sound.size // 2)
    rise = np.sin(0.5 * np.pi * (np.arange(join) + 0.5) / join)
    shaped = sound.copy()
    shaped[:join] *= rise
    shaped[-join:] *= rise[::-1]
    played = np.zeros(frames + sound.size)
    for at in range(0, frames, sound.size - join):
        played[at : at + sound.size] += shaped[: played.size - at]
    played = played[:frames]
    return played * (db(level_db) / max(1e-9, float(played.std())))


def from_onset(sound: FloatArray) -> FloatArray:
    """Return a sound without the silence at its start."""
    size = np.abs(sound)
    return sound[int((size >= db(FAINT_DB) * float(size.max())).argmax()) :]


def add(sound: FloatArray, at: int, part: FloatArray) -> None:
    """Add `part` to `sound` in place from frame `at`; frames beyond the end are dropped."""
    end = min(sound.size, at + part.size)
    sound[at:end] += part[: end - at]


def db(level_db: float) -> float:
    """Convert dB to a ratio of amplitudes."""
    return float(10.0 ** (level_db / 20.0))


# -------------------------------------------------------------------------- impacts over music


@dataclass(frozen=True, eq=False)
class OverMusic:
    """An impact mixed with music.

    name: name of the impact.
    sound: the mix.
    music: the music alone.
    at: frame at which the impact starts.
    """

    name: str
    sound: FloatArray
    music: FloatArray
    at: int


def impacts_over_music(sounds: Sequence[RealSound], pieces_an_impact: int) -> list[OverMusic]:
    """Mix each sudden drum, shot and explosion with several pieces of music.

    Relative to full scale, the music has an r.m.s. of -18 dB, and the impact a peak of -3 dB. The
    impact starts after 4 s. A mix lasts 5 s.

    pieces_an_impact: number of pieces of music for each impact.
    """
    music = of_kinds(sounds, "music")
    frames, at = round(MIX_S * SAMPLERATE), round(IMPACT_AT_S * SAMPLERATE)
    under = [going_on(one.sound, frames, MUSIC_DB) for one in music]
    found: list[OverMusic] = []
    for one in of_kinds(sounds, "drums", "shots", "explosions"):
        if not is_impact(one.sound, SAMPLERATE, brief=False):
            continue
        onset = onset_frame(envelope(one.sound, SAMPLERATE), SAMPLERATE, 0.0)
        impact = one.sound[max(0, onset) :]
        impact = impact * (db(IMPACT_PEAK_DB) / float(np.abs(impact[:SAMPLERATE]).max()))
        for piece in range(pieces_an_impact):
            alone = under[(len(found) + piece) % len(under)]
            both = alone.copy()
            add(both, at, impact)
            found.append(OverMusic(one.name, both, alone, at))
    return found
