"""The live form for a whole sound at once, in NumPy: an oracle for the core.

It is the algorithm of docs/transform.md without blocks, rings and filter states. What windows show
is found in all of them at once. One loop over ticks and hops does what is sequential. Then all
glides are played at once. `s` is all numbers and tables of `LiveDesign`, by name.
"""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.signal import lfilter, sosfilt

from audioflinger_hook.core.structures import GLIDE_COLUMNS, PARTIALS
from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.downmix import MonoMix
from device.layouts import downmix
from tests.oracle.strength import driven
from tests.oracle.voice import Told, Voice


@dataclass
class Vibration:
    """What becomes of a sound. samples: (frames + latency_frames, voices), full scale. replaced,
    limited: samples of sound that were unusable, and of vibration that the limiter has changed.
    told: by hop, the frame at which it is analysed and what it vibrates. glides: (glides, 9), with
    the columns `GLIDE_COLUMNS`."""

    samples: FloatArray
    replaced: int
    limited: int
    told: list[tuple[int, list[Told]]]
    glides: FloatArray


def settings_of(design: LiveDesign) -> Any:
    """Return all numbers and tables of a design as attributes, and three fields of its own."""
    kept = {name: getattr(design, name) for name in ("mapping", "tracking", "samplerate")}
    return SimpleNamespace(**kept, **design.settings())


def vibration_of(
    sound: Any, samplerate: int, parameters: Any = None, *, per_channel=False, design: Any = None
) -> Vibration:
    """Return the vibration of a sound (frames,) or (frames, channels) and of silence after it.
    per_channel: of each channel instead of their mono mix. design: instead of the parameters'."""
    design = design or LiveDesign.of(parameters or TransformParameters(), samplerate)
    s, frames = settings_of(design), np.asarray(sound).reshape(len(sound), -1)
    frames = np.concatenate((frames, np.zeros((design.latency_frames, frames.shape[1]))))
    usable = np.abs(frames) <= s.magnitude_max
    rows = np.where(usable, frames, 0.0).T.astype(np.float64)
    voices = [Voice(s) for _ in range(len(rows) if per_channel else 1)]
    samples = np.zeros((len(frames), len(voices)))
    whole = Vibration(samples, int((~usable).sum()), 0, [], np.zeros((0, len(GLIDE_COLUMNS))))
    # Hops begin with the sound after a window of silence, if nothing vibrates then.
    loud = np.flatnonzero((frames != 0.0).any(axis=1))
    begins = loud[np.diff(loud, prepend=-1 - s.window_frames) > s.window_frames].tolist()
    heard = rows if per_channel else rows[:1]
    while begins:
        if not per_channel:
            mix = MonoMix(downmix(len(rows)), samplerate).process(rows[:, begins[0] :])
            heard = np.concatenate((heard[0, : begins[0]], mix))[None]
        begins = _play(s, voices, heard, begins, whole)
    fade = np.concatenate((np.zeros(s.begin_frames), s.begin_fade))[: len(samples), None]
    if s.begin_fade.size:
        samples[: len(fade)] *= fade
    whole.limited = min(whole.limited + sum(voice.limited for voice in voices), samples.size)
    return whole


def _play(s, voices, sound, begins, whole):
    """Play sound (voices, frames) from the first of `begins` on, until it begins anew while all
    voices are asleep; return the `begins` from there on."""
    begin, *later = begins
    starts = np.arange(begin, sound.shape[1] + 1, s.tick_frames)
    ends = starts[1:]
    band = lfilter(s.band_b, s.band_a, sound + s.denormal_guard)
    for voice, row in zip(voices, band, strict=True):
        voice.hear(row, ends)
    for tick, start in enumerate(starts.tolist()):
        later = [frame for frame in later if frame >= start]
        anew = later and later[0] < start + s.tick_frames and all(v.asleep() for v in voices)
        if anew or tick == ends.size:
            break
        hops = None
        if (tick + 1) % s.ticks == 0:
            hop_ends = [0] * s.hops_in_window + [end for end, _ in whole.told] + [ends[tick]]
            hops = slice(hop_ends[-1 - s.hops_in_window], hop_ends[-1])
        for voice in voices:
            voice.advance(tick, hops)
        if hops:
            told = sorted((one for voice in voices for one in voice.told), key=lambda one: one[2])
            whole.told.append((int(ends[tick]), told[-PARTIALS:]))
        if strengths := [voice.strength for voice in voices if voice.strength]:
            # The softer side of a sound stays softer: the loudest has the programme.
            loudest = max(strengths, key=lambda one: one.loud_db)
            for one in strengths:
                one.programme_db, one.heard = loudest.programme_db, loudest.heard
    rows: list[Any] = [whole.glides]
    for which, voice in enumerate(voices):
        parts = [(s.hop_frames, voice.partials.glides), (s.tick_frames, voice.fresh.glides)]
        played, limited, driven_glides = vibrate(
            s, voice.partials.glides, voice.fresh.glides, voice.wanted[:tick]
        )
        part = whole.samples[begin + s.tick_frames :, which]
        part[: played.size] = played[: part.size]
        whole.limited += limited
        if voice.strength:
            parts = [(s.tick_frames, driven_glides)]
        rows += [[(ends[at], length, which, *rest)] for length, some in parts for at, *rest in some]
    whole.glides = np.concatenate(rows)
    return later


def vibrate(s: Any, hops: Any, fresh: Any, wanted: Any) -> tuple[FloatArray, int, Any]:
    """Return the vibration (ticks x tick_frames,) after each of some ticks; how many samples of it
    were limited; and, where loudness is followed, the glides of each tick. hops, fresh: glides over
    a hop, and over a tick. wanted: strength at the end of each tick."""
    ticks, limited = len(wanted), 0
    glides: list[Any] = []
    waves = _waves(s, hops, s.attack, s.glide, s.glide_s)
    waves += _waves(s, fresh, s.tick_glide, s.tick_glide, s.tick_glide_s)
    if s.loudness_scale.size:
        rows = [
            (tick + part, slot, numbers[:, part * s.tick_steps :][:, : s.tick_steps + 1])
            for tick, slot, numbers in waves
            for part in range(numbers.shape[1] // s.tick_steps)
        ]
        low_rate, steps, glides = driven(s, rows, wanted)
        limited = steps * s.decimation
    else:
        low_rate = np.zeros((ticks + s.ticks) * s.tick_steps)
        for tick, _, (_, amplitude, turns) in waves:
            wave = amplitude * np.cos(2.0 * np.pi * turns)
            low_rate[tick * s.tick_steps :][: wave.size - 1] += wave[1:]
    low_rate = low_rate[: ticks * s.tick_steps]
    smooth = (
        sosfilt(s.low_sections.copy(), low_rate)
        if s.low_sections.size
        else lfilter(s.low_b, s.low_a, low_rate)
    )
    padded = np.concatenate((np.zeros(len(s.phases) - 1), smooth))
    newest = [padded[tap : tap + smooth.size] for tap in range(len(s.phases))]
    vibration = (np.stack(newest, axis=1) @ s.phases).reshape(-1)
    size, room = np.abs(vibration), 1.0 - s.knee
    rounded = s.knee + room * np.tanh((size - s.knee) / room) * (1.0 - 1e-6)
    over = size > s.knee
    limited += int(over.sum())
    return np.where(over, np.copysign(rounded, vibration), vibration), limited, glides


def _waves(s, glides, attack, release, glide_s):
    """Return of glides of one length tick, slot and (3, steps + 1): Hz, amplitude and turns, from
    their start on; phase is the integral of frequency. One shape serves all glides from one tick
    on, by whether their sum rises: it never exceeds both its ends."""
    first, slots, *numbers = np.array(glides).reshape(-1, 7).T
    tick = first.astype(int)
    start_hz, end_hz, start, end, phase = (each[:, None] for each in numbers)
    rise = np.bincount(tick, (end - start)[:, 0], 1)[tick]
    shape = np.where(rise[:, None] > s.still, attack, release)
    turns = start_hz * s.seconds[: attack.size] + (end_hz - start_hz) * glide_s + phase
    moving = (start_hz + (end_hz - start_hz) * release, start + (end - start) * shape, turns)
    begins = np.stack((start_hz, start, phase), axis=1)
    courses = np.concatenate((begins, np.stack(moving, axis=1)), axis=2)
    return list(zip(tick, slots, courses, strict=True))
