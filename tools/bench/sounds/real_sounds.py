"""Recorded sounds in eight classes, which tools/fetch_sounds.sh downloads.

Sounds are (frames,) float64 at 48 kHz, the mean of all channels. They are divided into two halves.
Parameters were chosen on the half `choose`; results are reported for the half `report`.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from math import gcd
from pathlib import Path
from typing import Literal

import numpy as np
import soundfile
from scipy.signal import resample_poly

from audioflinger_hook.transform import FloatArray
from tools.bench.sounds.signals import SAMPLERATE
from tools.bench.sounds.unpack_sounds import name_hash
from tools.records import PROJECT_ROOT

SOUNDS_VARIABLE = "CUSHION_SOUNDS"
SOUNDS_FOLDER = ".cache/sounds"
SOUNDS_COMMAND = "tools/fetch_sounds.sh"

KINDS = (
    "explosions", "shots", "engines", "footsteps", "ambience", "speech", "music", "drums",
)  # fmt: skip
Half = Literal["choose", "report", "all"]
HALVES: tuple[Half, ...] = ("choose", "report", "all")
"""Parameters are chosen on `choose`; results are for `report`."""

PASSAGES, PASSAGE_S = 4, 90.0  # number of long pieces of music, and their length in s
SHORTEST_S, LONGEST_S = 0.15, 10.0
LATE_FROM_S = 10.0  # start in s of the used part of sounds over 20 s, as music starts softly


@dataclass(frozen=True, eq=False)
class RealSound:
    """One recorded sound.

    name: CLASS/FILE.
    kind: class.
    sound: (frames,) float64 at 48 kHz.
    """

    name: str
    kind: str
    sound: FloatArray


def sounds_folder() -> Path | None:
    """Return the folder of the downloaded sounds; None if it does not exist.

    The environment variable CUSHION_SOUNDS may name the folder; the default is .cache/sounds.
    """
    folder = PROJECT_ROOT / os.environ.get(SOUNDS_VARIABLE, SOUNDS_FOLDER)
    return folder if folder.is_dir() else None


def real_sounds(half: Half, a_class: int | None = None) -> tuple[RealSound, ...]:
    """Return the sounds of a half, sorted by class and name, at most 10 s of each.

    a_class: upper limit of the number of sounds of each class; None for all.
    """
    found: list[RealSound] = []
    for kind in KINDS:
        read = (RealSound(f"{kind}/{each.name}", kind, _part(each)) for each in _files(kind, half))
        long_enough = [each for each in read if each.sound.size >= SHORTEST_S * SAMPLERATE]
        found += long_enough[:a_class]
    return tuple(found)


def passages(half: Half) -> list[FloatArray]:
    """Return the first 90 s of up to four pieces of orchestral music of a half."""
    orchestral = [path for path in _files("music", half) if path.name.startswith("wesnoth")]
    long_enough = [path for path in orchestral if soundfile.info(path).duration > PASSAGE_S]
    return [_read(path, 0.0, PASSAGE_S) for path in long_enough[:PASSAGES]]


def in_half(names: Sequence[str], half: Half) -> list[str]:
    """Return the sorted names of files that belong to a half.

    The files are sorted by the hashes of their names, and assigned to the halves alternately.
    """
    by_hash = sorted(names, key=name_hash)
    chosen = {"choose": by_hash[0::2], "report": by_hash[1::2], "all": by_hash}[half]
    return sorted(chosen)


def of_kinds(sounds: Sequence[RealSound], *kinds: str) -> list[RealSound]:
    """Return the sounds that belong to the given classes."""
    return [each for each in sounds if each.kind in kinds]


def _files(kind: str, half: Half) -> list[Path]:
    folder = sounds_folder()
    if folder is None:
        return []
    names = [path.name for path in (folder / kind).glob("*.*")]
    return [folder / kind / name for name in in_half(names, half)]


def _part(path: Path) -> FloatArray:
    duration_s = soundfile.info(path).duration
    return _read(path, LATE_FROM_S if duration_s > 2.0 * LONGEST_S else 0.0, LONGEST_S)


def _read(path: Path, from_s: float, duration_s: float) -> FloatArray:
    with soundfile.SoundFile(path) as file:
        rate = file.samplerate
        file.seek(round(from_s * rate))
        frames = file.read(round(duration_s * rate), dtype="float32", always_2d=True)
    return at_rate(frames.mean(axis=1, dtype=np.float64), rate, SAMPLERATE)


def at_rate(sound: FloatArray, rate: int, wanted: int) -> FloatArray:
    """Resample a sound from `rate` to the rate `wanted`, both in Hz."""
    if rate == wanted:
        return sound
    common = gcd(rate, wanted)
    resampled: FloatArray = resample_poly(sound, wanted // common, rate // common)
    return resampled
