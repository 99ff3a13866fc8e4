"""Strong against weak in one programme: levels, rises, and what stands out. Pure functions.

Levels are in dB, every ms: the r.m.s. of the last 125 ms, a full-scale sine at 0, at least -70.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.signal import butter, sosfilt

from audioflinger_hook.transform import FloatArray
from tools.bench.measures.felt import NOTHING_DB, weighted

LEVEL_S = 0.125
STEPS_A_SECOND = 1_000
HEARD_FROM_HZ = 90.0
"""What is under it, small loudspeakers do not play and a seat plays anyway."""
STROKE_S = 0.5
"""A stroke is as strong as its strongest moment within that time."""
RISE_S = 0.25
"""A rise goes to the strongest moment within that time."""
UNUSUAL = 90.0
"""A rise stands out if it exceeds this percentile of those at other moments."""
TOUCHED = 5
"""Steps after a stroke's onset that belong to its rise, too."""
LOUDEST = 95.0
ADDED_S = 0.09


def levels_db(signal: FloatArray, samplerate: int) -> FloatArray:
    """Return the level at the end of every ms; samplerate: Hz, a multiple of 1000."""
    step = samplerate // STEPS_A_SECOND
    whole = signal[: signal.size // step * step].reshape(-1, step)
    energy = np.concatenate(([0.0], np.cumsum(np.einsum("ij,ij->i", whole, whole))))
    width = round(LEVEL_S * STEPS_A_SECOND)
    first = np.maximum(np.arange(1, energy.size) - width, 0)
    mean = (energy[1:] - energy[first]) / (width * step)
    levels: FloatArray = 10.0 * np.log10(np.maximum(2.0 * mean, 10.0 ** (NOTHING_DB / 10.0)))
    return levels


def heard_db(sound: FloatArray, samplerate: int) -> FloatArray:
    """Return the levels of a sound over 90 Hz."""
    high_pass = butter(2, HEARD_FROM_HZ, "highpass", fs=samplerate, output="sos")
    return levels_db(np.asarray(sosfilt(high_pass, sound)), samplerate)


def felt_levels_db(vibration: FloatArray, samplerate: int) -> FloatArray:
    """Return the levels of a vibration as it is felt: above 12.5 Hz, those of its velocity."""
    return levels_db(weighted(vibration, samplerate), samplerate)


def steps(frames: slice, samplerate: int) -> slice:
    """Return the steps of levels that belong to a place in frames."""
    return slice(
        *(round(each * STEPS_A_SECOND / samplerate) for each in (frames.start, frames.stop))
    )


def loud_db(levels: FloatArray) -> float:
    """Return the level that is exceeded in a twentieth of the time."""
    return float(np.percentile(levels, LOUDEST))


def strokes_db(levels: FloatArray, strokes: FloatArray) -> FloatArray:
    """Return how strong each stroke is; strokes: the steps at which they begin."""
    after = round(STROKE_S * STEPS_A_SECOND)
    return np.array([float(levels[at : at + after].max()) for at in strokes.astype(int)])


def rises_db(levels: FloatArray) -> FloatArray:
    """Return for every step how far the level rises within 0.25 s; shorter than the levels."""
    after = round(RISE_S * STEPS_A_SECOND)
    # The filter's window lies around its step.
    around = maximum_filter1d(levels, after + 1, origin=-(after // 2))
    rises: FloatArray = (around - levels)[: levels.size - after]
    return rises


def standing_out(levels: FloatArray, strokes: FloatArray) -> float:
    """Return the share of strokes whose rise exceeds nine tenths of all other rises, %.

    strokes: the steps at which they begin; the other rises are those of all steps of the programme
    whose rise does not go up to a stroke.
    """
    rises = rises_db(levels)
    begin = strokes.astype(int)
    ahead = begin[None, :] - np.arange(rises.size)[:, None]
    other = ~((ahead > -TOUCHED) & (ahead <= round(RISE_S * STEPS_A_SECOND))).any(axis=1)
    usual = np.percentile(rises[other], UNUSUAL)
    return 100.0 * float(np.mean(rises[begin] > usual))


def added_db(both: FloatArray, alone: FloatArray, samplerate: int, at: int) -> float:
    """Return by how much a stroke at a frame raises the level of the 90 ms after it."""
    end = at + round(ADDED_S * samplerate)
    energies = [float((each[at:end] ** 2).mean()) + 1e-10 for each in (both, alone)]
    return 10.0 * float(np.log10(energies[0] / energies[1]))
