"""What is felt of single sounds: match, leak, deep energy, how files begin, tones, pairs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform import FloatArray
from tools.bench.measures.loudness import momentary_sone
from tools.bench.measures.match import PIECE_S, POOR, match, pieces_rms
from tools.bench.measures.vibration import energy_above_db, steady_fit
from tools.bench.methods import Method
from tools.bench.report import Row
from tools.bench.sounds.films import from_onset
from tools.bench.sounds.real_sounds import RealSound
from tools.bench.sounds.signals import SAMPLERATE, tone

SILENCE_S = 0.5
"""Before and after every single sound, so that it begins and ends at rest."""
LOW_HZ, LOW_DB, LEAK_DB = 15.0, -24.0, -55.0
POOR_SHARE = 5.0
TONES_HZ, TONE_AMPLITUDES, TONE_S, SETTLED_S = (60.0, 8_000.0), (0.02, 0.2), 6.0, 3.0
THD_DB = -60.0
BEGIN_S, STEP_SHARE = 1.0, 0.02


@dataclass(frozen=True)
class Single:
    """One sound's vibration: match with its loudness, and shares of its energy in dB."""

    match: float
    leak_db: float
    low_db: float


def single(method: Method, one: RealSound) -> Single:
    """Return what is measured of a sound by itself."""
    silence = np.zeros(round(SILENCE_S * SAMPLERATE))
    vibration = method.vibration(np.concatenate((silence, one.sound, silence)))
    sone = momentary_sone(one.sound, PIECE_S)
    rms = pieces_rms(vibration[silence.size : -silence.size], SAMPLERATE)
    return Single(
        match(sone, rms),
        energy_above_db(vibration, SAMPLERATE),
        energy_under_db(vibration, SAMPLERATE, LOW_HZ),
    )


def energy_under_db(vibration: FloatArray, samplerate: int, corner_hz: float) -> float:
    """Return the energy under a corner in dB of all of it, at least -120; no window."""
    spectrum = np.fft.rfft(vibration, 2 * vibration.size)
    power = spectrum.real**2 + spectrum.imag**2
    low = np.fft.rfftfreq(2 * vibration.size, 1.0 / samplerate) < corner_hz
    whole = float(power.sum())
    return 10.0 * float(np.log10(power[low].sum() / whole + 1e-12)) if whole else -120.0


def single_rows(methods: Sequence[Method], sounds: Sequence[RealSound]) -> Iterator[Row]:
    """Yield the rows of match, leak and deep energy over all sounds, each by itself."""
    for method in methods:
        found = [single(method, one) for one in sounds]
        matches = np.array([one.match for one in found])
        poor = 100.0 * float(np.mean(matches < POOR))
        must = method.must("<=", POOR_SHARE)
        yield Row(f"match under {POOR:g}", poor, "% of sounds", method.name, must)
        yield Row("match, mean", float(matches.mean()), "", method.name)
        at = int(np.argmax([one.leak_db for one in found]))
        yield Row(
            "energy above 250 Hz, worst sound", found[at].leak_db, "dB", method.name,
            method.must("<=", LEAK_DB), note=f"{method.name}: {sounds[at].name}",
        )  # fmt: skip
        at = int(np.argmax([one.low_db for one in found]))
        yield Row(
            "energy under 15 Hz, worst sound", found[at].low_db, "dB", method.name,
            method.must("<=", LOW_DB), note=f"{method.name}: {sounds[at].name}",
        )  # fmt: skip


def beginning_rows(methods: Sequence[Method], sounds: Sequence[RealSound]) -> Iterator[Row]:
    """Yield how many files that begin amid a sound begin with a step over 2 % of their peak."""
    parts = [from_loudest(one.sound) for one in sounds]
    for method in methods:
        begun = [method.vibration(one) for one in parts]
        count = sum(step_share(one) > STEP_SHARE for one in begun)
        must = method.must("<=", 0.0)
        title = "files that begin with a step over 2 % of the peak"
        yield Row(title, float(count), f"of {len(parts)}", method.name, must)


def from_loudest(sound: FloatArray) -> FloatArray:
    """Return at most a second of a sound from its loudest sample on."""
    return from_onset(sound[int(np.abs(sound).argmax()) :])[: round(BEGIN_S * SAMPLERATE)]


def step_share(vibration: FloatArray) -> float:
    """Return the first sample as a share of the peak; silence has 0."""
    peak = float(np.abs(vibration).max(initial=0.0))
    return abs(float(vibration[0])) / peak if peak else 0.0


def tone_rows(methods: Sequence[Method], count: int) -> Iterator[Row]:
    """Yield the worst THD+N of steady tones, their slow drift of level taken out."""
    for method in methods:
        worst, where = -np.inf, ""
        for amplitude in TONE_AMPLITUDES:
            for hz in np.geomspace(*TONES_HZ, count).round(1).tolist():
                vibration = method.vibration(tone(hz, amplitude, TONE_S))
                left_db = steady_fit(
                    vibration[round(SETTLED_S * SAMPLERATE) : -SAMPLERATE // 2], SAMPLERATE
                )
                if left_db > worst:
                    worst, where = left_db, f"{method.name}: {hz:g} Hz at {amplitude:g}"
        must = method.must("<=", THD_DB)
        yield Row("THD+N of a tone, worst", float(worst), "dB", method.name, must, note=where)
