"""The files that trials play: sounds and vibrations, of equal level in all conditions of a trial.

Level is the r.m.s. of the vibration with the weighting Wk of ISO 2631-1, relative to a full-scale
sine of 80 Hz. It is measured from the file. A sound and its vibrations begin together and have the
same length, with silence around for the delays.
"""

from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from hashlib import sha256
from math import log10
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import soundfile
from scipy.fft import irfft, rfft
from scipy.signal import sosfilt

from audioflinger_hook.baselines import BASELINES
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.offline.render import render_file
from audioflinger_hook.study.design import GAP_S, NONE, Design
from audioflinger_hook.study.trials import Trial
from device.drive.exposure import wk_sections
from device.errors import UsageError
from device.units import FloatArray, amplitude_to_db
from device.wav_output import WavOutput

FOLDER = "stimuli"  # in the study's folder; it can be deleted, and is made again
REFERENCE_HZ, PEAK_MAX = 80.0, 0.98
SILENT = 1e-6  # r.m.s. of a vibration that counts as none


@dataclass(frozen=True)
class Vibration:
    """Files of one interval. digest: SHA-256 of the vibration's file. Levels of silence: -inf."""

    sound: Path | None
    path: Path
    digest: str
    weighted_db: float
    peak_dbfs: float
    level_dbfs: float
    seconds: float


class Stimuli:
    """Makes the files of a design in its folder `stimuli` as they are needed.

    design: the study's. lowered_db: by sound, how much all conditions were lowered so that none
    exceeds full scale.
    """

    def __init__(self, design: Design) -> None:
        self.design, self._folder = design, design.folder / FOLDER
        self.lowered_db: dict[str, float] = {}
        self._made: dict[tuple[object, ...], Vibration] = {}

    @cached_property
    def pad_s(self) -> float:
        """Silence before and after each sound, in s: half the gap, and the longest delay."""
        delays = [abs(one.delay_ms) for one in self.design.conditions.values()]
        questions = [q for q in self.design.questions.values() if q.paradigm == "synchrony"]
        offsets = [abs(ms) for question in questions for ms in question.offsets_ms]
        return 0.5 * GAP_S + (max(delays) + max(offsets, default=0.0)) / 1e3

    def of(self, trial: Trial) -> list[Vibration]:
        """Return the files of all intervals of a trial. UsageError: they cannot be made."""
        return [self.vibration(trial, interval) for interval in range(len(trial.conditions))]

    def vibration(self, trial: Trial, interval: int) -> Vibration:
        """Return the files of an interval, 0 or 1, of a trial. UsageError: they cannot be made."""
        name, gain_db = trial.conditions[interval], trial.gains_db[interval]
        heard = self.design.questions[trial.question].sound
        key = (trial.stimulus, name, gain_db, trial.offset_ms, heard)
        if key not in self._made:
            self._made[key] = self._make(*key)
        return self._made[key]

    def mistakes(self) -> list[str]:
        """Make one vibration of each kind; return why others cannot be made."""
        found = []
        for question in self.design.questions.values():
            for stimulus in question.stimuli:
                for name in question.conditions:
                    try:
                        self._levelled(stimulus, name)
                    except UsageError as error:
                        found.append(str(error))
        return list(dict.fromkeys(found))

    def _make(
        self, stimulus: str, name: str, gain_db: float, offset_ms: float, heard: bool
    ) -> Vibration:
        self._folder.mkdir(exist_ok=True)
        sound, rate = self._sound(stimulus)
        pad = round(self.pad_s * rate)
        heard_path = None
        if heard or self.design.study.masking_db is not None:
            named = f"{stimulus}{'' if heard else '-masking'}.wav"
            heard_path = self._folder / named.replace("/", "_")
            _write(heard_path, self._masked(sound if heard else 0.0 * sound, pad, rate), rate)
        frames = len(sound) + 2 * pad
        vibration, its_delay_ms = np.zeros(len(sound)), 0.0
        if not self._is_none(name):
            condition = self.design.conditions[name]
            its_delay_ms = condition.delay_ms
            gain = 10.0 ** ((gain_db + condition.gain_db) / 20.0)
            vibration = self._levelled(stimulus, name) * gain
        if (peak := float(np.abs(vibration).max())) > 1.0:
            over = f"{stimulus!r} as {name!r} would exceed full scale by {20 * log10(peak):.1f} dB"
            raise UsageError(f"{over}; reduce level_db, gain_db or highest_db")
        start = pad + round((offset_ms + its_delay_ms) * rate / 1e3)
        padded = np.zeros((frames, 1))
        padded[start : start + len(vibration), 0] = vibration
        named = f"{stimulus}-{name}{gain_db:+.1f}dB{offset_ms:+.0f}ms.wav"
        path = self._folder / named.replace("/", "_")
        _write(path, padded, rate)
        played = soundfile.read(path, always_2d=True)[0][:, 0]
        levels = amplitude_to_db(float(np.abs(played).max())), amplitude_to_db(_rms(played))
        weighted_db = amplitude_to_db(weighted_level(played, rate, len(sound)))
        digest = sha256(path.read_bytes()).hexdigest()
        return Vibration(heard_path, path, digest, weighted_db, *levels, frames / rate)

    def _is_none(self, name: str) -> bool:
        return name == NONE or self.design.conditions[name].method == NONE

    @cache  # noqa: B019 - as long as the study runs
    def _sound(self, stimulus: str) -> tuple[FloatArray, int]:
        sound, rate = soundfile.read(self.design.stimuli[stimulus].file, always_2d=True)
        return sound, rate

    @cache  # noqa: B019
    def _vibration(self, stimulus: str, name: str) -> FloatArray:
        sound, rate = self._sound(stimulus)
        condition = self.design.conditions[name]
        if condition.method in BASELINES:
            stream = BASELINES[condition.method](rate, sound.shape[1])
            whole = np.concatenate((stream.process(sound), stream.finish()))[:, 0]
            found: FloatArray = whole[stream.latency_frames :]
        elif path := self.design.vibration_file(condition, stimulus):
            read, its_rate = soundfile.read(path, always_2d=True)
            if its_rate != rate or abs(len(read) - len(sound)) > 0.001 * rate:
                raise UsageError(
                    f"{path} has {len(read)} frames at {its_rate} Hz, the sound {len(sound)} at "
                    f"{rate} Hz; make both equal"
                )
            found = np.resize(read.mean(axis=1), len(sound))
        else:
            with TemporaryDirectory() as folder:
                target = Path(folder) / "vibration.wav"
                source = self.design.stimuli[stimulus].file
                render_file(source, target, Settings(profile=condition.method))
                found = soundfile.read(target, always_2d=True)[0][:, 0]
        if _rms(found) < SILENT:
            told = f"condition {name!r} gives no vibration for {stimulus!r}"
            raise UsageError(f"{told}; leave one of them out of the question")
        return found

    def _levelled(self, stimulus: str, name: str) -> FloatArray:
        """Return a vibration at the level of the study, or lower if a condition needs it."""
        if self._is_none(name):
            return np.zeros(1)
        together = {
            one
            for q in self.design.questions.values()
            if stimulus in q.stimuli
            for one in q.conditions
            if not self._is_none(one)
        }
        rate = self._sound(stimulus)[1]
        peaks = []
        for one in together:
            with suppress(UsageError):
                signal = self._vibration(stimulus, one)
                gain_db = max(0.0, self.design.conditions[one].gain_db)
                crest = np.abs(signal).max() / weighted_level(signal, rate, len(signal))
                peaks.append(float(crest) * 10.0 ** (gain_db / 20.0))
        wanted = 10.0 ** (self.design.study.level_db / 20.0)
        level = min(wanted, PEAK_MAX / max(peaks, default=1.0))
        self.lowered_db[stimulus] = 20.0 * log10(wanted / level)
        signal = self._vibration(stimulus, name)
        return np.asarray(signal * (level / weighted_level(signal, rate, len(signal))))

    def _masked(self, sound: FloatArray, pad: int, rate: int) -> FloatArray:
        padded = np.pad(sound, ((pad, pad), (0, 0)))
        if (masking_db := self.design.study.masking_db) is not None:
            noise = np.random.default_rng(self.design.study.seed).standard_normal(len(padded))
            hz = np.fft.rfftfreq(len(padded), 1.0 / rate)
            pink = irfft(rfft(noise) / np.sqrt(np.maximum(hz, 20.0)), len(padded))
            padded = padded + (10.0 ** (masking_db / 20.0) / _rms(pink) * pink)[:, None]
        return padded


def _write(path: Path, signal: FloatArray, rate: int) -> None:
    output = WavOutput(path, rate, signal.shape[1])
    output.write(signal)
    output.close()


def _rms(signal: FloatArray) -> float:
    return float(np.sqrt(np.mean(signal**2)))


def weighted_level(signal: FloatArray, rate: int, frames: int) -> float:
    """Return the level of a vibration, (samples,); 1 for a full-scale sine of 80 Hz.

    rate: in Hz. frames: length without the silence around.
    """
    ring = np.zeros(rate // 2)  # the filter's ringing counts
    weighted = sosfilt(wk_sections(rate), np.concatenate((signal, ring)))
    return float(np.sqrt(np.sum(weighted**2) / frames)) / _of_sine(rate)


@lru_cache
def _of_sine(rate: int) -> float:
    sine = np.sin(2.0 * np.pi * REFERENCE_HZ / rate * np.arange(4 * rate))
    return float(np.sqrt(np.mean(sosfilt(wk_sections(rate), sine)[rate:] ** 2)))
