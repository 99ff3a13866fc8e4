"""A synthetic recording of objects struck in a room; one has the paper's five frequencies.

The paper describes its own sound only in Figure 7. There, the principal frequencies from 1.811 to
1.857 s are 100, 350, 950, 1350 and 4200 Hz. In this recording, a struck object rings at these
frequencies during the same time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from audioflinger_hook.scenes.shaping import band, curve, finished, pan, ring, room
from device.units import FloatArray

SAMPLERATE = 48_000
DURATION_S = 2.6
PEAK = 0.5
SEED = 2_617

FIVE_HZ = (100.0, 350.0, 950.0, 1_350.0, 4_200.0)

ROOM_NOISE = 6e-4
_CONTACT_S = 0.004
_MUTING_S = 0.012


@dataclass(frozen=True)
class Strike:
    """An object struck at `start_s`. position: -1 (left) to 1. contact: amplitude of contact noise.

    modes: resonances, (Hz, amplitude, time in s of a decay by 60 dB). muted_s: time at which the
        object is muted, or None.
    """

    start_s: float
    position: float
    contact: float
    modes: tuple[tuple[float, float, float], ...]
    muted_s: float | None = None


_THUD = ((72.0, 0.50, 0.35), (131.0, 0.30, 0.25), (243.0, 0.12, 0.16))
_BLOCK = ((524.0, 0.40, 0.22), (1_180.0, 0.24, 0.16), (2_650.0, 0.14, 0.10))
_STRING = ((332.0, 0.60, 1.10), (667.0, 0.24, 0.60), (1_004.0, 0.12, 0.40))
_BODY = tuple(
    zip(FIVE_HZ, (0.34, 0.40, 0.22, 0.18, 0.12), (0.90, 1.00, 0.70, 0.60, 0.45), strict=True)
)

STRIKES = (
    Strike(0.22, -0.5, 0.10, _THUD),
    Strike(0.66, 0.6, 0.16, _BLOCK),
    Strike(1.04, -0.2, 0.10, _THUD),
    Strike(1.49, 0.3, 0.14, _STRING, muted_s=1.604),
    Strike(1.78, 0.0, 0.12, _BODY, muted_s=1.932),
    Strike(2.24, 0.6, 0.16, _BLOCK),
)


def recording() -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """Return 2.6 s of stereo sound, (frames, 2) float32 at 48 kHz, peak 0.5, always the same."""
    rng = np.random.default_rng(SEED)
    frames: FloatArray = np.zeros((round(DURATION_S * SAMPLERATE), 2))
    for strike in STRIKES:
        first = round(strike.start_s * SAMPLERATE)
        sound = _struck(strike, len(frames) - first, rng)
        frames[first:] += pan(sound, strike.position)
    frames = room(frames, SAMPLERATE, rng, decay_s=0.25, level=0.004)
    noise = rng.standard_normal(frames.shape)
    frames += ROOM_NOISE * band(noise, 60.0, 3_000.0, SAMPLERATE, order=1)
    return finished(frames, SAMPLERATE, peak=PEAK, fade_in_s=0.02, fade_out_s=0.1)


def _struck(strike: Strike, frames: int, rng: np.random.Generator) -> FloatArray:
    blow = np.zeros(frames)
    blow[0] = 1.0
    sound = np.zeros(frames)
    for frequency_hz, amplitude, decay_s in strike.modes:
        sound += amplitude * ring(blow, frequency_hz, decay_s, SAMPLERATE)
    time_s = np.arange(frames) / SAMPLERATE
    if strike.muted_s is not None:
        muted_s = strike.muted_s - strike.start_s
        sound *= curve(time_s, [(muted_s, 1.0), (muted_s + _MUTING_S, 0.0)])
    fading = curve(time_s, [(0.0, strike.contact), (_CONTACT_S, 0.0)])
    return sound + fading * band(rng.standard_normal(frames), 500.0, 8_000.0, SAMPLERATE)
