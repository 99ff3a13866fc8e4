"""Rows for the report: channels and sample rates of sounds, and synthetic signals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from audioflinger_hook.transform import FloatArray
from tools.bench.measures.vibration import energy_above_db
from tools.bench.methods import Method
from tools.bench.report import Row
from tools.bench.sounds.real_sounds import RealSound, at_rate, of_kinds
from tools.bench.sounds.signals import SAMPLERATE, tone

SUB_BASS_HZ, SUB_BASS_AMPLITUDE, WANTED_DB = (25.0, 30.0, 35.0, 40.0), 0.25, -18.0
OFF_DB, AIM_DB = 4.0, 2.0
OTHER_RATE = 44_100
PIECE_S, COMPARED_DB = (
    0.1,
    -40.0,
)  # length of compared pieces in s; lowest level in dB relative to the strongest piece
A_KIND = 2  # number of sounds of each class that are compared at two rates and in several channels
CENTRE = 10.0 ** (-3.0 / 20.0)  # gain of centre and surround in left and right (ITU-R BS.775)


def sub_bass_rows(methods: Sequence[Method]) -> Iterator[Row]:
    """Yield the level of the vibration of tones from 25 to 40 Hz, and its error.

    The wanted level is -18 dB relative to a full-scale sine. The error is the absolute difference
    from the wanted level, in dB.
    """
    for hz in SUB_BASS_HZ:
        for method in methods:
            vibration = method.vibration(tone(hz, SUB_BASS_AMPLITUDE, 8.0))
            level = level_db(vibration[-2 * SAMPLERATE :])
            yield Row(f"{hz:g} Hz tone at 0.25", level, "dB", method.name)
            off, must = abs(level - WANTED_DB), method.must_of_whole("<=", OFF_DB)
            lead = method.must_of_whole("<=", AIM_DB)
            title = f"{hz:g} Hz tone at 0.25: off -18 dB"
            yield Row(title, off, "dB", method.name, must, lead=lead)


def level_db(vibration: FloatArray) -> float:
    """Return the level of a vibration in dB relative to a full-scale sine, at least -100."""
    return float(10.0 * np.log10(2.0 * np.mean(vibration**2) + 1e-10))


def channel_rows(profiles: Sequence[Method], sounds: Sequence[RealSound]) -> Iterator[Row]:
    """Yield how much the level of the vibration depends on the channels that contain a sound.

    Sounds in L and R, or in C, of 5.1 channels are compared with their stereo downmix by ITU-R
    BS.775. In the sounds in L and R, R is L delayed by 5 ms. Stereo sounds with L = -R are compared
    with the same sounds with L = R.
    """
    some = _some(sounds)
    for profile in profiles:
        surround, centre, opposite = [], [], []
        for each in some:
            left, right = each.sound, np.roll(each.sound, 240)
            mixed = CENTRE * left
            surround.append(_difference_db(profile, {0: left, 1: right}, [left, right]))
            opposite.append(_difference_db(profile, {0: left, 1: -left}, [left, left], 2))
            if each.kind == "speech":
                centre.append(_difference_db(profile, {2: left}, [mixed, mixed]))
        for title, off in (
            ("stereo in L and R of 5.1", surround),
            ("speech in the centre", centre),
        ):
            middle = float(np.median(off)) if off else float("nan")
            yield Row(f"{title}, against stereo", middle, "dB", profile.name)
            must = profile.must("<=", 0.5)
            yield Row(f"{title}: off ITU-R BS.775", abs(middle), "dB", profile.name, must)
        lost, must = float(np.median(opposite)), profile.must(">=", -6.0)
        yield Row("L = -R against L = R", lost, "dB", profile.name, must)


def _difference_db(
    profile: Method, channels: dict[int, FloatArray], stereo: list[FloatArray], count: int = 6
) -> float:
    frames = np.zeros((stereo[0].size, count))
    for number, sound in channels.items():
        frames[:, number] = sound
    levels = [level_db(profile.vibration(each)) for each in (frames, np.stack(stereo, axis=1))]
    return levels[0] - levels[1]


def rate_rows(methods: Sequence[Method], sounds: Sequence[RealSound]) -> Iterator[Row]:
    """Yield the r.m.s. difference in dB between vibration levels of sounds at 44.1 and 48 kHz."""
    for method in methods:
        differences = []
        for each in _some(sounds):
            other = at_rate(each.sound, SAMPLERATE, OTHER_RATE)
            # Both signals have the bandwidth of the lower rate.
            same = at_rate(other, OTHER_RATE, SAMPLERATE)
            one = _pieces_db(method.vibration(same), SAMPLERATE)
            two = _pieces_db(method.vibration(other, 0.0, OTHER_RATE), OTHER_RATE)
            pieces = min(one.size, two.size)
            if pieces:
                strong = one[:pieces] > one.max() + COMPARED_DB
                differences.append((one[:pieces] - two[:pieces])[strong])
        rms = float(np.sqrt(np.mean(np.concatenate(differences) ** 2)))
        title = "44.1 against 48 kHz, each 0.1 s, r.m.s."
        yield Row(title, rms, "dB", method.name, method.must("<=", 0.7))


def _pieces_db(vibration: FloatArray, samplerate: int) -> FloatArray:
    frames = round(PIECE_S * samplerate)
    pieces = vibration[: vibration.size // frames * frames].reshape(-1, frames)
    levels: FloatArray = 10.0 * np.log10(2.0 * (pieces**2).mean(axis=1) + 1e-12)
    return levels


def _some(sounds: Sequence[RealSound]) -> list[RealSound]:
    kinds = dict.fromkeys(each.kind for each in sounds)
    return [each for kind in kinds for each in of_kinds(sounds, kind)[:A_KIND]]


def chirp() -> FloatArray:
    """Return 6 s of a tone of 800 Hz, frequency-modulated by ±400 Hz at 5 Hz, amplitude 0.4."""
    time_s = np.arange(6 * SAMPLERATE) / SAMPLERATE
    phase = 2.0 * np.pi * 800.0 * time_s - 400.0 / 5.0 * np.cos(2.0 * np.pi * 5.0 * time_s)
    return 0.4 * np.sin(phase)


def chirp_rows(methods: Sequence[Method]) -> Iterator[Row]:
    """Yield the energy above 250 Hz, relative to the total, of the vibration of `chirp`."""
    silence = np.zeros(SAMPLERATE)
    sound = np.concatenate((silence, chirp(), silence))
    for method in methods:
        leak = energy_above_db(method.vibration(sound), SAMPLERATE)
        title = "chirp: energy above 250 Hz"
        yield Row(title, leak, "dB", method.name, method.must("<=", -50.0))


def end_rows(profiles: Sequence[Method]) -> Iterator[Row]:
    """Yield the largest magnitude of the vibration's last sample, for tones that end abruptly."""
    tones = [tone(hz, 0.5, 1.0) for hz in (60.0, 150.0, 440.0, 1_000.0)]
    for profile in profiles:
        last = max(abs(float(profile.vibration(each)[-1])) for each in tones)
        must = profile.must("<=", 0.01)
        yield Row("a file that ends in a tone: last sample", last, "", profile.name, must)
