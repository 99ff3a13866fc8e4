"""Section on frequency error: a tone in noise, against the Cramer-Rao bound.

Only steps 4 and 5 of both forms run, on windows of one tone; the highest peak counts. The bound for
a real tone of amplitude a in white noise of standard deviation s, over N samples at fs, is
var(f) >= 24 s^2 fs^2 / (4 pi^2 a^2 N (N^2 - 1)) (Rife and Boorstyn, 1974).
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
"""Below about 600 Hz the image of a tone, at negative frequency, matters more than weak noise."""
HIGHEST_SHARE = 0.45
"""Highest tone as a share of the samplerate."""
LIMITED_SNRS_DB = (0.0, 10.0, 20.0)
TIMES_BOUND = Must("<=", 1.5)
AMPLITUDE = 0.05
"""Of the tone: at 0 dB the noise stays under C_th, so only the tone is refined."""
WINDOWS_AT_ONCE = 64

FORMS = (LIVE, REFERENCE)

Analysis = Callable[[FloatArray], Principals | Found]


def bound_hz(samplerate: int, frames: int, snr_db: float) -> float:
    """Return the least standard deviation of a frequency, in Hz; snr_db: a^2 / (2 s^2)."""
    noise_over_tone = 0.5 * 10.0 ** (-snr_db / 10.0)  # s^2 / a^2
    cube = frames * (frames * frames - 1.0)
    return float(np.sqrt(24.0 * noise_over_tone / cube) * samplerate / (2.0 * np.pi))


@dataclass(frozen=True)
class _Grid:
    """Both forms' analysis at one samplerate, and the frames of its windows."""

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
        """Return a window of each tone, (tones, frames); phase in radians."""
        turn = 2.0 * np.pi / self.samplerate * audio_hz
        waves: FloatArray = np.sin(turn[:, None] * np.arange(self.frames) + phase[:, None])
        return AMPLITUDE * waves


def _highest_hz(found: Principals | Found, rows: int) -> FloatArray:
    """Return the frequency of the highest peak of each row, NaN where there is none."""
    order = found.amplitude.argsort(kind="stable")
    highest = np.full(rows, np.nan)
    highest[found.row[order]] = found.audio_hz[order]  # of several the last one stays
    return highest


def _rms(errors: FloatArray) -> float:
    """Return the root of the mean square; NaN if a single tone was not found."""
    return float(np.sqrt(np.mean(errors**2)))


def _errors_hz(
    grid: _Grid, span_hz: tuple[float, float], snrs_db: Sequence[float | None], count: int
) -> dict[str, FloatArray]:
    """Return each form's errors in Hz, (ratios, tones): the same tones, fresh noise for each ratio.

    snrs_db: of signal to noise, None for no noise.
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
    """The error of a tone's frequency in noise over the bound."""
    count = bench.effort.noisy_tones
    grids = {samplerate: _Grid.at(samplerate) for samplerate in SAMPLERATES}
    rows: list[Row] = []
    for samplerate, grid in grids.items():
        rows += _at_samplerate(samplerate, grid, count)
    spread = 100.0 / np.sqrt(2.0 * count * len(LIMITED_SNRS_DB))
    limited = f"{LIMITED_SNRS_DB[0]:g} to {LIMITED_SNRS_DB[-1]:g} dB"
    return Section(
        TITLE,
        "Root mean square error of the frequency of a tone in white noise, over tones that are "
        "evenly spread by octave, in multiples of the Cramer-Rao bound. No unbiased method is "
        "better than the bound. With little noise the bias of the method remains.",
        tuple(rows),
        footnote=f"{count} tones for each samplerate, range and signal-to-noise ratio; a value "
        f"over {limited} is uncertain by {spread:.1f} %. The limit applies to the live form from "
        f"{RANGES_HZ[1][0]:g} Hz up, at {limited}. The reference form's larger error is the pull "
        "of the tone's image, which the live form removes. Tones go up to "
        f"{HIGHEST_SHARE:g} of the samplerate.",
    )


def _name(span_hz: tuple[float, float]) -> str:
    return f"{span_hz[0]:g} to {span_hz[1]:g} Hz"


def _at_samplerate(samplerate: int, grid: _Grid, count: int) -> list[Row]:
    """Return the rows of one samplerate: over the limited ratios, and without noise."""
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
