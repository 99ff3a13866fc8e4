"""Section on steady tones: errors and purity of the vibration."""

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
"""Name, unit, limit over MID_HZ, and aim over both ranges."""


def steady_tones(bench: Workbench) -> Section:
    """Frequency, level and purity of steady tones, by range."""
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
        "A steady tone should come out as one pure sinusoid at its frequency on the scale, as "
        f"strong as in the reference form. {bench.effort.tones} and {bench.effort.low_tones} "
        f"frequencies at amplitudes {', '.join(f'{a:g}' for a in AMPLITUDES)}, "
        f"{bench.effort.tone_s:g} s each. THD+N is what the best-fitting sinusoid leaves in the "
        "middle half. The reference form is measured at one amplitude. It restarts its phases "
        "with every unit sequence, which makes a buzz.",
        tuple(rows),
    )


def _errors(bench: Workbench, frequency_hz: float, amplitude: float) -> tuple[float, float, float]:
    """Return the errors of a tone through the live form, in the order of ERRORS."""
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
    """Return P_k r_k / (1.30 fs/N) of a tone by the reference form: the median over its units.

    The strongest partial of each unit counts.
    """
    parameters = TransformParameters()
    reference = ReferenceTransform(parameters, SAMPLERATE)
    units = reference.cut(sound)
    found = reference.analyse(units)
    edges = found.boundaries(len(units))
    parts = (found.r[edges[unit] : edges[unit + 1]] for unit in range(len(units)))
    strongest = [float((r * r).max() / r.sum()) if r.size else 0.0 for r in parts]
    return float(np.median(strongest)) / parameters.unit_strength_hz(SAMPLERATE)
