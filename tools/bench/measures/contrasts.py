"""Levels of sounds and vibrations over time, and changes of level that sudden sounds cause.

Levels are in dB relative to a full-scale sine, at least -70, one for each ms. A level is the r.m.s.
of the last 125 ms. A stroke is a sudden sound, for example an explosion or a drum.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.signal import butter, sosfilt

from audioflinger_hook.transform import FloatArray
from tools.bench.measures.felt import NOTHING_DB, weighted

LEVEL_S = 0.125
STEPS_A_SECOND = 1_000
HEARD_FROM_HZ = 90.0  # lowest frequency of small loudspeakers; seats vibrate at lower ones too
STROKE_S = 0.5  # a stroke's strength is the maximum level in this time in s after its onset
RISE_S = 0.25  # a rise is the maximum level in this time in s, minus the level at its start
UNUSUAL = 90.0  # a rise is salient if it exceeds this percentile of the rises at other times
TOUCHED = 5  # steps after a stroke's onset that also belong to its rise
LOUDEST = 95.0
ADDED_S = 0.09


def levels_db(signal: FloatArray, samplerate: int) -> FloatArray:
    """Return the level of a signal at the end of each ms. samplerate: in Hz, a multiple of 1000."""
    step = samplerate // STEPS_A_SECOND
    whole = signal[: signal.size // step * step].reshape(-1, step)
    energy = np.concatenate(([0.0], np.cumsum(np.einsum("ij,ij->i", whole, whole))))
    width = round(LEVEL_S * STEPS_A_SECOND)
    first = np.maximum(np.arange(1, energy.size) - width, 0)
    mean = (energy[1:] - energy[first]) / (width * step)
    levels: FloatArray = 10.0 * np.log10(np.maximum(2.0 * mean, 10.0 ** (NOTHING_DB / 10.0)))
    return levels


def heard_db(sound: FloatArray, samplerate: int) -> FloatArray:
    """Return the levels of a sound after a high-pass at 90 Hz."""
    high_pass = butter(2, HEARD_FROM_HZ, "highpass", fs=samplerate, output="sos")
    return levels_db(np.asarray(sosfilt(high_pass, sound)), samplerate)


def felt_levels_db(vibration: FloatArray, samplerate: int) -> FloatArray:
    """Return the levels of a vibration, weighted for perceived strength by `felt.weighted`."""
    return levels_db(weighted(vibration, samplerate), samplerate)


def steps(frames: slice, samplerate: int) -> slice:
    """Convert a range of frames to the range of indices of levels for the same time."""
    return slice(
        *(round(each * STEPS_A_SECOND / samplerate) for each in (frames.start, frames.stop))
    )


def loud_db(levels: FloatArray) -> float:
    """Return the level that is exceeded 5 % of the time."""
    return float(np.percentile(levels, LOUDEST))


def strokes_db(levels: FloatArray, strokes: FloatArray) -> FloatArray:
    """Return the highest level in the 0.5 s after each stroke begins.

    strokes: index in `levels` at which each stroke begins.
    """
    after = round(STROKE_S * STEPS_A_SECOND)
    return np.array([float(levels[at : at + after].max()) for at in strokes.astype(int)])


def rises_db(levels: FloatArray) -> FloatArray:
    """Return, for each level, the highest level of the next 0.25 s minus this level, in dB.

    The last 0.25 s have no result.
    """
    after = round(RISE_S * STEPS_A_SECOND)
    # The filter's window is centred by default; this origin lets it start at each step.
    around = maximum_filter1d(levels, after + 1, origin=-(after // 2))
    rises: FloatArray = (around - levels)[: levels.size - after]
    return rises


def standing_out(levels: FloatArray, strokes: FloatArray) -> float:
    """Return the share of strokes, in %, at which the level rises more than at 90 % of other times.

    strokes: index in `levels` at which each stroke begins.
    """
    rises = rises_db(levels)
    begin = strokes.astype(int)
    ahead = begin[None, :] - np.arange(rises.size)[:, None]
    other = ~((ahead > -TOUCHED) & (ahead <= round(RISE_S * STEPS_A_SECOND))).any(axis=1)
    usual = np.percentile(rises[other], UNUSUAL)
    return 100.0 * float(np.mean(rises[begin] > usual))


def added_db(both: FloatArray, alone: FloatArray, samplerate: int, at: int) -> float:
    """Return by how many dB a stroke raises the energy of the 90 ms after frame `at`.

    both: signal with the stroke.
    alone: signal without the stroke.
    """
    end = at + round(ADDED_S * samplerate)
    energies = [float((each[at:end] ** 2).mean()) + 1e-10 for each in (both, alone)]
    return 10.0 * float(np.log10(energies[0] / energies[1]))
