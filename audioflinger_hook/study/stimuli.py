"""What trials play: sounds and vibrations, of equal level in all conditions of a trial.

Level is the r.m.s. of the vibration with the weighting Wk of ISO 2631-1, relative to a full-scale
sine of 80 Hz. It is measured from the frames that are played. A sound and its vibrations begin
together and have the same length, with silence around for the delays.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, lru_cache
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.fft import irfft, rfft
from scipy.signal import sosfilt

from audioflinger_hook.baselines import BASELINES
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.offline.render import render_file
from audioflinger_hook.study.design import GAP_S, NONE, Design
from audioflinger_hook.trials.player import Played, mixed
from audioflinger_hook.trials.stream import RATE_HZ
from device.drive.exposure import wk_sections
from device.errors import UsageError
from device.units import Float32Array, FloatArray, amplitude_to_db, db_to_amplitude

REFERENCE_HZ, PEAK_MAX = 80.0, 0.98
SILENT, LEAST_DBFS = 1e-6, -150.0  # r.m.s. of a vibration that counts as none; level of silence


@dataclass(frozen=True)
class Interval:
    """What an interval of a trial plays, (frames, channels) at 48 kHz.

    digest: SHA-256 of the vibration's bytes. weighted_db: level; None of silence. level_dbfs:
    r.m.s. of the vibration, at least -150.
    """

    sound: Float32Array | None
    vibration: Float32Array
    digest: str
    weighted_db: float | None
    level_dbfs: float

    @property
    def seconds(self) -> float:
        """Duration."""
        return len(self.vibration) / RATE_HZ

    def columns(self, number: int, played: Played) -> dict[str, Any]:
        """Return the columns of interval `number`, 1 or 2."""
        made = {"vibration_sha256": self.digest, "weighted_db": self.weighted_db} | vars(played)
        return {f"{key}_{number}": value for key, value in made.items()}


class Stimuli:
    """Makes what a design's trials play, as it is needed.

    lowered_db: by sound, how much all conditions were lowered so that none exceeds full scale.
    """

    def __init__(self, design: Design) -> None:
        self.design, self.lowered_db = design, dict[str, float]()
        delays = [abs(one.delay_ms) for one in design.conditions.values()]
        questions = [one for one in design.questions.values() if one.paradigm == "synchrony"]
        offsets = [abs(ms) for question in questions for ms in question.offsets_ms]
        self._pad = round(RATE_HZ * (0.5 * GAP_S + (max(delays) + max(offsets, default=0)) / 1e3))
        self._interval, self._unit = lru_cache(64)(self._make), cache(self._compute)
        self._sound, self._heard = cache(self._read), cache(self._mask)
        self._level = cache(self._common)

    def of(self, row: Mapping[str, Any]) -> list[Interval]:
        """Return all intervals of a trial. UsageError: they cannot be made."""
        heard = self.design.questions[row["question"]].sound
        return [
            self._interval(
                row["stimulus"], row[f"condition_{i}"], row[f"gain_db_{i}"], row["offset_ms"], heard
            )
            for i in (1, 2)
            if f"condition_{i}" in row
        ]

    def mistakes(self) -> list[str]:
        """Make one vibration of each kind; return why others cannot be made."""
        found = []
        for question in self.design.questions.values():
            for stimulus in question.stimuli:
                self._level(stimulus)
                for name in question.conditions:
                    try:
                        self._unit(stimulus, name)
                    except UsageError as error:
                        found.append(str(error))
        return list(dict.fromkeys(found))

    def _make(
        self, stimulus: str, name: str, gain_db: float, offset_ms: float, heard: bool
    ) -> Interval:
        condition, sound = self.design.conditions.get(name), self._sound(stimulus)
        unit, delay_ms, gain = self._unit(stimulus, name), offset_ms, self._level(stimulus)
        if condition:
            delay_ms += condition.delay_ms
            gain *= db_to_amplitude(gain_db + condition.gain_db)
        if (peak := gain * float(np.abs(unit).max())) > 1.0:
            over = f"would exceed full scale by {amplitude_to_db(peak):.1f} dB"
            raise UsageError(
                f"{stimulus!r} as {name!r} {over}; reduce level_db, gain_db or highest_db"
            )
        vibration = np.zeros((len(sound) + 2 * self._pad, 1), np.float32)
        start = self._pad + round(delay_ms * RATE_HZ / 1e3)
        vibration[start : start + len(unit), 0] = gain * unit
        is_heard = heard or self.design.study.masking_db is not None
        weighted = weighted_level(vibration[:, 0], len(sound))
        return Interval(
            self._heard(stimulus, heard) if is_heard else None,
            vibration,
            sha256(vibration.tobytes()).hexdigest(),
            amplitude_to_db(weighted) if weighted > 0.0 else None,
            max(LEAST_DBFS, amplitude_to_db(_rms(vibration))),
        )

    def _read(self, stimulus: str) -> Float32Array:
        return mixed(self.design.stimuli[stimulus].file, None)[:, :2]

    def _mask(self, stimulus: str, heard: bool) -> Float32Array:
        """Return what is heard: the sound, if `heard`, and the masking noise of the design."""
        padded = np.pad(self._sound(stimulus) * heard, ((self._pad, self._pad), (0, 0)))
        if (masking_db := self.design.study.masking_db) is not None:
            noise = np.random.default_rng(self.design.study.seed).standard_normal(len(padded))
            hz = np.fft.rfftfreq(len(padded), 1.0 / RATE_HZ)
            pink = irfft(rfft(noise) / np.sqrt(np.maximum(hz, 20.0)), len(padded))
            padded = padded + (db_to_amplitude(masking_db) / _rms(pink) * pink)[:, None]
        return padded.astype(np.float32)

    def _compute(self, stimulus: str, name: str) -> FloatArray:
        """Return a vibration of the level 1, (frames,); without vibration, one zero."""
        condition, sound = self.design.conditions.get(name), self._sound(stimulus)
        if condition is None or condition.method == NONE:
            return np.zeros(1)
        if condition.method in BASELINES:
            stream = BASELINES[condition.method](RATE_HZ, 2)
            whole = np.concatenate((stream.process(sound), stream.finish()))[:, 0]
            found: FloatArray | Float32Array = whole[stream.latency_frames :]
        elif path := self.design.vibration_file(condition, stimulus):
            found = mixed(None, path)[:, 2]
            if abs(len(found) - len(sound)) > 0.001 * RATE_HZ:
                lengths = f"{len(found) / RATE_HZ:.3f} s, the sound {len(sound) / RATE_HZ:.3f} s"
                raise UsageError(f"{path} lasts {lengths}; make both equal")
        else:
            with TemporaryDirectory() as folder:
                target = Path(folder) / "vibration.wav"
                source = self.design.stimuli[stimulus].file
                render_file(source, target, Settings(profile=condition.method))
                found = mixed(None, target)[:, 2]
        if _rms(found) < SILENT:
            told = f"condition {name!r} gives no vibration for {stimulus!r}"
            raise UsageError(f"{told}; leave one of them out of the question")
        whole = np.resize(found, len(sound)).astype(float)
        return whole / weighted_level(whole, len(sound))

    def _common(self, stimulus: str) -> float:
        """Return the level of all conditions of a sound: the study's, or lower if one needs it."""
        questions = [q for q in self.design.questions.values() if stimulus in q.stimuli]
        peaks = [1.0]
        for name in {name for question in questions for name in question.conditions}:
            with suppress(UsageError):
                gain_db = max(0.0, self.design.conditions[name].gain_db)
                peaks.append(np.abs(self._unit(stimulus, name)).max() * db_to_amplitude(gain_db))
        wanted = db_to_amplitude(self.design.study.level_db)
        level = min(wanted, PEAK_MAX / max(peaks))
        self.lowered_db[stimulus] = amplitude_to_db(wanted / level)
        return float(level)


def _rms(signal: FloatArray | Float32Array) -> float:
    return float(np.sqrt(np.mean(np.square(signal, dtype=float))))


def weighted_level(signal: FloatArray | Float32Array, frames: int) -> float:
    """Return the level of a vibration, (samples,) at 48 kHz; 1 for a full-scale sine of 80 Hz.

    frames: length without the silence around.
    """
    ring = np.zeros(RATE_HZ // 2)  # the filter's ringing counts
    weighted = sosfilt(wk_sections(RATE_HZ), np.concatenate((signal, ring)))
    return float(np.sqrt(np.sum(weighted**2) / frames)) / _of_sine()


@cache
def _of_sine() -> float:
    sine = np.sin(2.0 * np.pi * REFERENCE_HZ / RATE_HZ * np.arange(4 * RATE_HZ))
    return _rms(sosfilt(wk_sections(RATE_HZ), sine)[RATE_HZ:])
