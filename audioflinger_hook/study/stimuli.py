"""What trials play: sounds and vibrations, of equal level in all conditions of a trial.

Level is the r.m.s. of the vibration with the weighting Wk of ISO 2631-1, relative to a full-scale
sine of 80 Hz. It is measured from the frames that are played. A sound and its vibrations begin
together and have the same length, with silence around for the delays.
"""

from collections.abc import Mapping
from functools import lru_cache
from hashlib import sha256
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from scipy.fft import irfft, rfft
from scipy.signal import freqz_sos, sosfilt

from audioflinger_hook.study.design import GAP_S, METHODS, Design, MistakesError, vibration_file
from audioflinger_hook.trials.player import mixed
from audioflinger_hook.trials.stream import RATE_HZ
from device.drive.exposure import wk_sections
from device.errors import UsageError
from device.units import Float32Array, FloatArray, amplitude_to_db, db_to_amplitude

WK, REFERENCE_HZ = wk_sections(RATE_HZ), 80.0
SILENT = 1e-6  # r.m.s. of a vibration that counts as none


class Interval(NamedTuple):
    """What an interval of a trial plays, (frames, channels) at 48 kHz, and columns about it."""

    sound: Float32Array | None
    vibration: Float32Array
    columns: Mapping[str, Any]


class Stimuli:
    """Makes what a design's trials play.

    MistakesError: why some vibrations cannot be made.
    """

    def __init__(self, design: Design) -> None:
        self.design, self._interval, mistakes = design, lru_cache(4)(self._make), list[str]()
        questions = design.questions.values()
        delays_ms = [abs(one.delay_ms) for one in design.conditions.values()]
        offsets_ms = [abs(delay_ms) for one in questions for delay_ms in one.delays]
        self._pad = round(RATE_HZ * (0.5 * GAP_S + (max(delays_ms) + max(offsets_ms)) / 1e3))
        pairs = [pair for one in questions for pair in product(one.stimuli, one.conditions)]
        paths = {name: design.folder / name for name, _ in pairs}
        self._sounds = {name: mixed(path, None)[:, :2] for name, path in paths.items()}
        self._units: dict[tuple[str, str], FloatArray] = {}
        most_db = design.study.level_db + max(one.highest_db for one in questions)
        for stimulus, name in dict.fromkeys(pairs):
            try:
                unit = self._units[stimulus, name] = self._unit(stimulus, name)
                peak_db = amplitude_to_db(np.abs(unit).max()) + design.conditions[name].gain_db
                if (over_db := most_db + peak_db) > 0.0:
                    told = f"{stimulus!r} as {name!r} exceeds full scale by {over_db:.1f} dB"
                    raise UsageError(f"{told}; reduce level_db, gain_db or highest_db")
            except UsageError as error:
                mistakes.append(str(error))
        for name, sound in self._sounds.items():
            if (peak := np.abs(self._masked(sound)).max()) > 1.0:
                over = f"exceeds full scale by {amplitude_to_db(peak):.1f} dB; reduce masking_db"
                mistakes.append(f"{name!r} with the masking noise {over}")
        if mistakes:
            raise MistakesError(*mistakes)

    def of(self, row: Mapping[str, Any]) -> list[Interval]:
        """Return all intervals of a trial."""
        question, found = self.design.questions[row["question"]], []
        for name in (row[key] for key in ("condition_1", "condition_2") if key in row):
            varied = {question.kind["varies"]: row["varied"] if name == row["tested"] else 0.0}
            shift = varied.get("delay", 0.0), varied.get("level", 0.0)
            found.append(self._interval(row["stimulus"], name, *shift, question.sound))
        return found

    def _make(
        self, stimulus: str, name: str, delay_ms: float, gain_db: float, heard: bool
    ) -> Interval:
        sound, study = self._sounds[stimulus], self.design.study
        vibration = np.zeros((len(sound) + 2 * self._pad, 1), np.float32)
        if name in self.design.conditions:  # "none" is no condition in trials of a threshold
            condition, unit = self.design.conditions[name], self._units[stimulus, name]
            gain_db += study.level_db + condition.gain_db
            start = self._pad + round((delay_ms + condition.delay_ms) * RATE_HZ / 1e3)
            vibration[start : start + len(unit), 0] = db_to_amplitude(gain_db) * unit
        level = weighted_level(vibration[:, 0], len(sound))
        columns = {
            "vibration_sha256": sha256(vibration.tobytes()).hexdigest(),
            "weighted_db": amplitude_to_db(level) if level > 0.0 else None,
        }
        is_silent = not heard and study.masking_db is None
        return Interval(None if is_silent else self._masked(sound * heard), vibration, columns)

    def _masked(self, sound: Float32Array) -> Float32Array:
        """Return a sound with the silence around, and with the masking noise."""
        padded, study = np.pad(sound, ((self._pad, self._pad), (0, 0))), self.design.study
        if study.masking_db is not None:
            noise = np.random.default_rng(study.seed).standard_normal(len(padded))
            hz = np.fft.rfftfreq(len(padded), 1.0 / RATE_HZ)
            pink = irfft(rfft(noise) / np.sqrt(np.maximum(hz, 20.0)), len(padded))
            padded += (db_to_amplitude(study.masking_db) / _rms(pink) * pink)[:, None]
        return padded

    def _unit(self, stimulus: str, name: str) -> FloatArray:
        """Return a vibration of the level 1, (frames,); without vibration, zeros."""
        method, sound = self.design.conditions[name].method, self._sounds[stimulus]
        if path := vibration_file(self.design.folder, method, stimulus):
            found = mixed(None, path)[:, 2].astype(float)
            if abs(len(found) - len(sound)) > 0.001 * RATE_HZ:
                lengths = f"{len(found) / RATE_HZ:.3f} s, the sound {len(sound) / RATE_HZ:.3f} s"
                raise UsageError(f"{path} lasts {lengths}; make both equal")
        elif make := METHODS[method]:
            stream = make(RATE_HZ, 2)
            whole = np.concatenate((stream.process(sound), stream.finish()))[:, 0]
            found = whole[stream.latency_frames :]
        else:
            return np.zeros(len(sound))
        if _rms(found) < SILENT:
            told = f"condition {name!r} gives no vibration for {stimulus!r}"
            raise UsageError(f"{told}; leave one of them out of the question")
        return found / weighted_level(found, len(sound))


def _rms(signal: FloatArray) -> float:
    return float(np.sqrt(np.mean(signal**2)))


def weighted_level(signal: FloatArray | Float32Array, frames: int) -> float:
    """Return the level of a vibration, (samples,) at 48 kHz; 1 for a full-scale sine of 80 Hz.

    frames: length without the silence around.
    """
    ring = np.zeros(RATE_HZ // 2)  # the filter's ringing counts
    weighted = sosfilt(WK, np.concatenate((signal, ring)))
    of_sine = np.abs(freqz_sos(WK, [REFERENCE_HZ], fs=RATE_HZ)[1][0]) / np.sqrt(2.0)
    return float(np.sqrt(np.sum(weighted**2) / frames) / of_sine)
