"""Section on attacks: how strong the first moments of a sound are, against its sustained level.

A window of 5 ms cannot separate tones less than about 200 Hz apart, and by the paper's amplitude
mapping three tones are weaker than one. So chords start too strong, until the long window is full.
"""

from __future__ import annotations

import numpy as np

from audioflinger_hook.config.profiles import parameters_of
from audioflinger_hook.transform import FloatArray
from tools.bench.measures.similarity import level_db
from tools.bench.report import Must, Row, Section
from tools.bench.sections.levels import Way
from tools.bench.sounds.signals import SAMPLERATE
from tools.bench.workbench import Workbench

TITLE = "Attacks"
FIRST, NEXT, THEN = "first 30 ms", "30 to 60 ms", "60 to 100 ms"
TIMES_S = {FIRST: (0.0, 0.03), NEXT: (0.03, 0.06), THEN: (0.06, 0.1)}
LASTING_S = (0.25, 0.5)
SOUND_S, SILENCE_S, RISE_S = 0.6, 0.2, 0.001
SOUNDS = 12
"""Of each kind; the median counts."""
HARMONICS = 10
SETTLED = Must("<=", 3.0)
"""From 60 ms on, when the long window is full."""

KINDS: dict[str, tuple[float, ...]] = {
    "tone": (1.0,),
    "note of ten harmonics": (1.0,),
    "three tones, a chord": (1.0, 1.26, 1.5),
    "chord of three notes": (1.0, 1.26, 1.5),
    "chord of five notes": (1.0, 1.26, 1.5, 2.0, 2.52),
    "white noise": (),
}
PURE = ("tone", "three tones, a chord")
LOWEST_HZ, HIGHEST_HZ = 100.0, 400.0
WAYS = ("paper", "cinema")


def attacks(bench: Workbench) -> Section:
    """Strength of the first 100 ms of a steady sound."""
    rows = []
    for name in WAYS:
        way = Way(name, parameters_of(name))
        for kind in KINDS:
            over = np.median([over_sustained_db(way, sound) for sound in sounds(kind)], axis=0)
            for when, over_db in zip(TIMES_S, over.tolist(), strict=True):
                must = SETTLED if when == THEN and name == WAYS[0] else None
                rows.append(Row(f"{kind}, `{name}`", over_db, "dB", when, must))
    return Section(
        TITLE,
        "How much stronger a steady sound is felt at its start than from "
        f"{LASTING_S[0]:g} to {LASTING_S[1]:g} s, without the latency. The median of {SOUNDS} "
        f"sounds of each kind, with roots of {LOWEST_HZ:g} to {HIGHEST_HZ:g} Hz, falling harmonics "
        "and random phases.",
        tuple(rows),
        footnote="In 10 ms no analysis can separate three low tones. In the profile `paper` "
        "several tones are weaker than one, so they start too strong; by energy there is no "
        "difference.",
    )


def sounds(kind: str) -> list[FloatArray]:
    """Return the sounds of one kind, each (frames,), silence before it."""
    random = np.random.default_rng(len(kind))
    since_s = np.arange(round(SOUND_S * SAMPLERATE)) / SAMPLERATE
    rise = np.minimum(1.0, since_s / RISE_S)
    made = []
    for _ in range(SOUNDS):
        root_hz = random.uniform(LOWEST_HZ, HIGHEST_HZ)
        sound = np.zeros(since_s.size) if KINDS[kind] else random.standard_normal(since_s.size)
        for ratio in KINDS[kind]:
            for number in range(1, 2 if kind in PURE else HARMONICS + 1):
                turns = root_hz * ratio * number * since_s + random.random()
                sound += np.sin(2.0 * np.pi * turns) / number
        sound *= 0.5 * rise / np.abs(sound).max()
        silence = round(SILENCE_S * SAMPLERATE) + int(random.integers(0, 1_000))
        made.append(np.concatenate((np.zeros(silence), sound)))
    return made


def over_sustained_db(way: Way, sound: FloatArray) -> list[float]:
    """Return the level in each of TIMES_S over the sustained level, dB."""
    felt = way.felt(sound)[-round(SOUND_S * SAMPLERATE) :]

    def between_db(from_s: float, to_s: float) -> float:
        piece = felt[round(from_s * SAMPLERATE) : round(to_s * SAMPLERATE)]
        return level_db(float(np.mean(piece**2)))

    return [between_db(*times) - between_db(*LASTING_S) for times in TIMES_S.values()]
