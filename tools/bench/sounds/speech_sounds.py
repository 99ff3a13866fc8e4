"""Speech and other sounds on which speech suppression is measured, in two halves.

The rule was tuned on the first half. Signals are (frames,) float64 at SAMPLERATE, of one loudness.
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

LOUDNESS_DB = -22.0
"""r.m.s. of a sound while it sounds, against full scale."""
SOUNDING_DB = -30.0
"""A sound sounds where its level over 50 ms is within this of its highest."""
LEVEL_S = 0.05

PAUSE_S = 0.1
"""Between recordings of speech that are played one after another."""


def even(sound: FloatArray) -> FloatArray:
    """Return a sound at LOUDNESS_DB while it sounds."""
    power = uniform_filter1d(sound**2, round(LEVEL_S * SAMPLERATE), mode="constant")
    sounding = power > power.max() * 10 ** (SOUNDING_DB / 10)
    rms = float(np.sqrt((sound[sounding] ** 2).mean()))
    level: FloatArray = sound * (10 ** (LOUDNESS_DB / 20) / rms)
    return level


def repeated(sound: FloatArray, duration_s: float) -> FloatArray:
    """Return a sound again and again for so long."""
    again: FloatArray = np.resize(sound, round(duration_s * SAMPLERATE))
    return again


@functools.cache
def _demo() -> Scene:
    return demo_scene()


def scene_track(name: str) -> FloatArray:
    """Return one sound of the demo scene by itself."""
    (track,) = [track for track in _demo().tracks if track.name == name]
    mono = np.asarray(track.frames, dtype=np.float64).mean(axis=1)
    if track.samplerate != SAMPLERATE:
        mono = resample_poly(mono, SAMPLERATE, track.samplerate)
    return even(mono)


def spoken(recordings: Sequence[Recording]) -> dict[str, FloatArray]:
    """Return recorded speech by half, empty where there is none; the voices are the same."""
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
    """Return the recordings that are no speech, by half: every second one."""
    others = [
        item
        for item in recordings
        if not item.is_speech and not item.name.startswith("audio-channel") and item.name != "Noise"
    ]
    return {CHOSEN_ON: others[::2], OTHER_HALF: others[1::2]}


def no_speech(duration_s: float) -> dict[str, dict[str, FloatArray]]:
    """Return sounds that are no speech, by half and name."""
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
    """Return nine shots a second in bursts of a second: noise that dies away within 25 ms."""
    time_s = _time_s(duration_s)
    noise = np.random.default_rng(3).standard_normal(time_s.size)
    firing = time_s % 2.0 < 1.0
    return firing * noise * np.exp(-(time_s * 9.0 % 1.0) / 9.0 / 0.025)


def motor(duration_s: float) -> FloatArray:
    """Return a motor whose 29 harmonics go from 15 to 55 Hz and back."""
    time_s = _time_s(duration_s)
    turns = np.cumsum(35.0 + 20.0 * np.sin(2.0 * np.pi * 0.3 * time_s)) / SAMPLERATE
    total = np.zeros(time_s.size)
    for harmonic in range(1, 30):
        total += harmonic**-0.8 * np.sin(2.0 * np.pi * harmonic * turns + harmonic**2)
    return total


def swelling_noise(duration_s: float) -> FloatArray:
    """Return noise with the modulation of speech, 4 Hz, and nothing else of it."""
    time_s = _time_s(duration_s)
    noise = np.random.default_rng(4).standard_normal(time_s.size)
    return noise * (1.0 + 0.95 * np.sin(2.0 * np.pi * 4.0 * time_s))


def notes(duration_s: float) -> FloatArray:
    """Return a melody on a string: at 196 Hz and above, three notes a second, each with vibrato."""
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
    """Return an alarm: a tone of 950 Hz, twice a second for a quarter of a second."""
    time_s = _time_s(duration_s)
    return tone(950.0, 1.0, duration_s) * (time_s * 2.0 % 1.0 < 0.5)


def siren(duration_s: float) -> FloatArray:
    """Return three harmonics that glide between 450 and 950 Hz every two seconds."""
    time_s = _time_s(duration_s)
    turns = np.cumsum(700.0 + 250.0 * np.sin(np.pi * time_s)) / SAMPLERATE
    total = np.zeros(time_s.size)
    for harmonic, amplitude in enumerate((1.0, 0.5, 0.3), start=1):
        total += amplitude * np.sin(2.0 * np.pi * harmonic * turns)
    return total
