"""Section "On real sounds": how well the vibration represents recorded sounds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec

from tools.bench.methods import Method, other_methods, profile_methods
from tools.bench.report import Missing, Row, Section
from tools.bench.sections import (
    felt_films,
    felt_formats,
    felt_levels,
    felt_rigs,
    felt_singles,
    felt_speech,
    felt_times,
)
from tools.bench.sections.felt_levels import LAW, Series
from tools.bench.sounds.films import HISS_DB, LAYOUTS, film, impacts_over_music
from tools.bench.sounds.real_sounds import SOUNDS_COMMAND, Half, RealSound, real_sounds
from tools.bench.workbench import Workbench

TITLE = "On real sounds"
SETUP_COMMAND = "tools/setup.sh test"
PIECES_AN_IMPACT = 3  # number of pieces of music over which each impact is played
MOST_TONES = 12
RIG_FILMS = 3  # largest number of films on simulated seats


@dataclass(frozen=True)
class Material:
    """The sounds on which methods are measured.

    half: sounds for most rows, usually one half of all sounds.
    all: sounds for rows that need many sounds: both halves if `half` is the half "report", else the
        same as `half`.
    films: number of films of each kind.
    kinds: kinds of films.
    tones: number of frequencies of steady tones.
    """

    half: Sequence[RealSound]
    all: Sequence[RealSound]
    films: int
    kinds: Sequence[str] = tuple(LAYOUTS)
    tones: int = MOST_TONES


def material(half: Half, a_class: int | None, films: int, tones: int = MOST_TONES) -> Material:
    """Return the material from one half of the sounds; for "report", `all` contains both halves.

    a_class: upper limit of the number of sounds of each class; None for all.
    films: number of films of each kind; 1 selects only the first kind.
    tones: number of frequencies of steady tones.
    """
    chosen = real_sounds(half, a_class)
    both = real_sounds("all", a_class) if half == "report" else chosen
    return Material(chosen, both, films, tuple(LAYOUTS)[: None if films > 1 else 1], tones)


Part = Callable[[], Iterable[Row]]


def parts(methods: Sequence[Method], of: Material, series: Series) -> dict[str, Part]:
    """Return the functions that yield the rows of the section, by name of the part, in order.

    methods: profiles, then other methods.
    of: sounds on which the methods are measured.
    series: the functions add the values that the picture shows to it.
    """
    profiles = [each for each in methods if each.parameters]
    return {
        "films": lambda: felt_films.film_rows(
            methods,
            (film(kind, of.half, seed) for kind in of.kinds for seed in range(of.films)),
            series,
        ),
        "impacts": lambda: felt_films.over_music_rows(
            methods, impacts_over_music(of.half, PIECES_AN_IMPACT)
        ),
        "singles": lambda: felt_singles.single_rows(methods, of.all, of.half),
        "beginnings": lambda: felt_singles.beginning_rows(methods, of.half),
        "attacks": lambda: felt_times.impact_rows(methods, of.half, series),
        "tones": lambda: felt_singles.tone_rows(methods, of.tones),
        "steadiness": lambda: felt_times.steady_rows(methods, of.half, series),
        "pairs": lambda: felt_levels.level_rows(methods, of.half, series),
        "crescendo": lambda: felt_levels.crescendo_rows(methods, series),
        "sub-bass": lambda: felt_formats.sub_bass_rows(methods),
        "chirp": lambda: felt_formats.chirp_rows(methods),
        "rates": lambda: felt_formats.rate_rows(profiles, of.half),
        "channels": lambda: felt_formats.channel_rows(profiles, of.half),
        "speech": lambda: felt_speech.speech_rows(profiles, of.half),
        "rigs": lambda: felt_rigs.rig_rows(
            profiles, [film("film", of.half, seed) for seed in range(min(of.films, RIG_FILMS))]
        ),
        "ends": lambda: felt_formats.end_rows(profiles),
    }


PARTS = tuple(parts((), Material((), (), 0), {}))


def on_real_sounds(bench: Workbench) -> Section:
    """Measure all profiles and other methods on the half "report" of the sounds."""
    effort = bench.effort
    of = material("report", effort.real_sounds, effort.films, min(MOST_TONES, effort.tones))
    if not of.half:
        return _missing("there are no sounds", SOUNDS_COMMAND)
    if find_spec("mosqito") is None:
        return _missing("MoSQITo, which computes loudness, is not installed", SETUP_COMMAND)
    return felt_on_real_sounds([*profile_methods(), *other_methods()], of)


def felt_on_real_sounds(methods: Sequence[Method], of: Material) -> Section:
    """Measure the given methods on the given sounds."""
    series: Series = {}
    rows = [row for part in parts(methods, of, series).values() for row in part()]
    return Section(
        TITLE,
        f"Test films, games and concerts are assembled at random from recorded sounds, {of.films} "
        "of each kind. A film has dialogue, a quiet scene, and action with explosions (in a "
        "concert: drums) over music and engines. The action is followed by 30 s of pink noise "
        f"(*hiss*) at {HISS_DB:g} dBFS, and by the last words of the dialogue again. For films, "
        "games and concerts, a value is the mean over all of one kind, with the smallest and the "
        "largest value in brackets. Levels are r.m.s. values over 125 ms, of the sound above 90 Hz "
        "or of the vibration. The vibration is weighted by Wk of ISO 2631-1 without its band limit "
        "at 100 Hz. An explosion stands out if the level rises more in the next 0.25 s than at 90 "
        "% of all other moments. The *match* is 100 (1 - (1 - r) min(1, v / 0.5)); 100 is best. "
        "Here v is the coefficient of variation of the sound's momentary loudness by ISO 532-1, if "
        "a full-scale sine has 94 dB SPL. The value r is the correlation between this loudness and "
        "the vibration's r.m.s. over 20 ms, at the best delay of 0 to 80 ms. In rows with *pairs*, "
        f"the strengths of the vibrations of two sounds should differ by {LAW:g} dB for each phon "
        "between their loudness levels. The vibration is rendered to files, in which the latency "
        "is removed. The column *sound* shows the values of the sound itself. The method "
        "*constant* ignores the sound; the section Baselines describes the other methods.",
        tuple(rows),
        series=series,
        footnote="One half of the sounds was used to choose settings. Most rows use the other "
        f"half: {_counted(of.half)}. The match, the energy above 250 Hz and under 15 Hz, and the "
        f"classes use both halves. These are {_counted(of.all)}. The script {SOUNDS_COMMAND} "
        "fetches the sounds.",
    )


def _counted(sounds: Sequence[RealSound]) -> str:
    count = Counter(each.kind for each in sounds)
    listed = ", ".join(f"{kind} {number}" for kind, number in count.items())
    return f"{len(sounds)} sounds ({listed})"


def _missing(reason: str, command: str) -> Section:
    gone = Missing(f"every row of {TITLE}", reason, command)
    return Section(TITLE, "This could not be measured here.", (), (gone,))
