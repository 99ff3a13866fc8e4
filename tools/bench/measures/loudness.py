"""Loudness by ISO 532-1:2017 (Zwicker's method for time-varying sounds), with a cache.

The computation follows MoSQITo (https://github.com/Eomys/MoSQITo) and calls its functions. Only the
nonlinear decay is simpler: it takes one step instead of 24 for each 0.5 ms.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter

from audioflinger_hook.transform import FloatArray
from device.atomic_file import write_bytes_atomically
from tools.bench.measures.felt import EXCEEDED
from tools.bench.sounds.signals import SAMPLERATE
from tools.records import PROJECT_ROOT

FULL_SCALE_PA = 2e-5 * 10.0 ** (94.0 / 20.0) * math.sqrt(2.0)  # 94 dB SPL for a full-scale sine
STEP_S = 0.0005
SLOPE_STEPS = 4  # steps of `STEP_S` between two values of specific loudness
SHORT_S, LONG_S, VARIABLE_S = 0.005, 0.015, 0.075  # time constants of nonlinear decay in s
WEIGHTS = ((0.47, 0.0035), (0.53, 0.070))  # weights and time constants in s (ISO 532-1, 6.5)
CACHE = PROJECT_ROOT / ".cache/loudness.json"
METHOD = "ISO 532-1, 94 dB"


def loudness_sone(sound: FloatArray) -> FloatArray:
    """Return the loudness in sone for each 0.5 ms of a sound.

    sound: (frames,) at 48 kHz; a full-scale sine has 94 dB SPL.

    ModuleNotFoundError: MoSQITo is not installed.
    """
    from mosqito.sq_metrics.loudness.loudness_zwst._calc_slopes import _calc_slopes
    from mosqito.sq_metrics.loudness.loudness_zwst._main_loudness import _main_loudness
    from mosqito.sq_metrics.loudness.loudness_zwtv._third_octave_levels import _third_octave_levels

    levels, _, _ = _third_octave_levels(FULL_SCALE_PA * sound, SAMPLERATE)
    core = decayed(_main_loudness(levels, "free"))
    total, _ = _calc_slopes(core[:, ::SLOPE_STEPS])
    steps = np.arange(core.shape[1])
    fine = np.interp(steps, steps[::SLOPE_STEPS], total)
    loudness = np.zeros(fine.size)
    for share, time_s in WEIGHTS:
        kept = math.exp(-STEP_S / time_s)
        loudness += share * lfilter([1.0 - kept], [1.0, -kept], fine)
    return loudness


def decayed(core: FloatArray) -> FloatArray:
    """Return core loudness, (bands, steps), with the gradual decay of loudness after each sound.

    Each band is modelled by a circuit with two capacitors (ISO 532-1, 6.4 and the program in annex
    A). The output decays fast until the voltages of both capacitors are equal, and then with a time
    constant of 15 ms.
    """
    sum_, product = (VARIABLE_S + LONG_S) / (VARIABLE_S * SHORT_S), 1.0 / (SHORT_S * VARIABLE_S)
    root = math.sqrt(sum_**2 / 4.0 - product)
    one, two = -sum_ / 2.0 + root, -sum_ / 2.0 - root
    e1, e2 = math.exp(one * STEP_S), math.exp(two * STEP_S)
    t1, t2, scale = VARIABLE_S * one + 1.0, VARIABLE_S * two + 1.0, VARIABLE_S * (one - two)
    b0, b1 = (e1 - e2) / scale, (t2 * e1 - t1 * e2) / scale
    b2, b3 = (t1 * e1 - t2 * e2) / scale, t1 * t2 * (e1 - e2) / scale
    b4, b5 = math.exp(-STEP_S / LONG_S), math.exp(-STEP_S / VARIABLE_S)
    out = np.empty_like(core)
    last, second = np.zeros(len(core)), np.zeros(len(core))
    for step, now in enumerate(core.T):
        discharging = last > second
        fallen = np.where(discharging, last * b2 - second * b3, last * b4)
        falls = now < last
        value = np.where(falls, np.maximum(fallen, now), now)
        loaded = (second - now) * b5 + now
        coupled = np.where(discharging, np.minimum(last * b0 - second * b1, value), value)
        second = np.where(falls, coupled, loaded)
        out[:, step] = last = value
    return out


def phon(sone: FloatArray) -> FloatArray:
    """Convert loudness in sone to phon, at least 3 (ISO 532-1, equations (31) and (32))."""
    sone = np.maximum(sone, 1e-9)
    level = np.where(sone >= 1.0, 40.0 + 10.0 * np.log2(sone), 40.0 * (sone + 0.0005) ** 0.35)
    return np.maximum(level, 3.0)


def n5_phon(sound: FloatArray, tail_s: float) -> float:
    """Return the loudness level in phon that is exceeded 5 % of the time.

    tail_s: duration in s of the silence that is appended to the sound.
    """

    def compute() -> list[float]:
        padded = np.concatenate((sound, np.zeros(round(tail_s * SAMPLERATE))))
        sone = loudness_sone(padded)
        return [float(phon(np.percentile(sone, [100.0 * (1.0 - EXCEEDED)]))[0])]

    return _cached(f"N5, {tail_s:g} s", sound, compute)[0]


def slow_phon(sound: FloatArray, every_s: float) -> FloatArray:
    """Return the loudness level in phon that corresponds to the mean loudness of each complete
    piece.

    every_s: duration of a piece in s.
    """

    def compute() -> list[float]:
        steps = round(every_s / STEP_S)
        sone = loudness_sone(sound)
        pieces = sone[: sone.size // steps * steps].reshape(-1, steps)
        levels: list[float] = phon(pieces.mean(axis=1)).tolist()
        return levels

    return np.array(_cached(f"every {every_s:g} s", sound, compute))


def momentary_sone(sound: FloatArray, every_s: float) -> FloatArray:
    """Return the mean loudness in sone of each complete piece of a sound.

    every_s: duration of a piece in s.
    """

    def compute() -> list[float]:
        steps = round(every_s / STEP_S)
        sone = loudness_sone(sound)
        means: list[float] = (
            sone[: sone.size // steps * steps].reshape(-1, steps).mean(axis=1).tolist()
        )
        return means

    return np.array(_cached(f"sone, {every_s:g} s", sound, compute))


_memory: dict[str, list[float]] = {}


def _cached(what: str, sound: FloatArray, compute: Callable[[], list[float]]) -> list[float]:
    if not _memory and CACHE.exists():
        _memory.update(json.loads(CACHE.read_text("utf-8")))
    digest = hashlib.sha256(sound.astype(np.float32).tobytes()).hexdigest()[:32]
    key = f"{METHOD}, {what}, {digest}"
    if key not in _memory:
        _memory[key] = [round(value, 3) for value in compute()]
        CACHE.parent.mkdir(exist_ok=True)
        write_bytes_atomically(CACHE, json.dumps(_memory, indent=0).encode())
    return _memory[key]
