"""Section "Cost against error": CPU time and errors of the live form with various settings."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.signal import hilbert

from audioflinger_hook.transform import FloatArray, TransformParameters
from audioflinger_hook.transform.mapping import vibration_hz
from tools.bench.measures.vibration import energy_above_db, onset_lag_s, sine_fit
from tools.bench.report import Row, Section, number
from tools.bench.sections.fidelity import BURST_AMPLITUDE, BURST_HZ, BURST_ONSET_S, REST_S
from tools.bench.sections.frontier_settings import DEFAULT, SETTINGS, Setup
from tools.bench.sounds.signals import SAMPLERATE, Stereo, burst, demo_sound, tone
from tools.bench.workbench import Playback, Workbench, timed

TITLE = "Cost against error"
BLOCKSIZE = 256
SCENE_FROM_S, SCENE_S = 6.9, 2.0  # part of the demo scene with speech: start and length in s
TONES_HZ, TONE_S, AMPLITUDE = (60.0, 10_000.0), 1.0, 0.3
CHIRP_FROM_HZ, CHIRP_OCTAVES_A_S, CHIRP_S = 200.0, 2.0, 1.5
CHIRP_SETTLED_S = 0.4
SWELL_HZ, SWELL_DEPTH = 4.0, 0.5
NOTES, HARMONICS, NOTE_HZ, NOTE_DECAY_S = 24, 12, (98.0, 660.0), 0.3
NOTE_REACH_HZ = 10.8  # largest frequency error in Hz of a found partial: half of 1 / window length
COST, TONE_ERROR, TONE_LEVEL, CHIRP = "cost", "tones", "tones, level", "chirp"
SWELL, PURITY, LAG, LEAK = "AM, level", "THD+N", "lag, p95", "over 250 Hz"
MISSED, SPURIOUS = "missed", "spurious"
UNITS = {
    COST: "ms", TONE_ERROR: "Hz", TONE_LEVEL: "dB", CHIRP: "Hz", SWELL: "dB", PURITY: "dB",
    LAG: "ms", LEAK: "dB", MISSED: "%", SPURIOUS: "%",
}  # fmt: skip
"""Measures of a setting and their units; smaller values are better."""
BLUR = {
    COST: 0.1, TONE_ERROR: 1e-3, TONE_LEVEL: 0.01, CHIRP: 0.1, SWELL: 0.02, PURITY: 1.0,
    LAG: 0.7, LEAK: 0.7, MISSED: 0.3, SPURIOUS: 0.3,
}  # fmt: skip
"""Spread of repeats; smaller differences count as zero. The spread of cost is a share of cost."""


def frontier(bench: Workbench) -> Section:
    """Measure CPU time and errors of the live form, with one setting changed at a time."""
    setups = [Setup(setting) for setting in SETTINGS]
    first = round(SCENE_FROM_S * SAMPLERATE)
    scene = demo_sound()[first : first + round(SCENE_S * SAMPLERATE)]
    timings = timed(
        [Playback(setup.subject, scene, BLOCKSIZE) for setup in setups], bench.effort.cost_repeats
    )
    count = bench.effort.frontier_sounds
    measured = {
        setup.setting.name: {
            COST: 1e3 * min(timing.seconds) / SCENE_S,
            **_errors(setup, scene, count),
        }
        for setup, timing in zip(setups, timings, strict=True)
    }
    rows = [
        Row(name, value, UNITS[column], f"{column}, {UNITS[column]}")
        for name, values in measured.items()
        for column, value in values.items()
    ]
    return Section(
        TITLE,
        "Each row changes one setting of the live form. Cost is CPU time for a second of stereo "
        f"sound, measured with {SCENE_S:g} s of the demo scene: the smallest value of "
        f"{bench.effort.cost_repeats} repeats. The columns *tones* show the root mean square "
        f"errors of frequency and level for steady tones of {TONES_HZ[0]:g} to {TONES_HZ[1]:g} "
        "Hz. The column *THD+N* shows the worst value for these tones. The column *chirp* shows "
        f"the frequency error for a tone whose frequency rises by {CHIRP_OCTAVES_A_S:g} octaves "
        "per second. The column *AM* shows the level error for a tone whose level is modulated "
        f"at {SWELL_HZ:g} Hz. Missed and spurious partials are counted for {NOTES} decaying "
        f"notes with {HARMONICS} harmonics each.",
        tuple(rows),
        footnote=_verdict(measured),
    )  # fmt: skip


def _errors(setup: Setup, scene: Stereo, count: int) -> dict[str, float]:
    tone_hz, tone_db, purity_db = _tone_errors(setup, count)
    missed, spurious = _notes(setup)
    rest = np.zeros((round(REST_S * SAMPLERATE), 2), scene.dtype)
    quiet = setup.vibration(np.concatenate((scene, rest)))
    return {
        TONE_ERROR: tone_hz,
        TONE_LEVEL: tone_db,
        PURITY: purity_db,
        CHIRP: _chirp_error_hz(setup),
        SWELL: _swell_error_db(setup),
        LAG: _lag_p95_ms(setup, count),
        LEAK: energy_above_db(quiet, SAMPLERATE),
        MISSED: missed,
        SPURIOUS: spurious,
    }


def _tone_errors(setup: Setup, count: int) -> tuple[float, float, float]:
    """Return r.m.s. errors of frequency (Hz) and level (dB) of tones, and the worst THD+N (dB)."""
    errors_hz, errors_db, purities_db = [], [], []
    for audio_hz in np.geomspace(*TONES_HZ, count):
        vibration = setup.vibration(tone(float(audio_hz), AMPLITUDE, TONE_S))
        fit = sine_fit(vibration[SAMPLERATE // 2 :], SAMPLERATE)
        wanted_hz = float(vibration_hz(np.array(audio_hz), setup.parameters))
        errors_hz.append(fit.frequency_hz - wanted_hz)
        errors_db.append(20.0 * np.log10(fit.amplitude / AMPLITUDE / _band_gain(setup, audio_hz)))
        purities_db.append(fit.residual_db)
    return _rms(errors_hz), _rms(errors_db), max(purities_db)


def _band_gain(setup: Setup, audio_hz: float) -> float:
    """Return the gain of the input's band-pass at a frequency."""
    b, a = setup.made.input.band_b, setup.made.input.band_a
    delay = np.exp(-2j * np.pi * audio_hz / SAMPLERATE)
    powers = delay ** np.arange(a.size)
    return float(np.abs((b * powers).sum() / (a * powers).sum()))


def _chirp_error_hz(setup: Setup) -> float:
    """Return the r.m.s. error in Hz of the frequency of a chirp's vibration.

    The latency is compensated.
    """
    time_s = np.arange(round(CHIRP_S * SAMPLERATE)) / SAMPLERATE
    growth = CHIRP_OCTAVES_A_S * np.log(2.0)
    phase = 2.0 * np.pi * CHIRP_FROM_HZ / growth * (np.exp(growth * time_s) - 1.0)
    vibration = setup.vibration(AMPLITUDE * np.sin(phase))
    turned = np.unwrap(np.angle(hilbert(vibration)))
    span = SAMPLERATE // 50  # length of a mean over 20 ms
    found_hz = (turned[span:] - turned[:-span]) / span * SAMPLERATE / (2.0 * np.pi)
    middle_s = time_s[:-span] + 0.5 * span / SAMPLERATE - setup.tonal_latency_frames / SAMPLERATE
    settled = (time_s[:-span] > CHIRP_SETTLED_S) & (time_s[:-span] < CHIRP_S - 0.1)
    audio_hz = CHIRP_FROM_HZ * np.exp(growth * middle_s[settled])
    return _rms(found_hz[settled] - vibration_hz(audio_hz, setup.parameters))


def _swell_error_db(setup: Setup) -> float:
    """Return the r.m.s. error in dB of the level of a modulated tone's vibration.

    The latency is compensated.
    """
    duration_s = 1.5
    time_s = np.arange(round(duration_s * SAMPLERATE)) / SAMPLERATE
    swell = 1.0 + SWELL_DEPTH * np.sin(2.0 * np.pi * SWELL_HZ * time_s)
    vibration = setup.vibration(tone(1_000.0, AMPLITUDE, duration_s) * swell)
    late = setup.tonal_latency_frames
    middle = slice(SAMPLERATE // 4, vibration.size - late - SAMPLERATE // 10)
    level = np.abs(hilbert(vibration))[late:][middle]
    return _rms(20.0 * np.log10(level / (AMPLITUDE * swell[middle])))


def _lag_p95_ms(setup: Setup, count: int) -> float:
    stream_s = BURST_ONSET_S + 0.4  # the measure uses the 0.2 s after the latest onset
    lags = []
    for place, audio_hz in enumerate(np.geomspace(*BURST_HZ, 2 * count)):
        # Onsets are distributed over the window by the golden ratio.
        onset_s = BURST_ONSET_S + (0.618 * place % 1.0) * TransformParameters().window_s
        sound = burst(float(audio_hz), BURST_AMPLITUDE, onset_s, stream_s)
        lags.append(1e3 * onset_lag_s(setup.vibration(sound), SAMPLERATE, onset_s))
    return float(np.percentile(lags, 95))


def _notes(setup: Setup) -> tuple[float, float]:
    """Return missed and spurious partials of decaying notes, in % of all partials."""
    rng = np.random.default_rng(6)
    time_s = np.arange(setup.made.grid.window_frames) / SAMPLERATE
    note_hz = np.exp(rng.uniform(np.log(NOTE_HZ[0]), np.log(NOTE_HZ[1]), NOTES))
    order = np.arange(1, HARMONICS + 1)
    wanted_hz = note_hz[:, None] * order
    turns = 2.0 * np.pi * wanted_hz[:, :, None] * time_s
    phases = rng.uniform(0.0, 2.0 * np.pi, (NOTES, HARMONICS, 1))
    waves = np.sin(turns + phases) * (AMPLITUDE / order)[:, None]
    windows = waves.sum(axis=1) * np.exp(-time_s / NOTE_DECAY_S)
    found = setup.analysis()(windows)
    hits = np.zeros(wanted_hz.shape, dtype=bool)
    spurious = 0
    for row, audio_hz in zip(found.row, found.audio_hz, strict=True):
        near = np.abs(wanted_hz[row] - audio_hz) < NOTE_REACH_HZ
        spurious += not (near & ~hits[row]).any()
        hits[row] |= near
    return 100.0 * float((~hits).mean()), 100.0 * spurious / hits.size


def _rms(errors: FloatArray | list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


def _verdict(measured: Mapping[str, Mapping[str, float]]) -> str:
    """Return a text that compares each setting with the default."""
    default = measured[DEFAULT]
    dominating = []
    lines = []
    for name, values in measured.items():
        better: list[str] = []
        worse: list[str] = []
        for column, blur in BLUR.items():
            apart = blur * default[column] if column == COST else blur
            if abs(values[column] - default[column]) > apart:
                side = better if values[column] < default[column] else worse
                side.append(f"{column} {number(values[column])} {UNITS[column]}")
        if better and not worse:
            dominating.append(name)
        if name != DEFAULT:
            lines.append(
                f"- {name}: better in {', '.join(better) or 'nothing'}; "
                f"worse in {', '.join(worse) or 'nothing'}"
            )
    said = (
        "These settings are better than the defaults in at least one column, and worse in no "
        f"column: {', '.join(dominating)}."
        if dominating
        else "The defaults lie on the frontier: no other setting is better in something and worse "
        "in nothing."
    )
    compared = (
        "The list shows differences from the defaults that are larger than the spread of repeats:"
    )
    return "\n".join((said, compared, *lines))
