"""Section on the frontier: what each setting of the live form costs and what error it has."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.signal import hilbert

from audioflinger_hook.transform import FloatArray, TransformParameters
from audioflinger_hook.transform.mapping import vibration_hz
from tools.bench.measures.vibration import energy_above_db, onset_lag_s, sine_fit
from tools.bench.report import Row, Section, number
from tools.bench.sections.fidelity import (
    BURST_AMPLITUDE,
    BURST_HZ,
    BURST_ONSET_S,
    REST_S,
)
from tools.bench.sections.frontier_settings import DEFAULT, SETTINGS, Setup
from tools.bench.sounds.signals import (
    SAMPLERATE,
    Stereo,
    burst,
    demo_sound,
    tone,
)
from tools.bench.workbench import Playback, Workbench, timed

TITLE = "Cost against error"
BLOCKSIZE = 256
SCENE_FROM_S, SCENE_S = 6.9, 2.0
"""Of the demo scene: footsteps, then speech."""
TONES_HZ, TONE_S, AMPLITUDE = (60.0, 10_000.0), 1.0, 0.3
CHIRP_FROM_HZ, CHIRP_OCTAVES_A_S, CHIRP_S = 200.0, 2.0, 1.5
CHIRP_SETTLED_S = 0.4
SWELL_HZ, SWELL_DEPTH = 4.0, 0.5
NOTES, HARMONICS, NOTE_HZ, NOTE_DECAY_S = 24, 12, (98.0, 660.0), 0.3
NOTE_REACH_HZ = 10.8
"""A partial within half of 1/T of its frequency is found."""

COST, TONE_ERROR, TONE_LEVEL, CHIRP = "cost", "tones", "tones, level", "chirp"
SWELL, PURITY, LAG, LEAK = "AM, level", "THD+N", "lag, p95", "over 250 Hz"
MISSED, SPURIOUS = "missed", "spurious"
UNITS = {
    COST: "ms", TONE_ERROR: "Hz", TONE_LEVEL: "dB", CHIRP: "Hz", SWELL: "dB", PURITY: "dB",
    LAG: "ms", LEAK: "dB", MISSED: "%", SPURIOUS: "%",
}  # fmt: skip
"""Measures of a setting and their units; less is better."""
BLUR = {
    COST: 0.1, TONE_ERROR: 1e-3, TONE_LEVEL: 0.01, CHIRP: 0.1, SWELL: 0.02, PURITY: 1.0,
    LAG: 0.7, LEAK: 0.7, MISSED: 0.3, SPURIOUS: 0.3,
}  # fmt: skip
"""Differences within the spread of repeats count as none; that of cost is a share."""


def frontier(bench: Workbench) -> Section:
    """Cost and errors of the live form, one setting changed at a time."""
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
        "The live form with one "
        f"setting changed at a time. Cost: of a second of stereo, on {SCENE_S:g} s of the demo "
        f"scene, the least of {bench.effort.cost_repeats} repeats. Tones are steady, "
        f"{TONES_HZ[0]:g} to {TONES_HZ[1]:g} Hz; their errors are root mean squares, their THD+N "
        f"is the worst. The chirp has {CHIRP_OCTAVES_A_S:g} octaves a second. The level swells at "
        f"{SWELL_HZ:g} Hz. Missed and spurious partials are those of {NOTES} decaying notes of "
        f"{HARMONICS} harmonics.",
        tuple(rows),
        footnote=_verdict(measured),
    )  # fmt: skip


def _errors(setup: Setup, scene: Stereo, count: int) -> dict[str, float]:
    """Return every error of a setting by its column."""
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
    """Return r.m.s. errors in Hz and dB, and the worst THD+N in dB, of steady tones."""
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
    """Return the gain of the band-pass for a tone, which is no error."""
    b, a = setup.made.input.band_b, setup.made.input.band_a
    delay = np.exp(-2j * np.pi * audio_hz / SAMPLERATE)
    powers = delay ** np.arange(a.size)
    return float(np.abs((b * powers).sum() / (a * powers).sum()))


def _chirp_error_hz(setup: Setup) -> float:
    """Return the r.m.s. error in Hz of vibration on a chirp, at the latency of sustained levels."""
    time_s = np.arange(round(CHIRP_S * SAMPLERATE)) / SAMPLERATE
    growth = CHIRP_OCTAVES_A_S * np.log(2.0)
    phase = 2.0 * np.pi * CHIRP_FROM_HZ / growth * (np.exp(growth * time_s) - 1.0)
    vibration = setup.vibration(AMPLITUDE * np.sin(phase))
    turned = np.unwrap(np.angle(hilbert(vibration)))
    span = SAMPLERATE // 50  # a mean over 20 ms
    found_hz = (turned[span:] - turned[:-span]) / span * SAMPLERATE / (2.0 * np.pi)
    middle_s = time_s[:-span] + 0.5 * span / SAMPLERATE - setup.tonal_latency_frames / SAMPLERATE
    settled = (time_s[:-span] > CHIRP_SETTLED_S) & (time_s[:-span] < CHIRP_S - 0.1)
    audio_hz = CHIRP_FROM_HZ * np.exp(growth * middle_s[settled])
    return _rms(found_hz[settled] - vibration_hz(audio_hz, setup.parameters))


def _swell_error_db(setup: Setup) -> float:
    """Return the r.m.s. error in dB of a swelling level, at the latency of sustained levels."""
    duration_s = 1.5
    time_s = np.arange(round(duration_s * SAMPLERATE)) / SAMPLERATE
    swell = 1.0 + SWELL_DEPTH * np.sin(2.0 * np.pi * SWELL_HZ * time_s)
    vibration = setup.vibration(tone(1_000.0, AMPLITUDE, duration_s) * swell)
    late = setup.tonal_latency_frames
    middle = slice(SAMPLERATE // 4, vibration.size - late - SAMPLERATE // 10)
    level = np.abs(hilbert(vibration))[late:][middle]
    return _rms(20.0 * np.log10(level / (AMPLITUDE * swell[middle])))


def _lag_p95_ms(setup: Setup, count: int) -> float:
    """Return the 95th percentile of the onset lag over twice as many bursts as count."""
    stream_s = BURST_ONSET_S + 0.4  # the measure looks at 0.2 s after the latest onset
    lags = []
    for place, audio_hz in enumerate(np.geomspace(*BURST_HZ, 2 * count)):
        # Onsets are spread over the window by the golden ratio.
        onset_s = BURST_ONSET_S + (0.618 * place % 1.0) * TransformParameters().window_s
        sound = burst(float(audio_hz), BURST_AMPLITUDE, onset_s, stream_s)
        lags.append(1e3 * onset_lag_s(setup.vibration(sound), SAMPLERATE, onset_s))
    return float(np.percentile(lags, 95))


def _notes(setup: Setup) -> tuple[float, float]:
    """Return missed and spurious partials of decaying notes, in percent of all."""
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
    """Return what every other setting costs and gains, and which dominate the defaults."""
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
        f"Better in something and worse in nothing than the defaults: {', '.join(dominating)}."
        if dominating
        else "The defaults lie on the frontier: no other setting is better in something and worse "
        "in nothing."
    )
    return "\n".join((said, "Compared with them, beyond the spread of repeats:", *lines))
