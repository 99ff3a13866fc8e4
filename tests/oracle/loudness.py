"""Loudness of ticks after ISO 532-1: "Loudness" in docs/transform.md. Levels are in dB; 0 dB is
that of 94 phon. s: the numbers and tables of `LoudnessDesign`."""

from typing import Any

import numpy as np
from scipy.signal import butter, lfilter, sosfilt

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.design.loudness import FULL_SCALE_DB, LOW_TOP_HZ


def at_hz(s: Any, table: FloatArray, hz: Any) -> FloatArray:
    """Return a table's values at vibration frequencies: `felt_weights` or `gain_table`."""
    return np.asarray(np.interp(hz, s.gain_step_hz * np.arange(table.size), table))


def excitation(s: Any, sound: FloatArray, short_power: FloatArray) -> FloatArray:
    """Return the excitation of each band over its threshold in quiet, (ticks, bands), of
    band-passed sound (ticks x tick_frames,) and the powers of the onset search (ticks, bins)."""
    steps = sound.reshape(-1, s.decimation)
    if 0.4 * s.samplerate / s.decimation > LOW_TOP_HZ and s.decimation > 1:
        sections = butter(5, LOW_TOP_HZ, fs=s.samplerate, output="sos")
        steps = sosfilt(sections, sound).reshape(steps.shape)
    turned = steps[:, -1]
    straight = np.concatenate([np.zeros(1), turned[:-1]])
    for square, delayed in zip(*s.quadrature.reshape(2, -1), strict=True):
        turned = lfilter([square, 0.0, -1.0], [1.0, 0.0, -square], turned)
        straight = lfilter([delayed, 0.0, -1.0], [1.0, 0.0, -delayed], straight)
    bands = np.zeros((len(short_power), s.loudness_scale.size))
    for (real, imaginary, feed), weight, band in zip(
        s.low_poles.reshape(-1, 3), s.low_weights, s.low_band_of.astype(int), strict=True
    ):
        pole = [1.0, -complex(real, imaginary)]
        heard = lfilter([feed], pole, lfilter([feed], pole, straight + 1j * turned))
        squares = (heard.real**2 + heard.imag**2).reshape(-1, s.tick_steps)
        bands[:, band] += weight * squares.sum(axis=1)
    if s.high_weights.size:
        edges = s.high_edges.astype(int)
        powers = np.add.reduceat(short_power[:, : edges[-1]], edges[:-1], axis=1) * s.high_weights
        average = np.ones(s.average_ticks) / s.average_ticks
        bands[:, -s.high_weights.size :] = lfilter(average, [1.0], powers, axis=0)
    return bands


def loudness(s: Any, bands: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the loudness level of ticks in dB, and in sone that of all bands, each (ticks,), and
    of each group by itself (ticks, groups), from excitations (ticks, bands)."""
    root = (0.75 + 0.25 * bands) ** 0.25  # by the threshold factor of ISO 532-1, 0.25
    cores = np.maximum(0.0, s.loudness_scale * (root - 1.0))
    sone, above = np.zeros((2, len(bands)))
    for core, width in zip(cores.T, s.loudness_widths, strict=True):
        # The slope above a louder band hides softer ones.
        slope = s.slope_a_bark / np.maximum(above, 1e-300) ** 0.25
        left = np.where(above > core, above * np.exp(-slope * width), 0.0)
        tail = np.where(above > core, (above - left) / slope, 0.0)
        sone = sone + np.maximum(core * width, tail)
        above = np.maximum(core, left)
    groups = np.add.reduceat(cores * s.loudness_widths, s.loudness_groups[:-1].astype(int), axis=1)
    loud = 40.0 + 10.0 * np.log2(np.maximum(sone, 1.0))
    level = np.where(sone >= 1.0, loud, 40.0 * (sone + 5e-4) ** 0.35) - FULL_SCALE_DB
    return level, sone, groups
