"""Speech and other sounds for measuring the suppression of speech, in two halves.

The parameters of the suppression were chosen on the first half. Signals are (frames,) float64 at 48
kHz.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import resample_poly

from audioflinger_hook.scenes import Scene, demo_scene
from audioflinger_hook.transform import FloatArray
from tools.bench.sounds.signals import SAMPLERATE, Recording, chord, tone

CHOSEN_ON, OTHER_HALF = "chosen on", "other half"
HALVES = (CHOSEN_ON, OTHER_HALF)
LOUDNESS_DB = -22.0  # r.m.s. level of the active parts of a sound, relative to full scale
SOUNDING_DB = -30.0  # lowest level of an active part, relative to the sound's maximum
LEVEL_S = 0.05
PAUSE_S = 0.1  # pause in s between consecutive speech recordings


def even(sound: FloatArray) -> FloatArray:
    """Scale a sound so that its r.m.s. without pauses is -22 dB relative to full scale."""
    power = uniform_filter1d(sound**2, round(LEVEL_S * SAMPLERATE), mode="constant")
    sounding = power > power.max() * 10 ** (SOUNDING_DB / 10)
    rms = float(np.sqrt((sound[sounding] ** 2).mean()))
    level: FloatArray = sound * (10 ** (LOUDNESS_DB / 20) / rms)
    return level


def repeated(sound: FloatArray, duration_s: float) -> FloatArray:
    """Repeat or cut a sound to a duration in s."""
    again: FloatArray = np.resize(sound, round(duration_s * SAMPLERATE))
    return again


@functools.cache
def _demo() -> Scene:
    return demo_scene()


def scene_track(name: str) -> FloatArray:
    """Return one track of the demo scene, mixed to mono at 48 kHz."""
    (track,) = [track for track in _demo().tracks if track.name == name]
    mono = np.asarray(track.frames, dtype=np.float64).mean(axis=1)
    if track.samplerate != SAMPLERATE:
        mono = resample_poly(mono, SAMPLERATE, track.samplerate)
    return even(mono)


def spoken(recordings: Sequence[Recording]) -> dict[str, FloatArray]:
    """Return the joined speech recordings of each half. The same voice speaks in both halves."""
    files = [item for item in recordings if item.is_speech]
    pause = np.zeros(round(PAUSE_S * SAMPLERATE))
    halves = {}
    for half in HALVES:
        mine = [item for item in files if _is_front(item) == (half == CHOSEN_ON)]
        parts = [part for item in mine for part in (even(_mono(item)), pause)]
        if parts:
            halves[half] = np.concatenate(parts)
    return halves


def _is_front(recording: Recording) -> bool:
    return recording.name.startswith("Front") or recording.name == "Side_Left"


def _mono(recording: Recording) -> FloatArray:
    mono: FloatArray = recording.frames.mean(axis=1, dtype=np.float64)
    return mono


def desktop(recordings: Sequence[Recording]) -> dict[str, list[Recording]]:
    """Return sounds of desktop events by half, without spoken names of channels."""
    others = [
        item
        for item in recordings
        if not item.is_speech and not item.name.startswith("audio-channel") and item.name != "Noise"
    ]
    return {CHOSEN_ON: others[::2], OTHER_HALF: others[1::2]}


def no_speech(duration_s: float) -> dict[str, dict[str, FloatArray]]:
    """Return sounds without speech, by half and by name."""
    return {
        CHOSEN_ON: {
            name: repeated(scene_track(name), duration_s)
            for name in ("engine", "footsteps", "explosion", "chord")
        },
        OTHER_HALF: {
            "shots": even(shots(duration_s)),
            "motor": even(motor(duration_s)),
            "chord, 10 partials": even(chord(duration_s)[:, 0].astype(np.float64)),
            "noise that swells at 4 Hz": even(swelling_noise(duration_s)),
            "notes on a string": even(notes(duration_s)),
            "beeps": even(beeps(duration_s)),
            "siren": even(siren(duration_s)),
        },
    }


def _time_s(duration_s: float) -> FloatArray:
    return np.arange(round(duration_s * SAMPLERATE)) / SAMPLERATE


def shots(duration_s: float) -> FloatArray:
    """Return gunfire: nine shots in 1 s, then a pause of 1 s, repeated.

    A shot is noise that decays by a factor e in 25 ms.
    """
    time_s = _time_s(duration_s)
    noise = np.random.default_rng(3).standard_normal(time_s.size)
    firing = time_s % 2.0 < 1.0
    return firing * noise * np.exp(-(time_s * 9.0 % 1.0) / 9.0 / 0.025)


def motor(duration_s: float) -> FloatArray:
    """Return a motor sound: 29 harmonics of a fundamental that sweeps from 15 to 55 Hz and back."""
    time_s = _time_s(duration_s)
    turns = np.cumsum(35.0 + 20.0 * np.sin(2.0 * np.pi * 0.3 * time_s)) / SAMPLERATE
    total = np.zeros(time_s.size)
    for harmonic in range(1, 30):
        total += harmonic**-0.8 * np.sin(2.0 * np.pi * harmonic * turns + harmonic**2)
    return total


def swelling_noise(duration_s: float) -> FloatArray:
    """Return noise whose amplitude is modulated at 4 Hz, as in speech."""
    time_s = _time_s(duration_s)
    noise = np.random.default_rng(4).standard_normal(time_s.size)
    return noise * (1.0 + 0.95 * np.sin(2.0 * np.pi * 4.0 * time_s))


def notes(duration_s: float) -> FloatArray:
    """Return a melody of a string instrument: three notes each second, with vibrato."""
    time_s = _time_s(duration_s)
    steps = np.array([0, 4, 7, 5, 2, 9, 12, 7])[(time_s * 3.0).astype(int) % 8]
    pitch_hz = 196.0 * 2.0 ** (steps / 12.0) * (1.0 + 0.008 * np.sin(2 * np.pi * 5.5 * time_s))
    turns = np.cumsum(pitch_hz) / SAMPLERATE
    since_s = time_s * 3.0 % 1.0 / 3.0
    shape = np.minimum(1.0, since_s / 0.03) * np.minimum(1.0, (1.0 / 3.0 - since_s) / 0.03)
    total = np.zeros(time_s.size)
    for harmonic in range(1, 12):
        total += np.sin(2.0 * np.pi * harmonic * turns) / harmonic
    return shape * total


def beeps(duration_s: float) -> FloatArray:
    """Return an alarm: a tone of 950 Hz for 0.25 s, twice each second."""
    time_s = _time_s(duration_s)
    return tone(950.0, 1.0, duration_s) * (time_s * 2.0 % 1.0 < 0.5)


def siren(duration_s: float) -> FloatArray:
    """Return a siren: three harmonics of a fundamental that glides between 450 and 950 Hz."""
    time_s = _time_s(duration_s)
    turns = np.cumsum(700.0 + 250.0 * np.sin(np.pi * time_s)) / SAMPLERATE
    total = np.zeros(time_s.size)
    for harmonic, amplitude in enumerate((1.0, 0.5, 0.3), start=1):
        total += amplitude * np.sin(2.0 * np.pi * harmonic * turns)
    return total
