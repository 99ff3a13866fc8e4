"""Section "Steady tones": errors and purity of the vibration of steady tones."""

from __future__ import annotations

import numpy as np

from audioflinger_hook.transform import FloatArray, TransformParameters
from audioflinger_hook.transform.mapping import vibration_hz
from audioflinger_hook.transform.reference import ReferenceTransform
from tools.bench.measures.vibration import SineFit, sine_fit
from tools.bench.report import Must, Row, Section
from tools.bench.sounds.signals import SAMPLERATE, tone
from tools.bench.workbench import LIVE, REFERENCE, Workbench

MID_HZ, LOW_HZ = (150.0, 11_000.0), (55.0, 150.0)
AMPLITUDES = (0.02, 0.1, 0.3, 1.0)
REFERENCE_AMPLITUDE = 0.3
PURITY_LEAD = Must("<=", -70.0)
ERRORS = (
    ("frequency error", "Hz", Must("<=", 0.3), Must("<=", 0.05)),
    ("level error", "dB", Must("<=", 0.5), Must("<=", 0.2)),
    ("THD+N", "dB", Must("<=", -60.0), PURITY_LEAD),
)


def steady_tones(bench: Workbench) -> Section:
    """Measure errors of frequency and level, and THD+N, of the vibration of steady tones."""
    rows: list[Row] = []
    for (low_hz, high_hz), count in (
        (MID_HZ, bench.effort.tones),
        (LOW_HZ, bench.effort.low_tones),
    ):
        frequencies_hz = np.geomspace(low_hz, high_hz, count).tolist()
        labels = [f"{f:.0f} Hz at {a:g}" for f in frequencies_hz for a in AMPLITUDES]
        errors = [_errors(bench, f, a) for f in frequencies_hz for a in AMPLITUDES]
        span = f"{low_hz:g} to {high_hz:g} Hz"
        for (what, unit, must, lead), values in zip(ERRORS, zip(*errors, strict=True), strict=True):
            asked = must if low_hz == MID_HZ[0] else None
            name, worst = f"worst {what}, {span}", labels[int(np.argmax(values))]
            rows.append(Row(name, max(values), unit, LIVE, asked, note=worst, lead=lead))
        reference_db = max(_reference_thdn_db(bench, f) for f in frequencies_hz)
        rows.append(Row(f"worst THD+N, {span}", reference_db, "dB", REFERENCE))
    return Section(
        "Steady tones",
        "The vibration of a steady tone should be one pure sinusoid at the mapped frequency, with "
        f"the amplitude that the reference form computes. The tones have {bench.effort.tones} "
        f"frequencies from 150 Hz up and {bench.effort.low_tones} lower frequencies, and last "
        f"{bench.effort.tone_s:g} s. Their amplitudes, relative to full scale, are "
        f"{', '.join(f'{a:g}' for a in AMPLITUDES)}. For THD+N, the sinusoid that fits best is "
        "subtracted from the vibration in the middle half of the tone. THD+N is the level of the "
        "rest relative to this sinusoid. The reference form is measured only at the amplitude "
        f"{REFERENCE_AMPLITUDE:g}. The THD+N of the reference form is high, because its sinusoids "
        "restart in every analysis window.",
        tuple(rows),
    )


def _errors(bench: Workbench, frequency_hz: float, amplitude: float) -> tuple[float, float, float]:
    sound = tone(frequency_hz, amplitude, bench.effort.tone_s)
    fit = _fit_middle(bench.subject(LIVE).vibration(sound, SAMPLERATE))
    wanted_hz = float(vibration_hz(np.array(frequency_hz), TransformParameters()))
    level_db = 20.0 * float(np.log10(fit.amplitude / reference_amplitude(sound)))
    return abs(fit.frequency_hz - wanted_hz), abs(level_db), fit.residual_db


def _reference_thdn_db(bench: Workbench, frequency_hz: float) -> float:
    sound = tone(frequency_hz, REFERENCE_AMPLITUDE, bench.effort.tone_s)
    vibration = bench.subject(REFERENCE).vibration(sound, SAMPLERATE)
    return _fit_middle(vibration).residual_db


def _fit_middle(vibration: FloatArray) -> SineFit:
    quarter = vibration.size // 4
    return sine_fit(vibration[quarter : 3 * quarter], SAMPLERATE)


def reference_amplitude(sound: FloatArray) -> float:
    """Return the amplitude that the reference form gives to a tone.

    In each analysis window, the strongest partial k has the amplitude P_k r_k / (1.30 fs/N), as
    docs/transform.md explains. The result is the median over all windows.
    """
    parameters = TransformParameters()
    reference = ReferenceTransform(parameters, SAMPLERATE)
    units = reference.cut(sound)
    found = reference.analyse(units)
    edges = found.boundaries(len(units))
    parts = (found.r[edges[unit] : edges[unit + 1]] for unit in range(len(units)))
    strongest = [float((r * r).max() / r.sum()) if r.size else 0.0 for r in parts]
    return float(np.median(strongest)) / parameters.unit_strength_hz(SAMPLERATE)
