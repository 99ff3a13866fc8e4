"""Fluctuations in the strength of a vibration and of its sound. Signals are (frames,)."""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfiltfilt

from audioflinger_hook.transform import FloatArray
from tools.bench.measures.impacts import envelope

WARBLE_HZ = (4.0, 16.0)  # modulation frequencies in Hz that are perceived best
SYLLABLES_HZ, LATEST_S = (2.0, 16.0), 0.08
ENVELOPE_RATE_HZ = 1_000
RISE_DB, RISE_CORNER_HZ = 6.0, 30.0
FAINTEST_DB = -40.0  # lowest level in dB relative to the maximum; lower levels are set to it
TOGETHER_S = 0.1  # largest distance in s between matching rises of vibration and sound


def warble(vibration: FloatArray, samplerate: int) -> float:
    """Return the depth of the modulation of a vibration's envelope at 4 to 16 Hz, 1 for 100 %."""
    level = _slow(vibration, samplerate, 60.0)
    mean = float(level.mean())
    if not mean > 0.0:
        return 0.0
    band = butter(2, WARBLE_HZ, "bandpass", fs=ENVELOPE_RATE_HZ, output="sos")
    swings = sosfiltfilt(band, level - mean)
    return float(np.sqrt(2.0) * swings.std() / mean)


def syllables_alike(sound: FloatArray, vibration: FloatArray, samplerate: int) -> float:
    """Return the Pearson correlation of the envelopes of sound and vibration.

    The envelopes are band-passed at 2 to 16 Hz, which includes the rate of syllables. The result is
    the largest correlation for delays of the vibration from 0 to 80 ms.
    """
    band = butter(2, SYLLABLES_HZ, "bandpass", fs=ENVELOPE_RATE_HZ, output="sos")
    heard, felt = (
        sosfiltfilt(band, _slow(signal, samplerate, RISE_CORNER_HZ))
        for signal in (sound, vibration)
    )
    if not heard.std() > 0.0 or not felt.std() > 0.0:
        return 0.0
    delays = range(0, round(LATEST_S * ENVELOPE_RATE_HZ) + 1, 5)
    return max(float(np.corrcoef(heard[: heard.size - late], felt[late:])[0, 1]) for late in delays)


def rises_s(signal: FloatArray, samplerate: int) -> FloatArray:
    """Return the time in s of each rise of the envelope by 6 dB or more.

    A rise goes from a minimum to a maximum, without a fall of 6 dB between them. Its time is the
    time at which half of the rise in dB is reached.
    """
    level = _slow(signal, samplerate, RISE_CORNER_HZ)
    top = float(level.max())
    if not top > 0.0:
        return np.zeros(0)
    level_db = 20.0 * np.log10(np.maximum(level / top, 10.0 ** (FAINTEST_DB / 20.0)))
    found: list[float] = []
    low, high, rising = 0, 0, False
    for now, here in enumerate(level_db.tolist()):
        if rising:
            if here > level_db[high]:
                high = now
            elif here <= level_db[high] - RISE_DB:
                found.append(_half_way(level_db, low, high))
                low, rising = now, False
        elif here < level_db[low]:
            low = now
        elif here >= level_db[low] + RISE_DB:
            high, rising = now, True
    if rising:
        found.append(_half_way(level_db, low, high))
    return np.array(found) / ENVELOPE_RATE_HZ


def rises_of_its_own(sound: FloatArray, vibration: FloatArray, samplerate: int) -> float:
    """Count the rises of the vibration that are more than 0.1 s away from any rise of the sound.

    The result is their number for each second of sound.
    """
    theirs, own = rises_s(sound, samplerate), rises_s(vibration, samplerate)
    if not own.size:
        return 0.0
    apart = np.abs(own[:, None] - theirs[None, :]).min(axis=1, initial=np.inf)
    return float(np.count_nonzero(apart > TOGETHER_S) * samplerate / sound.size)


def _half_way(level_db: FloatArray, low: int, high: int) -> float:
    middle = 0.5 * (level_db[low] + level_db[high])
    return float(low + int((level_db[low : high + 1] >= middle).argmax()))


def _slow(signal: FloatArray, samplerate: int, corner_hz: float) -> FloatArray:
    every = samplerate // ENVELOPE_RATE_HZ
    return np.asarray(envelope(signal, samplerate, corner_hz)[::every])
