from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.lib.stride_tricks import sliding_window_view

from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.design.analysis import AnalysisDesign
from audioflinger_hook.transform.input_stage import BandPass, design_band_pass
from audioflinger_hook.transform.principal import PrincipalFinder, Principals, Spectrum, magnitude
from tests.oracle.analysis import all_principal, strongest_principal
from tests.support import signals
from tests.support.kernel_probes import probes
from tests.transform.test_kernel import SOUNDS

if probes is None:
    pytest.skip("no C compiler", allow_module_level=True)

PARAMETERS = TransformParameters()
SAMPLERATES = (1_000, 8_000, 44_100, 48_000, 192_000)
KINDS = (
    *("noise", "faint noise", "low noise", "tones", "two tones"),
    *("square", "sweep", "clicks", "DC"),
)
SMALL = Spectrum.of(TransformParameters(window_s=0.01), 2_000)
"""Bins of 50 Hz, 21 of them: a spectrum that can be written down."""


def by_core(s, spectra, side_lobe, most):
    """Return what the core finds with a design `s`, at most so many in each row."""
    room = len(spectra) * most
    row, found = np.empty(room, dtype=np.intp), np.empty((4, room))
    images = (s.image_table, s.image_turn, s.image_first)
    band = (s.bins, s.first_bin, s.last_bin, s.bin_hz)
    limits = (s.threshold_hz, s.peak_span_min, s.weakest_image, side_lobe, most)
    count = probes.find(spectra, *images, *band, *limits, row, found)
    return Principals(row[:count], *found[:, :count])


def everything(design, spectra):
    return by_core(design, spectra, 0.0, max(1, design.bins // 2))


def strongest(design, spectra):
    return by_core(design, spectra, design.side_lobe, design.partials_max)


def designed(spectrum, parameters=PARAMETERS, bins=None, **changes):
    return replace(AnalysisDesign.of(parameters, spectrum, bins or spectrum.bins), **changes)


def assert_agree(design, spectra):
    """Compare what core and oracle find; return all that the core does."""
    seen, found = spectra[:, : design.bins], everything(design, spectra)
    for ours, theirs in (
        (found, all_principal(design, seen)),
        (strongest(design, spectra), strongest_principal(design, seen)),
    ):
        np.testing.assert_array_equal(ours.row, theirs.row)
        for one, other in zip(fields(ours), fields(theirs), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-300)
    return found


def assert_identical(ours, theirs):
    for one, other in zip(fields(ours), fields(theirs), strict=True):
        assert signals.identical(one, other)


def spectra_of(sound, samplerate):
    """Return the spectra of overlapping band-passed windows of a sound."""
    frames = PARAMETERS.window_frames(samplerate)
    filtered = BandPass(*design_band_pass(PARAMETERS, samplerate)).process(sound)
    windows = sliding_window_view(filtered, frames)[:: max(1, frames // 4)]
    return Spectrum.of(PARAMETERS, samplerate).transform(windows)


def fields(found):
    return (found.audio_hz, found.amplitude, found.bandwidth_hz, found.r)


@pytest.mark.parametrize("samplerate", SAMPLERATES)
@pytest.mark.parametrize("kind", KINDS)
def test_it_finds_what_the_oracle_finds(kind, samplerate):
    spectrum = Spectrum.of(PARAMETERS, samplerate)
    spectra = spectra_of(SOUNDS[kind](samplerate), samplerate)
    for bins in (spectrum.bins, min(spectrum.bins, int(13_000 / spectrum.bin_hz))):
        found = assert_agree(designed(spectrum, bins=bins), spectra)
    if kind in ("noise", "two tones", "tones", "sweep", "square"):
        assert len(found) >= len(spectra)


@pytest.mark.parametrize(
    "changes",
    [
        *({"partials_max": 1}, {"partials_max": 64}, {"threshold_hz": 0.001}),
        *({"threshold_hz": 3.0}, {"window_s": 0.01}, {"window_s": 0.2}),
        *({"band_low_hz": 1_000.0, "band_high_hz": 2_000.0}, {"band_high_hz": 20_000.0}),
    ],
)
def test_it_finds_what_the_oracle_finds_for_other_parameters_and_rules(changes):
    parameters = TransformParameters(**changes)
    spectrum = Spectrum.of(parameters, 44_100)
    sound = signals.joined(*(SOUNDS[kind](44_100) for kind in ("noise", "tones", "low noise")))
    spectra = spectrum.transform(sliding_window_view(sound, spectrum.window_frames)[::1_500])
    assert len(assert_agree(designed(spectrum, parameters), spectra)) > len(spectra)
    for weakest_image, side_lobe in product((0.0, 0.05, np.inf), (0.0, 0.3)):
        rules = {"weakest_image": weakest_image, "side_lobe": side_lobe}
        assert_agree(designed(spectrum, parameters, **rules), spectra)


def test_without_any_rule_of_the_live_form_it_finds_the_reference_forms_peaks():
    # Frequencies and amplitudes; bandwidths lie on bells instead of lines.
    spectrum, spectra = Spectrum.of(PARAMETERS, 48_000), spectra_of(SOUNDS["tones"](48_000), 48_000)
    found = everything(designed(spectrum, weakest_image=np.inf), spectra)
    finder = PrincipalFinder(PARAMETERS, spectrum.bin_hz, spectrum.bins)
    reference = finder.all_principal(magnitude(spectra))
    np.testing.assert_array_equal(found.row, reference.row)
    np.testing.assert_allclose(found.audio_hz, reference.audio_hz, rtol=1e-12)
    np.testing.assert_allclose(found.amplitude, reference.amplitude, rtol=1e-12)


LEVELS = (0.0, 0.5, 0.7, 0.71, 1.0, np.nextafter(1.0, 2.0), 1.9, 2.0, 3.0)
"""Few levels make many plateaus and many peaks with the same r, or the same but for rounding."""


@given(
    amplitudes=st.lists(
        st.lists(st.sampled_from(LEVELS), min_size=21, max_size=21), min_size=1, max_size=4
    ),
    most=st.integers(1, 5),
    weakest_image=st.sampled_from([np.inf, 0.1]),
)
@example(amplitudes=[[1.0] * 21, [0.0] * 21], most=2, weakest_image=np.inf)
@example(amplitudes=[list(range(21)), list(range(21, 0, -1))], most=2, weakest_image=0.1)
@example(amplitudes=[[1.0, 1.1] * 10 + [1.0], [0.0, 1.0] * 10 + [0.0]], most=2, weakest_image=0.1)
@settings(max_examples=300)
def test_any_small_spectrum_is_the_oracles(amplitudes, most, weakest_image):
    parameters = TransformParameters(window_s=0.01, partials_max=most, threshold_hz=1.0)
    # each amplitude a quarter turn on from the last
    spectra = np.array(amplitudes) * np.resize([1, 1j, -1, -1j], len(amplitudes[0]))
    assert_agree(designed(SMALL, parameters, weakest_image=weakest_image), spectra)


def test_of_equal_peaks_the_lower_ones_stay():
    parameters = TransformParameters(window_s=0.01, partials_max=2)
    design = designed(SMALL, parameters, weakest_image=np.inf)
    # Real and exact, so that all three have the same r.
    spectra = np.array([[0, 1, 0] * 3 + [0] * 12], dtype=np.complex128)
    assert len(set(everything(design, spectra).r)) == 1
    np.testing.assert_array_equal(strongest(design, spectra).audio_hz, [50.0, 200.0])


def test_a_rows_result_does_not_depend_on_its_company_or_on_what_came_before():
    design = designed(Spectrum.of(PARAMETERS, 48_000))
    # Every kind, and what lies between them.
    spectra = spectra_of(signals.joined(*(SOUNDS[kind](48_000) for kind in KINDS)), 48_000)
    together = strongest(design, spectra)
    for row in np.random.default_rng(0).permutation(len(spectra)):
        alone = strongest(design, spectra[row : row + 1])
        assert not alone.row.any()
        assert_identical(alone, together.take(together.row == row))


@pytest.mark.parametrize("samplerate", [8_000, 44_100, 48_000])
def test_a_low_tone_is_found_at_the_same_frequency_in_any_phase(samplerate):
    # Cleared, what is left of the image's pull is what lines between the table's entries leave. A
    # wobble of 5e-4 Hz at 55 Hz, however slow, stands at -70 dB if it lasts 4 s.
    spectrum = Spectrum.of(PARAMETERS, samplerate)
    design, phases = designed(spectrum), np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
    time = (np.arange(spectrum.window_frames) / samplerate)[None]
    for hz in (52.0, 55.5, 60.0, 83.25, 111.0, 138.75, 200.0, 215.0):
        spectra = spectrum.transform(0.3 * np.cos(2 * np.pi * hz * time + phases[:, None]))
        for found in (strongest(design, spectra), strongest_principal(design, spectra)):
            assert len(found) == phases.size
            assert np.ptp(found.audio_hz) < 5e-4, hz


# --- numbers that no sound makes ----------------------------------------------------------------

STRANGE = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e155, 5e-324, 1e-308, 1e-160, 0.0, -0.0, 1.0)


@pytest.mark.parametrize("strange", STRANGE)
@pytest.mark.parametrize("where", ["everywhere", "one bin", "every third bin", "imaginary"])
@pytest.mark.parametrize("bound", [True, False])
def test_strange_numbers_end_in_numbers_and_stay_in_their_row(strange, where, bound):
    spectrum = Spectrum.of(PARAMETERS, 8_000)
    changes = {} if bound else {"peak_span_min": -1.0, "weakest_image": -1.0}
    design = designed(spectrum, **changes)
    spectra = spectra_of(signals.white_noise(0.5, 8_000), 8_000)[:3].copy()
    expected, parts = strongest(design, spectra), spectra[1].view(np.float64)
    places = {"everywhere": slice(None), "one bin": slice(100, 102)}
    places |= {"every third bin": slice(6, None, 6), "imaginary": slice(1, None, 2)}
    parts[places[where]] = strange
    found = strongest(design, spectra)
    for row in (0, 2):
        assert_identical(found.take(found.row == row), expected.take(expected.row == row))
    strangers = found.take(found.row == 1)
    assert np.isfinite(fields(strangers)[:3]).all()
    assert (strangers.r > PARAMETERS.threshold_hz).all()
    assert (np.diff(strangers.audio_hz) > 0).all()


@given(
    seed=st.integers(0, 2**32 - 1),
    density=st.sampled_from([0.01, 0.2, 1.0]),
    scale=st.sampled_from([1e-300, 1e-5, 1.0, 1e150]),
)
@settings(max_examples=200)
def test_no_mixture_of_strange_numbers_is_too_much(seed, density, scale):
    rng = np.random.default_rng(seed)
    span, image = rng.choice([-1.0, np.nan, 0.1], 2)
    parameters = TransformParameters(window_s=0.01, threshold_hz=0.001)
    design = designed(SMALL, parameters, peak_span_min=span, weakest_image=image)
    parts = scale * rng.standard_normal((3, 2 * SMALL.bins))
    strange = rng.random(parts.shape) < density
    parts[strange] = rng.choice(STRANGE, int(strange.sum()))
    found = everything(design, parts.view(np.complex128))
    assert np.isfinite(fields(found)[:3]).all()
    assert len(strongest(design, parts.view(np.complex128))) <= len(found)
