"""Section "Frequency error": error of a tone's frequency in noise, and its Cramer-Rao bound.

Each measured window contains one tone. The strongest principal frequency that a form of the
transform finds in the window counts as the frequency of the tone. A real-valued tone has the
amplitude a, and white noise has the standard deviation s. For N samples at the sample rate fs, the
bound is var(f) >= 24 s^2 fs^2 / (4 pi^2 a^2 N (N^2 - 1)) (Rife and Boorstyn, 1974).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform import FloatArray, TransformParameters
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.principal import PrincipalFinder, Principals, Spectrum, magnitude
from tools.bench.measures.windows import Found, WindowAnalysis
from tools.bench.report import Must, Row, Section, line
from tools.bench.workbench import LIVE, REFERENCE, Workbench

TITLE = "Frequency error"
SAMPLERATES = (8_000, 11_025, 16_000, 22_050, 44_100, 48_000, 96_000, 192_000)
RANGES_HZ = ((50.0, 150.0), (150.0, 600.0), (600.0, 12_000.0))
"""Below about 600 Hz, a tone's image at negative frequency causes more error than weak noise."""
HIGHEST_SHARE = 0.45  # highest tone as a share of the sample rate
LIMITED_SNRS_DB = (0.0, 10.0, 20.0)
TIMES_BOUND = Must("<=", 1.5)
AMPLITUDE = 0.05  # noise stays below C_th even at a signal-to-noise ratio of 0 dB
WINDOWS_AT_ONCE = 64

FORMS = (LIVE, REFERENCE)

Analysis = Callable[[FloatArray], Principals | Found]


def bound_hz(samplerate: int, frames: int, snr_db: float) -> float:
    """Return the Cramer-Rao bound of the standard deviation of a tone's frequency, in Hz.

    frames: number of samples.
    snr_db: signal-to-noise ratio a^2 / (2 s^2) in dB.
    """
    noise_over_tone = 0.5 * 10.0 ** (-snr_db / 10.0)  # s^2 / a^2
    cube = frames * (frames * frames - 1.0)
    return float(np.sqrt(24.0 * noise_over_tone / cube) * samplerate / (2.0 * np.pi))


@dataclass(frozen=True)
class _Grid:
    samplerate: int
    frames: int
    forms: dict[str, Analysis]

    @classmethod
    def at(cls, samplerate: int) -> _Grid:
        parameters = TransformParameters()
        spectrum = Spectrum.of(parameters, samplerate)
        finder = PrincipalFinder(parameters, spectrum.bin_hz, spectrum.bins)
        forms: dict[str, Analysis] = {
            LIVE: WindowAnalysis(LiveDesign.of(parameters, samplerate), every=True),
            REFERENCE: lambda windows: finder.all_principal(magnitude(spectrum.transform(windows))),
        }
        return cls(samplerate, spectrum.window_frames, forms)

    def tones(self, audio_hz: FloatArray, phase: FloatArray) -> FloatArray:
        turn = 2.0 * np.pi / self.samplerate * audio_hz
        waves: FloatArray = np.sin(turn[:, None] * np.arange(self.frames) + phase[:, None])
        return AMPLITUDE * waves


def _highest_hz(found: Principals | Found, rows: int) -> FloatArray:
    order = found.amplitude.argsort(kind="stable")
    highest = np.full(rows, np.nan)
    highest[found.row[order]] = found.audio_hz[order]  # the highest peak is assigned last
    return highest


def _rms(errors: FloatArray) -> float:
    """Return the root mean square of the errors; NaN if a tone was not found."""
    return float(np.sqrt(np.mean(errors**2)))


def _errors_hz(
    grid: _Grid, span_hz: tuple[float, float], snrs_db: Sequence[float | None], count: int
) -> dict[str, FloatArray]:
    """Return the frequency errors of each form in Hz, (signal-to-noise ratios, tones).

    span_hz: range of the frequencies of the tones.
    snrs_db: signal-to-noise ratios in dB; None for no noise.
    count: number of tones.
    """
    rng = np.random.default_rng((grid.samplerate, int(span_hz[0])))
    span_hz = (span_hz[0], min(span_hz[1], HIGHEST_SHARE * grid.samplerate))
    errors = {form: np.empty((len(snrs_db), count)) for form in grid.forms}
    for first in range(0, count, WINDOWS_AT_ONCE):
        batch = slice(first, min(first + WINDOWS_AT_ONCE, count))
        rows = batch.stop - first
        audio_hz = np.exp(rng.uniform(np.log(span_hz[0]), np.log(span_hz[1]), rows))
        tones = grid.tones(audio_hz, rng.uniform(0.0, 2.0 * np.pi, rows))
        for ratio, snr_db in enumerate(snrs_db):
            windows = tones
            if snr_db is not None:
                deviation = AMPLITUDE * np.sqrt(0.5 * 10.0 ** (-snr_db / 10.0))
                windows = tones + deviation * rng.standard_normal(tones.shape, np.float32)
            for form, analyse in grid.forms.items():
                errors[form][ratio, batch] = _highest_hz(analyse(windows), rows) - audio_hz
    return errors


def frequency_error(bench: Workbench) -> Section:
    """Measure the error of a tone's frequency in noise, relative to the Cramer-Rao bound."""
    count = bench.effort.noisy_tones
    grids = {samplerate: _Grid.at(samplerate) for samplerate in SAMPLERATES}
    rows: list[Row] = []
    for samplerate, grid in grids.items():
        rows += _at_samplerate(samplerate, grid, count)
    spread = 100.0 / np.sqrt(2.0 * count * len(LIMITED_SNRS_DB))
    limited = f"{LIMITED_SNRS_DB[0]:g} to {LIMITED_SNRS_DB[-1]:g} dB"
    return Section(
        TITLE,
        "The table shows the root mean square error of the identified frequency of a tone in "
        "white noise, divided by the Cramer-Rao bound. The frequencies of the tones are random, "
        "with equal density per octave. No unbiased method has an error below the Cramer-Rao "
        "bound. The columns *no noise* show the error without noise, which is the bias of the "
        "method.",
        tuple(rows),
        footnote=f"For each sample rate, frequency range and signal-to-noise ratio, {count} tones "
        f"are measured. The signal-to-noise ratios are {limited}. The standard deviation of a "
        f"value is {spread:.1f} % of the value. The limit applies to the live form from "
        f"{RANGES_HZ[1][0]:g} Hz up. The reference form has larger errors because of the mirror "
        "image of the tone at the negative frequency; the live form removes this image. No tone "
        f"has a frequency above {HIGHEST_SHARE:g} times the sample rate.",
    )


def _name(span_hz: tuple[float, float]) -> str:
    return f"{span_hz[0]:g} to {span_hz[1]:g} Hz"


def _at_samplerate(samplerate: int, grid: _Grid, count: int) -> list[Row]:
    rows: list[Row] = []
    bounds = np.array([[bound_hz(samplerate, grid.frames, snr)] for snr in LIMITED_SNRS_DB])
    for span_hz in RANGES_HZ:
        name = f"{samplerate} Hz, {_name(span_hz)}"
        by_form = _errors_hz(grid, span_hz, (*LIMITED_SNRS_DB, None), count)
        over = {form: _rms(by_form[form][:-1] / bounds) for form in FORMS}
        must = TIMES_BOUND if span_hz[0] >= RANGES_HZ[1][0] else None
        rows += line(name, dict(over), "times", must)
        noiseless = {f"{form}, no noise": _rms(by_form[form][-1]) for form in FORMS}
        rows += line(name, dict(noiseless), "Hz")
    return rows
