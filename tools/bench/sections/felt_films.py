"""Rows for the report: differences of level in films, and impacts over music."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform import FloatArray
from tools.bench.measures.contrasts import (
    STEPS_A_SECOND,
    added_db,
    felt_levels_db,
    heard_db,
    loud_db,
    standing_out,
    steps,
    strokes_db,
)
from tools.bench.measures.felt import weighted
from tools.bench.methods import Method
from tools.bench.report import Must, Row
from tools.bench.sounds.films import Film, OverMusic
from tools.bench.sounds.signals import SAMPLERATE

VOLUMES_DB = (0.0, -20.0)
SOUND = "sound"  # name of the column for the sound itself
STROKES = {"film": "explosions", "game": "explosions", "concert": "drums"}
SETTLED_HISS_S = 5.0  # only the last part of the hiss, of this duration in s, is evaluated
OVER_SHARE, QUIET_SHARE, OUT_LESS, HISS_DB, WORD_DB = 0.6, 0.45, 15.0, -10.0, 4.0
WORST = 2.0 / 3.0  # factor by which limits are relaxed for a single film
ADDS_DB, IMPACTS_FELT = 1.5, 75.0


FILM, PARTS, BLOWS = "film, ", "film's parts", "film's strokes"
"""Prefixes and names in the section's series."""
SHOWN_S = 0.1

Series = dict[str, tuple[float, ...]]


@dataclass(frozen=True)
class Contrasts:
    """Differences of level between parts of a film, for its sound or its vibration, in dB.

    over: explosions or drums relative to dialogue.
    quiet: action relative to the quiet part.
    out: share of explosions or drums that stand out, in %.
    hiss: hiss relative to dialogue.
    word: first words after the hiss relative to the same words before the hiss.
    """

    over: float
    quiet: float
    out: float
    hiss: float
    word: float


def contrasts(levels: FloatArray, film: Film) -> Contrasts:
    """Return the `Contrasts` of a film. levels: levels of its sound or vibration, for each ms."""
    at = {
        name: levels[steps(getattr(film, name), SAMPLERATE)]
        for name in ("dialogue", "quiet", "action", "hiss", "word", "again")
    }
    strokes = np.round(np.array(film.strokes) * (STEPS_A_SECOND / SAMPLERATE))
    dialogue = loud_db(at["dialogue"])
    return Contrasts(
        over=float(strokes_db(levels, strokes).mean()) - dialogue,
        quiet=float(np.median(at["action"]) - np.median(at["quiet"])),
        out=standing_out(levels, strokes),
        hiss=float(np.median(at["hiss"][-round(SETTLED_HISS_S * STEPS_A_SECOND) :])) - dialogue,
        word=loud_db(at["again"]) - loud_db(at["word"]),
    )


def heard_contrasts(film: Film) -> Contrasts:
    """Return the `Contrasts` of a film's sound above 90 Hz."""
    return contrasts(heard_db(film.sound, SAMPLERATE), film)


def felt_contrasts(method: Method, film: Film, volume_db: float) -> Contrasts:
    """Return the `Contrasts` of the perceived vibration of a film.

    volume_db: gain to apply to the sound, in dB.
    """
    vibration = method.vibration(film.sound, volume_db)
    return contrasts(felt_levels_db(vibration, SAMPLERATE), film)


def film_rows(methods: Sequence[Method], films: Iterable[Film], series: Series) -> Iterator[Row]:
    """Yield rows with the mean `Contrasts` of sound and vibration, over the films of each kind.

    Profiles and methods with `limited` are measured at full volume and at -20 dB, other methods
    only at full volume.

    series: the function adds the levels of the first film to it.
    """
    own: dict[str, list[Contrasts]] = {}
    felt: dict[tuple[str, float, str], list[Contrasts]] = {}
    for each in films:
        if not own:
            series |= film_series(methods, each)
        own.setdefault(each.kind, []).append(heard_contrasts(each))
        for volume_db in VOLUMES_DB:
            for method in _at(volume_db, methods):
                found = felt_contrasts(method, each, volume_db)
                felt.setdefault((each.kind, volume_db, method.name), []).append(found)
    for kind, heard in own.items():
        for volume_db in VOLUMES_DB:
            title = f"{kind}, at {volume_db:g} dB" if volume_db else kind
            yield from _own_rows(title, kind, heard)
            for method in _at(volume_db, methods):
                mine = felt[kind, volume_db, method.name]
                yield from _kind_rows(title, kind, mine, heard, method)


def _at(volume_db: float, methods: Sequence[Method]) -> list[Method]:
    return [each for each in methods if not volume_db or each.limited or each.parameters]


def _own_rows(title: str, kind: str, own: Sequence[Contrasts]) -> Iterator[Row]:
    for what, field, unit in (
        (f"{STROKES[kind]} over dialogue", "over", "dB"),
        ("quiet scene under action", "quiet", "dB"),
        (f"{STROKES[kind]} that stand out", "out", "%"),
        ("hiss against speech", "hiss", "dB"),
        ("next word too strong by", "word", "dB"),
    ):
        yield _spread_row(f"{title}: {what}", unit, own, field, SOUND)


def _kind_rows(
    title: str, kind: str, felt: Sequence[Contrasts], own: Sequence[Contrasts], method: Method
) -> Iterator[Row]:
    name, strokes = method.name, STROKES[kind]
    out_limit = _mean(own, "out") - OUT_LESS
    for what, field, limit in (
        (f"{strokes} over dialogue", "over", OVER_SHARE),
        ("quiet scene under action", "quiet", QUIET_SHARE),
    ):
        yield _spread_row(f"{title}: {what}", "dB", felt, field, name)
        share = round(_mean(felt, field) / _mean(own, field), 3)
        must = method.must_of_whole(">=", limit)
        yield Row(f"{title}: {what}, share of the sound's", share, "", name, must)
    must = method.must_of_whole(">=", out_limit)
    yield _spread_row(f"{title}: {strokes} that stand out", "%", felt, "out", name, must)
    must = method.must_of_whole("<=", HISS_DB)
    yield _spread_row(f"{title}: hiss against speech", "dB", felt, "hiss", name, must)
    must = method.must_of_whole("<=", WORD_DB)
    yield _spread_row(f"{title}: next word too strong by", "dB", felt, "word", name, must)
    failed = [missed(one, of) for one, of in zip(felt, own, strict=True)]
    count = sum(bool(each) for each in failed)
    must = method.must_of_whole("<=", 0.0)
    note = ", ".join(dict.fromkeys(each for one in failed for each in one))
    yield Row(
        f"{title}: films under two thirds of a limit", float(count), f"of {len(felt)}", name, must,
        note=f"{name}: {note}" if note and method.limited and method.whole else "",
    )  # fmt: skip


def missed(felt: Contrasts, own: Contrasts) -> list[str]:
    """Return the fields of `Contrasts` in which a single film misses a limit.

    Limits for a single film are relaxed by the factor `WORST`.
    """
    kept = {
        "over": felt.over >= WORST * OVER_SHARE * own.over,
        "quiet": felt.quiet >= WORST * QUIET_SHARE * own.quiet,
        "out": felt.out >= WORST * (own.out - OUT_LESS),
        "hiss": felt.hiss <= WORST * HISS_DB,
        "word": felt.word <= WORD_DB / WORST,
    }
    return [name for name, met in kept.items() if not met]


def _spread_row(
    title: str,
    unit: str,
    of: Sequence[Contrasts],
    field: str,
    column: str,
    must: Must | None = None,
) -> Row:
    # Values are rounded, so that a value near 0 is displayed as 0.
    values = [round(getattr(one, field), 3) for one in of]
    return Row(title, float(np.mean(values)), unit, column, must, min(values), max(values))


def _mean(of: Sequence[Contrasts], field: str) -> float:
    return float(np.mean([getattr(one, field) for one in of]))


def film_series(methods: Sequence[Method], film: Film) -> Series:
    """Return levels of a film's sound and vibrations, and times of sudden sounds and of parts.

    A level is the maximum within 0.1 s, in dB relative to the dialogue. The times are those at
    which explosions or drums start and parts end, in s.
    """
    levels = {SOUND: heard_db(film.sound, SAMPLERATE)}
    levels |= {
        each.name: felt_levels_db(each.vibration(film.sound), SAMPLERATE) for each in methods
    }
    dialogue = steps(film.dialogue, SAMPLERATE)
    series = {
        f"{FILM}{name}": tuple(np.round(_shown(each) - loud_db(each[dialogue]), 2).tolist())
        for name, each in levels.items()
    }
    ends = (film.dialogue, film.quiet, film.action, film.hiss)
    series[PARTS] = tuple(each.stop / SAMPLERATE for each in ends)
    series[BLOWS] = tuple(each / SAMPLERATE for each in film.strokes)
    return series


def _shown(levels: FloatArray) -> FloatArray:
    every = round(SHOWN_S * STEPS_A_SECOND)
    return np.asarray(levels[: levels.size // every * every].reshape(-1, every).max(axis=1))


def over_music_rows(methods: Sequence[Method], mixes: Sequence[OverMusic]) -> Iterator[Row]:
    """Yield the share of impacts that raise the level of 90 ms of music by 1.5 dB or more."""
    title = f"impacts over music that add {ADDS_DB:g} dB"
    if not mixes:
        return
    heard = [added_db(each.sound, each.music, SAMPLERATE, each.at) for each in mixes]
    yield Row(title, _share(heard), "%", SOUND)
    for method in methods:
        alone: dict[int, FloatArray] = {}
        added = []
        for each in mixes:
            if id(each.music) not in alone:
                alone[id(each.music)] = _felt(method, each.music)
            felt = _felt(method, each.sound)
            added.append(added_db(felt, alone[id(each.music)], SAMPLERATE, each.at))
        yield Row(title, _share(added), "%", method.name, method.must_of_whole(">=", IMPACTS_FELT))


def _felt(method: Method, sound: FloatArray) -> FloatArray:
    return weighted(method.vibration(sound), SAMPLERATE)


def _share(added: Sequence[float]) -> float:
    return 100.0 * float(np.mean(np.array(added) >= ADDS_DB))
