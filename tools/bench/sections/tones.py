"""Sections on steady tones: error and purity of what comes out, and gain at every samplerate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform import FloatArray, TransformParameters
from audioflinger_hook.transform.mapping import vibration_hz
from audioflinger_hook.transform.reference.transform import ReferenceTransform
from tools.bench.measures.vibration import SineFit, sine_fit
from tools.bench.report import Must, Row, Section
from tools.bench.sounds.signals import SAMPLERATE, tone
from tools.bench.workbench import LIVE, REFERENCE, Workbench

MID_HZ, LOW_HZ = (150.0, 11_000.0), (55.0, 150.0)
AMPLITUDES = (0.02, 0.1, 0.3, 1.0)
REFERENCE_AMPLITUDE = 0.3
PURITY_LEAD = Must("<=", -70.0)
ERRORS = (
    ("frequency error", "Hz", "frequency_error_hz", Must("<=", 0.3), Must("<=", 0.05)),
    ("level error", "dB", "level_error_db", Must("<=", 0.5), Must("<=", 0.2)),
    ("THD+N", "dB", "thdn_db", Must("<=", -60.0), PURITY_LEAD),
)
"""Name, unit, field, limit over MID_HZ, and aim over both ranges."""

SAMPLERATES = (8_000, 11_025, 16_000, 22_050, 44_100, 48_000, 96_000, 192_000)
GAIN_HZ = (150.0, 3_000.0)
"""The highest is what the lowest samplerate leaves of the band."""
GAIN_TONE_S = 1.0
GAIN_SPREAD = Must("<=", 0.1)


@dataclass(frozen=True)
class _ToneResult:
    """One tone through the live form: its label and its errors."""

    label: str
    frequency_error_hz: float
    level_error_db: float
    thdn_db: float


def steady_tones(bench: Workbench) -> Section:
    """Frequency, level and purity of steady tones, by range."""
    rows: list[Row] = []
    for (low_hz, high_hz), count in (
        (MID_HZ, bench.effort.tones),
        (LOW_HZ, bench.effort.low_tones),
    ):
        frequencies_hz = np.geomspace(low_hz, high_hz, count).tolist()
        results = [_measured(bench, f, a) for f in frequencies_hz for a in AMPLITUDES]
        span = f"{low_hz:g} to {high_hz:g} Hz"
        for what, unit, field, must, lead in ERRORS:
            values = [getattr(result, field) for result in results]
            worst = results[int(np.argmax(values))]
            asked = must if low_hz == MID_HZ[0] else None
            name = f"worst {what}, {span}"
            rows.append(Row(name, max(values), unit, LIVE, asked, note=worst.label, lead=lead))
        reference_db = max(_reference_thdn_db(bench, f) for f in frequencies_hz)
        rows.append(Row(f"worst THD+N, {span}", reference_db, "dB", REFERENCE))
    return Section(
        "Steady tones",
        "A steady tone should come out as one pure sinusoid at its frequency on the scale, as "
        f"strong as in the reference form. {bench.effort.tones} and {bench.effort.low_tones} "
        f"frequencies at amplitudes {', '.join(f'{a:g}' for a in AMPLITUDES)}, "
        f"{bench.effort.tone_s:g} s each. THD+N is what the best-fitting sinusoid leaves in the "
        "middle half. The reference form is measured at one amplitude. It restarts its phases "
        "with every unit sequence, which makes a buzz.",
        tuple(rows),
    )


def gain_over_samplerates(bench: Workbench) -> Section:
    """Level of tones at all usual samplerates against 48 kHz."""
    frequencies_hz = np.geomspace(*GAIN_HZ, bench.effort.gain_tones).tolist()
    usual = SAMPLERATES.index(SAMPLERATE)
    rows = []
    for form in (LIVE, REFERENCE):
        levels_db = np.array(
            [[_level_db(bench, form, hz, rate) for rate in SAMPLERATES] for hz in frequencies_hz]
        )
        one_db = np.abs(levels_db - levels_db[:, [usual]])
        mean_db = np.abs((levels_db - levels_db[:, [usual]]).mean(axis=0))
        tone_at, rate_at = np.unravel_index(one_db.argmax(), one_db.shape)
        note = f"{form}: at {SAMPLERATES[int(mean_db.argmax())]} Hz"
        rows.append(Row("gain, largest deviation", float(mean_db.max()), "dB", form, note=note))
        note = f"{form}: {frequencies_hz[tone_at]:.0f} Hz at {SAMPLERATES[rate_at]} Hz"
        must = GAIN_SPREAD if form == LIVE else None
        rows.append(
            Row("one tone, largest deviation", float(one_db.max()), "dB", form, must, note=note)
        )
    return Section(
        "Gain at every samplerate",
        f"The same sound should feel equally strong at every samplerate, {SAMPLERATES[0]} to "
        f"{SAMPLERATES[-1]} Hz against {SAMPLERATE} Hz. The gain is the mean over "
        f"{bench.effort.gain_tones} tones of {GAIN_HZ[0]:g} to {GAIN_HZ[1]:g} Hz. In the reference "
        "form a single tone deviates more: its measured bandwidth depends on its place between "
        "two bins.",
        tuple(rows),
    )


def _measured(bench: Workbench, frequency_hz: float, amplitude: float) -> _ToneResult:
    sound = tone(frequency_hz, amplitude, bench.effort.tone_s)
    fit = _fit_middle(bench.subject(LIVE).vibration(sound, SAMPLERATE), SAMPLERATE)
    wanted_hz = float(vibration_hz(np.array(frequency_hz), TransformParameters()))
    wanted = reference_amplitude(sound, SAMPLERATE)
    return _ToneResult(
        f"{frequency_hz:.0f} Hz at {amplitude:g}",
        abs(fit.frequency_hz - wanted_hz),
        abs(20.0 * float(np.log10(fit.amplitude / wanted))),
        fit.residual_db,
    )


def _reference_thdn_db(bench: Workbench, frequency_hz: float) -> float:
    sound = tone(frequency_hz, REFERENCE_AMPLITUDE, bench.effort.tone_s)
    vibration = bench.subject(REFERENCE).vibration(sound, SAMPLERATE)
    return _fit_middle(vibration, SAMPLERATE).residual_db


def _fit_middle(vibration: FloatArray, samplerate: int) -> SineFit:
    quarter = vibration.size // 4
    return sine_fit(vibration[quarter : 3 * quarter], samplerate)


def reference_amplitude(sound: FloatArray, samplerate: int) -> float:
    """Return P_k r_k / (1.30 fs/N) of a tone by the reference form: the median over its units.

    The strongest partial of each unit counts.
    """
    parameters = TransformParameters()
    reference = ReferenceTransform(parameters, samplerate)
    units = reference.cut(sound)
    found = reference.analyse(units)
    edges = found.boundaries(len(units))
    parts = (found.r[edges[unit] : edges[unit + 1]] for unit in range(len(units)))
    strongest = [float((r * r).max() / r.sum()) if r.size else 0.0 for r in parts]
    return float(np.median(strongest)) / parameters.unit_strength_hz(samplerate)


def _level_db(bench: Workbench, form: str, frequency_hz: float, samplerate: int) -> float:
    sound = tone(frequency_hz, REFERENCE_AMPLITUDE, GAIN_TONE_S, samplerate)
    if form == REFERENCE:
        level = reference_amplitude(sound, samplerate)
    else:
        vibration = bench.subject(LIVE).vibration(sound, samplerate)
        level = _fit_middle(vibration, samplerate).amplitude
    return 20.0 * float(np.log10(level))
