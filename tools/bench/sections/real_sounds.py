"""Section on real sounds: what is felt of them against what is heard, by profile and by method."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from typing import Any

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.transform import FloatArray, HapticTransform
from tools.bench.baselines import BASELINES
from tools.bench.report import Missing, Row, Section
from tools.bench.sections.felt_formats import (
    channel_rows,
    chirp_rows,
    end_rows,
    rate_rows,
    sub_bass_rows,
)
from tools.bench.sections.felt_levels import (
    Felt,
    Series,
    crescendo_rows,
    law_of,
    level_rows,
    orchestral_rows,
)
from tools.bench.sections.felt_times import impact_rows, steady_rows
from tools.bench.sounds.real_sounds import (
    SOUNDS_COMMAND,
    Half,
    RealSound,
    passages,
    real_sounds,
)
from tools.bench.workbench import Subject, Workbench

TITLE = "On real sounds"
SETUP_COMMAND = "tools/setup.sh test"

UNLIMITED = "paper"
"""The profile that keeps to the paper and is asked no limit here."""
PEERS_LAW = "cinema"
"""The profile whose law other methods are held against: they have none of their own."""

PARTS = (
    "crescendo", "music", "levels", "impacts", "steadiness", "sub-bass", "chirp", "rates",
    "channels", "ends",
)  # fmt: skip
"""What can be measured by itself, in the order of the table."""

Progress = Callable[[str], None]


def profiles_felt(
    names: Iterable[str] = PROFILES, said: dict[str, Any] | None = None
) -> list[Felt]:
    """Return profiles to be measured; said: parameters that override those of each of them."""
    found = []
    for name in names:
        parameters = parameters_of(name, said)
        subject = Subject(name, partial(HapticTransform, parameters=parameters))
        found.append(Felt(subject, law_of(parameters), name != UNLIMITED, parameters))
    return found


def peers_felt() -> list[Felt]:
    """Return the other methods, held against the law of a profile."""
    law = law_of(parameters_of(PEERS_LAW))
    return [Felt(subject, law) for subject in BASELINES]


def felt_on_real_sounds(
    profiles: Sequence[Felt],
    peers: Sequence[Felt],
    sounds: Sequence[RealSound],
    music: Sequence[FloatArray],
    parts: Sequence[str] = PARTS,
    progress: Progress | None = None,
) -> Section:
    """Return the section of these profiles and other methods on these sounds."""
    methods = [*profiles, *peers]
    series: Series = {}
    measured: dict[str, Callable[[], Iterable[Row]]] = {
        "crescendo": lambda: crescendo_rows(methods, series),
        "music": lambda: orchestral_rows(methods, music),
        "levels": lambda: level_rows(methods, sounds, series),
        "impacts": lambda: impact_rows(methods, sounds, series),
        "steadiness": lambda: steady_rows(methods, sounds, series),
        "sub-bass": lambda: sub_bass_rows(methods),
        "chirp": lambda: chirp_rows(methods),
        "rates": lambda: rate_rows(profiles, sounds),
        "channels": lambda: channel_rows(profiles, sounds),
        "ends": lambda: end_rows(profiles, sounds),
    }
    rows: list[Row] = []
    for name in parts:
        started = time.monotonic()
        rows += measured[name]()
        if progress:
            progress(f"{name}: {time.monotonic() - started:.1f} s")
    laws = ", ".join(f"{each.name} {each.law:.3g}" for each in profiles)
    count = Counter(each.kind for each in sounds)
    listed = ", ".join(f"{kind} {number}" for kind, number in count.items())
    return Section(
        TITLE,
        "Heard is the loudness level N5 by ISO 532-1, a full-scale sine as 94 dB SPL. Felt is the "
        "running r.m.s. (125 ms) of the vibration that is exceeded in a twentieth of the time, "
        "weighted by Wk of ISO 2631-1 without its band limit at 100 Hz. The law of a profile is "
        f"its dB of vibration for a phon: {laws}; methods without a law are held against that of "
        f"{PEERS_LAW}. Lags contain the latency.",
        tuple(rows),
        series=series,
        footnote=f"Sounds: {len(sounds)} ({listed}), fetched by {SOUNDS_COMMAND}.",
    )


def on_real_sounds(bench: Workbench) -> Section:
    """Every profile and baseline on the half of the sounds that no value was chosen on."""
    sounds = real_sounds("report", bench.effort.real_sounds)
    if not sounds:
        return _missing("there are no sounds", SOUNDS_COMMAND)
    if find_spec("mosqito") is None:
        return _missing("MoSQITo, which computes loudness, is not installed", SETUP_COMMAND)
    music = passages("report")[: bench.effort.real_sounds]
    return felt_on_real_sounds(profiles_felt(), peers_felt(), sounds, music)


def _missing(reason: str, command: str) -> Section:
    gone = Missing(f"every row of {TITLE}", reason, command)
    return Section(TITLE, "This could not be measured here.", (), (gone,))


def chosen(
    half: Half,
    names: Sequence[str],
    said: dict[str, Any],
    peers: bool,
    parts: Sequence[str],
    progress: Progress,
) -> Section:
    """Return parts of the section on a half, for some profiles with changed parameters."""
    methods, others = profiles_felt(names, said), peers_felt() if peers else []
    section = felt_on_real_sounds(
        methods, others, real_sounds(half), passages(half), parts, progress
    )
    return replace(section, footnote=f"{section.footnote} Half of the sounds: {half}.")
