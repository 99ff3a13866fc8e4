"""Benches on steady tones: what comes out, how pure it is, and whether the samplerate matters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform import FloatArray, TransformParameters
from audioflinger_hook.transform.mapping import vibration_hz
from audioflinger_hook.transform.reference import ReferenceTransform
from tools.bench.measures.vibration import SineFit, sine_fit
from tools.bench.report import Must, Row, Section
from tools.bench.sounds.signals import SAMPLERATE, tone
from tools.bench.workbench import LIVE, REFERENCE, Subject, Workbench

MID_HZ = (150.0, 11_000.0)
LOW_HZ = (55.0, 150.0)
AMPLITUDES = (0.02, 0.1, 0.3, 1.0)
REFERENCE_AMPLITUDE = 0.3
FREQUENCY_ERROR = Must("<=", 0.3)
LEVEL_ERROR = Must("<=", 0.5)
PURITY = Must("<=", -60.0)
LEADS = (Must("<=", 0.05), Must("<=", 0.2), Must("<=", -70.0))
"""Of frequency, level and purity, over both ranges."""

SAMPLERATES = (8_000, 11_025, 16_000, 22_050, 44_100, 48_000, 96_000, 192_000)
GAIN_HZ = (150.0, 3_000.0)
"""Up to what the lowest samplerate leaves of the band."""
GAIN_AMPLITUDE = 0.3
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
    """Frequency, level and purity of steady tones, mid and low range apart."""
    rows: list[Row] = []
    for (low_hz, high_hz), count, limits in (
        (MID_HZ, bench.effort.tones, (FREQUENCY_ERROR, LEVEL_ERROR, PURITY)),
        (LOW_HZ, bench.effort.low_tones, (None, None, None)),
    ):
        frequencies_hz = [float(f) for f in np.geomspace(low_hz, high_hz, count)]
        results = [_measure_tone(bench, f, a) for f in frequencies_hz for a in AMPLITUDES]
        span = f"{low_hz:g} to {high_hz:g} Hz"
        rows += _worst_rows(span, results, limits)
        reference_db = max(_reference_thdn_db(bench, f) for f in frequencies_hz)
        rows.append(Row(f"worst THD+N, {span}", reference_db, "dB", REFERENCE))
        impure = sum(not PURITY.met(result.thdn_db) for result in results)
        name = f"tones with THD+N over {PURITY.bound:g} dB, {span}"
        rows.append(Row(name, float(impure), f"of {len(results)}"))
    return Section(
        "Steady tones",
        "A steady tone should come out as one pure sinusoid at its place on the scale, as strong "
        f"as the reference form says. {bench.effort.tones} and {bench.effort.low_tones} "
        f"frequencies at amplitudes {', '.join(f'{a:g}' for a in AMPLITUDES)}, "
        f"{bench.effort.tone_s:g} s each; THD+N is all that the best-fitting sinusoid leaves in "
        "the middle half. The reference form (here at one amplitude) restarts its phases with "
        "every unit sequence, which is a buzz; at full scale its level is up to 0.2 dB lower where "
        "a tone's side lobes pass C_th and share P_k. No steady tone meets the limiter.",
        tuple(rows),
    )


def gain_over_samplerates(bench: Workbench) -> Section:
    """The level of tones at all usual samplerates against that at 48 kHz."""
    live = bench.subject(LIVE)
    frequencies_hz = [float(f) for f in np.geomspace(*GAIN_HZ, bench.effort.gain_tones)]
    rows = []
    for column in (LIVE, REFERENCE):
        levels_db = np.array(
            [
                [_level_db(live, column, frequency_hz, rate) for rate in SAMPLERATES]
                for frequency_hz in frequencies_hz
            ]
        )
        deviation_db = np.abs(levels_db - levels_db[:, [SAMPLERATES.index(SAMPLERATE)]])
        gain_db = levels_db.mean(axis=0)
        gain_deviation_db = np.abs(gain_db - gain_db[SAMPLERATES.index(SAMPLERATE)])
        at = int(gain_deviation_db.argmax())
        tone_at, rate_at = np.unravel_index(deviation_db.argmax(), deviation_db.shape)
        rows += [
            Row(
                "gain, largest deviation",
                float(gain_deviation_db[at]),
                "dB",
                column,
                note=f"{column}: at {SAMPLERATES[at]} Hz",
            ),
            Row(
                "one tone, largest deviation",
                float(deviation_db.max()),
                "dB",
                column,
                GAIN_SPREAD if column == LIVE else None,
                note=f"{column}: {frequencies_hz[tone_at]:.0f} Hz at {SAMPLERATES[rate_at]} Hz",
            ),
        ]
    return Section(
        "Gain at every samplerate",
        "The same sound has to be felt as strongly whatever rate it is played at: "
        f"{SAMPLERATES[0]} to {SAMPLERATES[-1]} Hz against {SAMPLERATE} Hz. The gain is the mean "
        f"over {bench.effort.gain_tones} tones of {GAIN_HZ[0]:g} to {GAIN_HZ[1]:g} Hz. In the "
        "reference form a single tone moves more, because its measured bandwidth depends on where "
        "it falls between two bins, and the bins of 44.1 kHz lie elsewhere.",
        tuple(rows),
    )


def _measure_tone(bench: Workbench, frequency_hz: float, amplitude: float) -> _ToneResult:
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
    return _fit_middle(
        bench.subject(REFERENCE).vibration(sound, SAMPLERATE), SAMPLERATE
    ).residual_db


def _fit_middle(vibration: FloatArray, samplerate: int) -> SineFit:
    quarter = vibration.size // 4
    return sine_fit(vibration[quarter : 3 * quarter], samplerate)


def reference_amplitude(sound: FloatArray, samplerate: int) -> float:
    """Return P_k r_k / (1.30 fs/N) of a tone by the reference form: the median over its units.

    The strongest partial of each unit counts; the first units, where filters settle, weigh
    little in a median.
    """
    parameters = TransformParameters()
    reference = ReferenceTransform(parameters, samplerate)
    units = reference.cut(sound)
    found = reference.analyse(units)
    edges = found.boundaries(len(units))
    strongest = [
        float((r * r).max() / r.sum()) if r.size else 0.0
        for r in (found.r[edges[unit] : edges[unit + 1]] for unit in range(len(units)))
    ]
    return float(np.median(strongest)) / parameters.unit_strength_hz(samplerate)


def _level_db(live: Subject, column: str, frequency_hz: float, samplerate: int) -> float:
    sound = tone(frequency_hz, GAIN_AMPLITUDE, GAIN_TONE_S, samplerate)
    if column == REFERENCE:
        level = reference_amplitude(sound, samplerate)
    else:
        level = _fit_middle(live.vibration(sound, samplerate), samplerate).amplitude
    return 20.0 * float(np.log10(level))


def _worst_rows(
    span: str, results: list[_ToneResult], limits: tuple[Must | None, ...]
) -> list[Row]:
    """Return the worst of each error with the tone where it lies."""
    rows = []
    for (what, unit, field), must, lead in zip(
        (
            ("frequency error", "Hz", "frequency_error_hz"),
            ("level error", "dB", "level_error_db"),
            ("THD+N", "dB", "thdn_db"),
        ),
        limits,
        LEADS,
        strict=True,
    ):
        worst = max(results, key=lambda result: getattr(result, field))
        name = f"worst {what}, {span}"
        value: float = getattr(worst, field)
        rows.append(Row(name, value, unit, LIVE, must, note=worst.label, lead=lead))
    return rows
