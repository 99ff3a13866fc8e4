"""Section on real sounds: what is felt of them against what is heard, by profile and by method."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec

from tools.bench.methods import Method, other_methods, profile_methods
from tools.bench.report import Missing, Row, Section
from tools.bench.sections import felt_films, felt_formats, felt_levels, felt_singles, felt_times
from tools.bench.sections.felt_levels import Series
from tools.bench.sounds.films import LAYOUTS, film, impacts_over_music
from tools.bench.sounds.real_sounds import SOUNDS_COMMAND, Half, RealSound, real_sounds
from tools.bench.workbench import Workbench

TITLE = "On real sounds"
SETUP_COMMAND = "tools/setup.sh test"

PIECES_AN_IMPACT = 3
"""Each impact is put over so many pieces of music."""


@dataclass(frozen=True)
class Material:
    """The sounds that are measured: of one half, and of both where a row needs many.

    films: how many of each kind; kinds: of films; tones: how many frequencies.
    """

    half: Sequence[RealSound]
    all: Sequence[RealSound]
    films: int
    kinds: Sequence[str] = tuple(LAYOUTS)
    tones: int = 12


def material(half: Half, a_class: int | None, films: int) -> Material:
    """Return the sounds of a half, at most so many of each class; empty where there are none.

    Rows that need many sounds get both halves, but not while values are chosen on one of them.
    """
    chosen = real_sounds(half, a_class)
    return Material(chosen, real_sounds("all", a_class) if half == "report" else chosen, films)


Part = Callable[[], Iterable[Row]]


def parts(methods: Sequence[Method], of: Material, series: Series) -> dict[str, Part]:
    """Return what can be measured by itself, by name, in the order of the table.

    methods: profiles first, then all others; series: gets what the picture shows.
    """
    profiles = [each for each in methods if each.parameters]
    return {
        "films": lambda: felt_films.film_rows(
            methods,
            [film(kind, of.half, seed) for kind in of.kinds for seed in range(of.films)],
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
        "ends": lambda: felt_formats.end_rows(profiles),
    }


PARTS = tuple(parts((), Material((), (), 0), {}))


def on_real_sounds(bench: Workbench) -> Section:
    """Every profile and other method on the half of the sounds that no value was chosen on."""
    of = material("report", bench.effort.real_sounds, bench.effort.films)
    if not of.half:
        return _missing("there are no sounds", SOUNDS_COMMAND)
    if find_spec("mosqito") is None:
        return _missing("MoSQITo, which computes loudness, is not installed", SETUP_COMMAND)
    return felt_on_real_sounds([*profile_methods(), *other_methods()], of)


def felt_on_real_sounds(methods: Sequence[Method], of: Material) -> Section:
    """Return the section of these methods on these sounds."""
    series: Series = {}
    rows = [row for part in parts(methods, of, series).values() for row in part()]
    count = Counter(each.kind for each in of.half)
    listed = ", ".join(f"{kind} {number}" for kind, number in count.items())
    return Section(
        TITLE,
        "To be written.",
        tuple(rows),
        series=series,
        footnote=f"Sounds: {len(of.half)} ({listed}), fetched by {SOUNDS_COMMAND}.",
    )


def _missing(reason: str, command: str) -> Section:
    gone = Missing(f"every row of {TITLE}", reason, command)
    return Section(TITLE, "This could not be measured here.", (), (gone,))
