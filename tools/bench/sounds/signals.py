"""Synthetic signals, and real recordings if available.

Signals are float32 or float64 with full scale ±1, (frames,) or (frames, 2). Synthetic signals are
the same in every run.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import soundfile
from numpy.typing import NDArray

from audioflinger_hook.scenes import demo_scene
from audioflinger_hook.sources import mixdown
from audioflinger_hook.transform import FloatArray
from tools.records import PROJECT_ROOT

SAMPLERATE = 48_000  # default sample rate of scenes and signals in Hz

Stereo = NDArray[np.float32]  # (frames, 2) at SAMPLERATE
RECORDINGS_VARIABLE = "CUSHION_RECORDINGS"
RECORDINGS_FOLDER = ".cache/recordings"
RECORDINGS_COMMAND = "tools/fetch_recordings.sh"
DEMO_TIMES, DEMO_PART_S = 3.0, (6.9, 8.9)
"""If the demo scene is over 3 times as long as a run, only this part with speech, in s, is used."""
SHORTEST_S = 0.3  # used recordings are longer than this, in s
_SPOKEN = """
    Front_Center Front_Left Front_Right Noise Rear_Center Rear_Left Rear_Right Side_Left Side_Right
"""
_DESKTOP = """
    alarm-clock-elapsed audio-channel-front-center audio-channel-front-left
    audio-channel-front-right audio-channel-rear-center audio-channel-rear-left
    audio-channel-rear-right audio-channel-side-left audio-channel-side-right audio-test-signal
    audio-volume-change bell camera-shutter complete device-added device-removed
    dialog-information dialog-warning message-new-instant message phone-incoming-call
    phone-outgoing-busy phone-outgoing-calling service-login service-logout suspend-error
    trash-empty
"""
KNOWN = (
    *(f"alsa/{name}.wav" for name in _SPOKEN.split()),
    *(f"freedesktop/{name}.oga" for name in _DESKTOP.split()),
)

CHORD_HZ = (110.0, 220.0, 277.2, 329.6, 440.0, 554.4, 659.3, 880.0, 1318.5, 1760.0)
CHORD_AMPLITUDE = 0.08
BURST_S, BURST_RISE_S = 0.25, 0.001
DENORMAL, DENORMAL_FLOAT64 = 1e-40, 1e-310  # denormal numbers, far below audibility
TINY = 1e-30  # inaudible, but a normal number


def tone(
    frequency_hz: float, amplitude: float, duration_s: float, samplerate: int = SAMPLERATE
) -> FloatArray:
    """Return a steady sine that starts at phase 0, (frames,) float64."""
    time_s = np.arange(round(duration_s * samplerate)) / samplerate
    return amplitude * np.sin(2.0 * np.pi * frequency_hz * time_s)


def burst(frequency_hz: float, amplitude: float, onset_s: float, duration_s: float) -> FloatArray:
    """Return silence with one tone of 0.25 s, which rises and falls in 1 ms, (frames,) float64.

    onset_s: start of the tone in s.
    duration_s: duration of the whole signal in s.
    """
    since_s = np.arange(round(duration_s * SAMPLERATE)) / SAMPLERATE - onset_s
    rise = np.clip(since_s / BURST_RISE_S, 0.0, 1.0)
    fall = np.clip((BURST_S - since_s) / BURST_RISE_S, 0.0, 1.0)
    return amplitude * rise * fall * np.sin(2.0 * np.pi * frequency_hz * since_s)


def white_noise(duration_s: float) -> Stereo:
    """Return uniform white noise with peaks at full scale, the same in both channels."""
    noise = np.random.default_rng(1).uniform(-1.0, 1.0, round(duration_s * SAMPLERATE))
    return stereo(noise)


def pink_noise(frames: int, rng: np.random.Generator) -> FloatArray:
    """Return pink noise without frequencies under 20 Hz, with an r.m.s. of 1, (frames,)."""
    spectrum = np.fft.rfft(rng.standard_normal(frames))
    hz = np.fft.rfftfreq(frames, 1.0 / SAMPLERATE)
    spectrum[hz < 20.0] = 0.0
    spectrum[1:] /= np.sqrt(hz[1:])
    noise = np.fft.irfft(spectrum, frames)
    pink: FloatArray = noise / noise.std()
    return pink


def chord(duration_s: float) -> Stereo:
    """Return a chord of ten sines, whose amplitudes are modulated slowly."""
    time_s = np.arange(round(duration_s * SAMPLERATE)) / SAMPLERATE
    total = np.zeros(time_s.size)
    for number, frequency_hz in enumerate(CHORD_HZ):
        swell = 1.0 + 0.3 * np.sin(2.0 * np.pi * (2.0 + 0.7 * number) * time_s + number)
        total += swell * np.sin(2.0 * np.pi * frequency_hz * time_s + number)
    return stereo(CHORD_AMPLITUDE * total)


def stereo(mono: FloatArray) -> Stereo:
    """Return a mono signal in two equal channels, float32."""
    return np.repeat(mono.astype(np.float32)[:, None], 2, axis=1)


def looped(frames: Stereo, duration_s: float) -> Stereo:
    """Return the sound, repeated or cut to a duration in s."""
    wanted = round(duration_s * SAMPLERATE)
    return np.tile(frames, (-(-wanted // len(frames)), 1))[:wanted]


@dataclass(frozen=True, eq=False)
class Recording:
    """One recording.

    name: file name without suffix.
    kind: name of the folder.
    frames: (frames, channels).
    samplerate: in Hz.
    """

    name: str
    kind: str
    frames: NDArray[np.float32]
    samplerate: int

    @property
    def is_speech(self) -> bool:
        """Whether the recording is one of the spoken channel names of alsa-utils, at 48 kHz."""
        return self.kind == "alsa" and self.name != "Noise" and self.samplerate == SAMPLERATE


def recordings_folder() -> Path | None:
    """Return the folder with recordings; None for a missing or empty folder.

    The environment variable CUSHION_RECORDINGS may name the folder; the default is
    .cache/recordings. A relative path is tried in the current folder, then in the project's folder.
    """
    name = os.environ.get(RECORDINGS_VARIABLE, RECORDINGS_FOLDER)
    for root in (Path.cwd(), PROJECT_ROOT):
        folder = root / name
        if folder.is_dir() and any(folder.iterdir()):
            return folder
    return None


def examine_recordings() -> tuple[tuple[Recording, ...], dict[str, str]]:
    """Return all recordings longer than 0.3 s, and the reasons why others are missing or
    unreadable.

    The reasons have keys of the form FOLDER/FILE. Without a folder of recordings, both results are
    empty.
    """
    folder = recordings_folder()
    if folder is None:
        return (), {}
    found, wrong = [], {}
    for path in sorted(folder.rglob("*")):
        if path.suffix in {".wav", ".oga"}:
            name = f"{path.parent.name}/{path.name}"
            try:
                frames, samplerate = soundfile.read(path, dtype="float32", always_2d=True)
            except (soundfile.LibsndfileError, OSError, RuntimeError) as error:
                wrong[name] = f"it cannot be read ({error})"
                continue
            if len(frames) > SHORTEST_S * samplerate:
                found.append(Recording(path.stem, path.parent.name, frames, samplerate))
    there = {f"{path.parent.name}/{path.name}" for path in folder.rglob("*")}
    wrong |= {name: f"it is not in {folder}" for name in KNOWN if name not in there}
    return tuple(found), wrong


def speech(recordings: tuple[Recording, ...]) -> Stereo | None:
    """Return all speech recordings, one after another, in stereo; None if there is none."""
    spoken = [item.frames.mean(axis=1) for item in recordings if item.is_speech]
    return stereo(np.concatenate(spoken)) if spoken else None


@cache
def demo_sound() -> Stereo:
    """Return the mixed tracks of the demo scene, read-only."""
    sound = mixdown(demo_scene())
    sound.flags.writeable = False
    return sound


def _demo_part(duration_s: float) -> Stereo:
    whole = demo_sound()
    if len(whole) <= DEMO_TIMES * duration_s * SAMPLERATE:
        return whole
    first, last = (round(second * SAMPLERATE) for second in DEMO_PART_S)
    return whole[first:last]


def cost_scenes(
    duration_s: float, recordings: tuple[Recording, ...]
) -> dict[str, Stereo | FloatArray | None]:
    """Return the sounds on which CPU time is measured, by name; None for missing recordings."""
    spoken = speech(recordings)
    constants = {
        "silence": np.float32(0.0),
        "tiny normal floats": np.float32(TINY),
        "denormal floats": np.float32(DENORMAL),
        "tiny normal floats, float64": np.float64(TINY),
        "denormal floats, float64": np.float64(DENORMAL_FLOAT64),
    }
    shape = round(duration_s * SAMPLERATE), 2
    return {
        "demo scene": _demo_part(duration_s),
        "chord, 10 modulated partials": chord(duration_s),
        "speech recordings": None if spoken is None else looped(spoken, duration_s),
        "white noise, 0 dBFS": white_noise(duration_s),
        **{name: np.full(shape, value) for name, value in constants.items()},
    }
