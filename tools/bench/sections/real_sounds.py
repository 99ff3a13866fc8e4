"""Section on real sounds: what is felt of them against what is heard, by profile and by method."""

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

PIECES_AN_IMPACT = 3
"""Each impact is put over so many pieces of music."""
MOST_TONES = 12
RIG_FILMS = 3
"""Most films for the seats of the rigs: simulating one takes two seconds."""


@dataclass(frozen=True)
class Material:
    """The sounds that are measured: of one half, and of both where a row needs many.

    films: how many of each kind; kinds: of films; tones: how many frequencies.
    """

    half: Sequence[RealSound]
    all: Sequence[RealSound]
    films: int
    kinds: Sequence[str] = tuple(LAYOUTS)
    tones: int = MOST_TONES


def material(half: Half, a_class: int | None, films: int, tones: int = MOST_TONES) -> Material:
    """Return the sounds of a half, at most so many of each class; empty where there are none.

    Rows that need many sounds get both halves, but not while values are chosen on one of them. A
    single film is of one kind.
    """
    chosen = real_sounds(half, a_class)
    both = real_sounds("all", a_class) if half == "report" else chosen
    return Material(chosen, both, films, tuple(LAYOUTS)[: None if films > 1 else 1], tones)


Part = Callable[[], Iterable[Row]]


def parts(methods: Sequence[Method], of: Material, series: Series) -> dict[str, Part]:
    """Return what can be measured by itself, by name, in the order of the table.

    methods: profiles first, then all others; series: gets what the picture shows.
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
    """Every profile and other method on the half of the sounds that no value was chosen on."""
    effort = bench.effort
    of = material("report", effort.real_sounds, effort.films, min(MOST_TONES, effort.tones))
    if not of.half:
        return _missing("there are no sounds", SOUNDS_COMMAND)
    if find_spec("mosqito") is None:
        return _missing("MoSQITo, which computes loudness, is not installed", SETUP_COMMAND)
    return felt_on_real_sounds([*profile_methods(), *other_methods()], of)


def felt_on_real_sounds(methods: Sequence[Method], of: Material) -> Section:
    """Return the section of these methods on these sounds."""
    series: Series = {}
    rows = [row for part in parts(methods, of, series).values() for row in part()]
    return Section(
        TITLE,
        f"Films, games and concerts are put together by seed, {of.films} of each kind: dialogue, "
        "quiet, action with explosions (in a concert: drums) over music and engines, 30 s of pink "
        f"hiss at {HISS_DB:g} dBFS, and the dialogue's last words again. A value is the mean over "
        "films, with the smallest and the largest. Levels are the r.m.s. of 125 ms, of the sound "
        "over 90 Hz and of the vibration weighted by Wk of ISO 2631-1 without its band limit at "
        "100 Hz, which is its velocity. An explosion stands out if its level rises more within "
        "0.25 s than at nine tenths of all other moments. *Match* is 100 (1 - (1 - r) min(1, v / "
        "0.5)), with r the correlation of momentary loudness (ISO 532-1, a full-scale sine as "
        "94 dB SPL) and of the vibration's r.m.s. in 20 ms, where the loudness comes 0 to 80 ms "
        "later, and v the loudness's coefficient of variation. It predicts best, of the measures "
        "tried, how people rated the 4 000 clips of Sound2Hap; those under 70 were rated lower by "
        "15 of 100. "
        f"Pairs of sounds are held against a law of {LAW:g} dB of vibration for a phon. Vibration "
        "is that of files, from which latency is taken out. Null models show what a row is worth: "
        "*constant* is the same vibration whatever is heard; *band-pass* and *envelope* know one "
        "thing each. *Centroid* and *octave fold* are other methods. *Sound* is what is heard.",
        tuple(rows),
        series=series,
        footnote=f"{_counted(of.half)} of the half on which no value was chosen. Match, leak, "
        f"deep energy and classes: {_counted(of.all)}, of both halves. Fetched by "
        f"{SOUNDS_COMMAND}.",
    )


def _counted(sounds: Sequence[RealSound]) -> str:
    count = Counter(each.kind for each in sounds)
    listed = ", ".join(f"{kind} {number}" for kind, number in count.items())
    return f"{len(sounds)} sounds ({listed})"


def _missing(reason: str, command: str) -> Section:
    gone = Missing(f"every row of {TITLE}", reason, command)
    return Section(TITLE, "This could not be measured here.", (), (gone,))
