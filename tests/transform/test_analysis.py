"""The live form's analysis: the core's and the oracle's, held against each other."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
import soundfile
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.lib.stride_tricks import sliding_window_view

from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.design.analysis import AnalysisDesign
from audioflinger_hook.transform.input_stage import BandPass, design_band_pass
from audioflinger_hook.transform.principal import PrincipalFinder, Principals, Spectrum, magnitude
from tests.oracle.analysis import all_principal, strongest_principal
from tests.support.kernel_probes import probes
from tests.support.recordings import require_recordings
from tests.support.signals import (
    chirp,
    five_tones,
    identical,
    joined,
    low_noise,
    one_sample,
    silence,
    square,
    tone,
    white_noise,
)

if probes is None:
    pytest.skip("no C compiler", allow_module_level=True)

PARAMETERS = TransformParameters()
SAMPLERATES = (1_000, 8_000, 44_100, 48_000, 192_000)
SMALL = Spectrum.of(TransformParameters(window_s=0.01), 2_000)
"""Bins of 50 Hz, 21 of them: a spectrum that can be written down."""


class OfTheCore:
    """The core's analysis, by a design."""

    def __init__(self, design):
        self.design = design

    def all_principal(self, spectra):
        return self._find(spectra, 0.0, max(1, self.design.bins // 2))

    def strongest(self, spectra):
        return self._find(spectra, self.design.side_lobe, self.design.partials_max)

    def _find(self, spectra, side_lobe, most):
        room, s = len(spectra) * most, self.design
        row, found = np.empty(room, dtype=np.intp), np.empty((4, room))
        count = probes.find(
            spectra,
            s.image_table,
            s.image_turn,
            s.image_first,
            s.bins,
            s.first_bin,
            s.last_bin,
            s.bin_hz,
            s.threshold_hz,
            s.peak_span_min,
            s.weakest_image,
            side_lobe,
            most,
            row,
            found,
        )
        return Principals(row[:count], *found[:, :count])


class OfTheOracle:
    """The oracle's."""

    def __init__(self, design):
        self.design = design

    def all_principal(self, spectra):
        return all_principal(self.design, spectra[:, : self.design.bins])

    def strongest(self, spectra):
        return strongest_principal(self.design, spectra[:, : self.design.bins])


def both(parameters, spectrum, bins=None, **changes):
    """Return the core's analysis and the oracle's, of so many bins or of all."""
    design = AnalysisDesign.of(parameters, spectrum, bins or spectrum.bins)
    design = replace(design, **changes)
    return OfTheCore(design), OfTheOracle(design)


def windows_of(sound, samplerate):
    """Return overlapping band-passed windows of a sound."""
    frames = PARAMETERS.window_frames(samplerate)
    filtered = BandPass(*design_band_pass(PARAMETERS, samplerate)).process(sound)
    return sliding_window_view(filtered, frames)[:: max(1, frames // 4)]


def spectra_of(sound, samplerate):
    return Spectrum.of(PARAMETERS, samplerate).transform(windows_of(sound, samplerate))


def chord(samplerate):
    """Return ten partials of a chord, some of them closer than a window can part."""
    partials = (110, 220, 330, 441, 450, 663, 771, 884, 992, 1_100)
    return sum(tone(hz, 0.5, samplerate, 0.09) for hz in partials)


SOUNDS = {
    "white noise": lambda rate: white_noise(0.6, rate),
    "faint noise": lambda rate: white_noise(0.4, rate, 0.02),
    "low noise": lambda rate: low_noise(0.4, rate, 0.05) if rate > 1_000 else silence(0.1, rate),
    "tone": lambda rate: tone(97, 0.3, rate, 1.0),
    "two tones": lambda rate: tone(61, 0.3, rate, 0.5) + tone(0.31 * rate, 0.3, rate, 0.4),
    "chord": chord,
    "five tones": lambda rate: five_tones(0.3, rate),
    "chirp": lambda rate: chirp(60, 0.23 * rate, 0.4, rate),
    "square": lambda rate: square(90, 0.2, rate),
    "one sample": lambda rate: one_sample(0.2, rate, 0.1),
    "silence": lambda rate: silence(0.2, rate),
}


def fields(found):
    return (found.audio_hz, found.amplitude, found.bandwidth_hz, found.r)


def assert_the_same(ours, theirs):
    np.testing.assert_array_equal(ours.row, theirs.row)
    for name, one, other in zip(("Hz", "A", "df", "r"), fields(ours), fields(theirs), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-300, err_msg=name)


def as_spectra(amplitudes):
    """Return spectra of exactly these amplitudes, each a quarter turn on from the last."""
    amplitudes = np.asarray(amplitudes, dtype=np.float64)
    return amplitudes * np.resize([1, 1j, -1, -1j], amplitudes.shape[-1])


# --- what it finds ------------------------------------------------------------------------------


@pytest.mark.parametrize("samplerate", SAMPLERATES)
@pytest.mark.parametrize("kind", SOUNDS)
def test_it_finds_what_the_oracle_finds(kind, samplerate):
    spectrum = Spectrum.of(PARAMETERS, samplerate)
    spectra = spectra_of(SOUNDS[kind](samplerate), samplerate)
    for bins in (spectrum.bins, min(spectrum.bins, int(13_000 / spectrum.bin_hz))):
        ours, theirs = both(PARAMETERS, spectrum, bins)
        assert_the_same(ours.all_principal(spectra), theirs.all_principal(spectra))
        assert_the_same(ours.strongest(spectra), theirs.strongest(spectra))
    if kind in ("white noise", "tone", "two tones", "chord", "chirp", "square"):
        assert len(ours.all_principal(spectra)) >= len(spectra)


@pytest.mark.exhaustive
def test_it_finds_what_the_oracle_finds_in_recordings():
    found = 0
    for path in require_recordings():
        sound, samplerate = soundfile.read(path, always_2d=True)
        ours, theirs = both(PARAMETERS, Spectrum.of(PARAMETERS, samplerate))
        spectra = spectra_of(sound.mean(axis=1)[: 3 * samplerate], samplerate)
        assert_the_same(ours.all_principal(spectra), theirs.all_principal(spectra))
        assert_the_same(ours.strongest(spectra), theirs.strongest(spectra))
        found += len(ours.strongest(spectra))
    assert found > 1_000


@pytest.mark.parametrize(
    "changes",
    [
        {"partials_max": 1},
        {"partials_max": 64},
        {"threshold_hz": 0.001},
        {"threshold_hz": 3.0},
        {"window_s": 0.01},
        {"window_s": 0.2},
        {"band_low_hz": 1_000.0, "band_high_hz": 2_000.0},
        {"band_high_hz": 20_000.0},
    ],
)
def test_it_finds_what_the_oracle_finds_for_other_parameters(changes):
    parameters = TransformParameters(**changes)
    spectrum = Spectrum.of(parameters, 44_100)
    ours, theirs = both(parameters, spectrum)
    sound = joined(*(SOUNDS[kind](44_100) for kind in ("white noise", "chord", "low noise")))
    windows = sliding_window_view(sound, spectrum.window_frames)[::1_500]
    spectra = spectrum.transform(windows)
    assert len(ours.all_principal(spectra)) > len(spectra)
    assert_the_same(ours.all_principal(spectra), theirs.all_principal(spectra))
    assert_the_same(ours.strongest(spectra), theirs.strongest(spectra))


@pytest.mark.parametrize("weakest_image", [0.0, 0.05, np.inf])
@pytest.mark.parametrize("side_lobe", [0.0, 0.3])
def test_each_rule_is_the_same_rule_however_strict(weakest_image, side_lobe):
    changes = {"weakest_image": weakest_image, "side_lobe": side_lobe}
    ours, theirs = both(PARAMETERS, Spectrum.of(PARAMETERS, 48_000), **changes)
    spectra = spectra_of(low_noise(0.5, 48_000, 0.1) + tone(4_000, 0.5, 48_000), 48_000)
    assert_the_same(ours.strongest(spectra), theirs.strongest(spectra))


def test_without_any_rule_of_the_live_form_it_finds_the_reference_forms_peaks():
    # Frequencies and amplitudes; bandwidths lie on bells instead of lines.
    spectrum = Spectrum.of(PARAMETERS, 48_000)
    ours, _ = both(PARAMETERS, spectrum, weakest_image=np.inf)
    spectra = spectra_of(chord(48_000), 48_000)
    finder = PrincipalFinder(PARAMETERS, spectrum.bin_hz, spectrum.bins)
    found, reference = ours.all_principal(spectra), finder.all_principal(magnitude(spectra))
    np.testing.assert_array_equal(found.row, reference.row)
    np.testing.assert_allclose(found.audio_hz, reference.audio_hz, rtol=1e-12)
    np.testing.assert_allclose(found.amplitude, reference.amplitude, rtol=1e-12)


PLATEAUS = {
    "flat": [1.0] * 21,
    "zeros": [0.0] * 21,
    "rising": list(range(21)),
    "falling": list(range(21, 0, -1)),
    "a plateau": [0, 1, 2, 2, 2, 1] + [0] * 15,
    "plateaus on both sides": [0, 1, 1, 2, 1, 1, 0.5, 0.5] + [0] * 13,
    "a shoulder": [0, 1, 1.9, 2, 1.9, 1.9, 1.9, 1.8, 3, 0] + [0] * 11,
    "zeros between": [0, 2, 0] * 7,
    "never at half power": [1.0, 1.1] * 10 + [1.0],
    "every other bin": [0.0, 1.0] * 10 + [0.0],
    "equal peaks": [0, 1, 0, 0, 1, 0, 0, 1, 0] + [0] * 12,
    "a peak on the first and last bin": [3, 2, 1, 0, 1, 2, 3, 2, 1, 0] + [0] * 9 + [1, 3],
    "nearly flat": [1.0, np.nextafter(1.0, 2.0), 1.0] * 7,
}


@pytest.mark.parametrize("kind", PLATEAUS)
@pytest.mark.parametrize("images", [False, True])
def test_plateaus_zeros_and_ties_are_the_oracles(kind, images):
    parameters = TransformParameters(window_s=0.01, vibration_top_hz=220.0, partials_max=2)
    ours, theirs = both(parameters, SMALL, weakest_image=0.1 if images else np.inf)
    spectra = as_spectra([PLATEAUS[kind]])
    assert spectra.shape == (1, SMALL.bins)
    assert_the_same(ours.all_principal(spectra), theirs.all_principal(spectra))
    assert_the_same(ours.strongest(spectra), theirs.strongest(spectra))


@pytest.mark.exhaustive
@given(
    amplitudes=st.lists(
        st.lists(st.sampled_from([0.0, 0.5, 0.7, 0.71, 1.0, 2.0, 3.0]), min_size=21, max_size=21),
        min_size=1,
        max_size=4,
    ),
    most=st.integers(1, 5),
)
@settings(max_examples=300)
def test_any_small_spectrum_is_the_oracles(amplitudes, most):
    # Few levels make many plateaus and many peaks with the same r, or the same but for rounding.
    parameters = TransformParameters(window_s=0.01, partials_max=most, threshold_hz=1.0)
    ours, theirs = both(parameters, SMALL, weakest_image=np.inf)
    spectra = as_spectra(amplitudes)
    assert_the_same(ours.all_principal(spectra), theirs.all_principal(spectra))
    assert_the_same(ours.strongest(spectra), theirs.strongest(spectra))


def test_of_equal_peaks_the_lower_ones_stay():
    parameters = TransformParameters(window_s=0.01, partials_max=2)
    ours, _ = both(parameters, SMALL, weakest_image=np.inf)
    # Real and exact, so that all three have the same r.
    spectra = np.array([PLATEAUS["equal peaks"]], dtype=np.complex128)
    assert len(set(ours.all_principal(spectra).r)) == 1
    np.testing.assert_array_equal(ours.strongest(spectra).audio_hz, [50.0, 200.0])


# --- each row by itself -------------------------------------------------------------------------


def test_a_rows_result_does_not_depend_on_its_company_or_on_what_came_before():
    ours, _ = both(PARAMETERS, Spectrum.of(PARAMETERS, 48_000))
    spectra = spectra_of(
        joined(*(SOUNDS[kind](48_000) for kind in SOUNDS)), 48_000
    )  # every kind, and what lies between them
    together = ours.strongest(spectra)
    for row in np.random.default_rng(0).permutation(len(spectra)):
        alone = ours.strongest(spectra[row : row + 1])
        mine = together.take(together.row == row)
        assert not alone.row.any()
        for one, other in zip(fields(alone), fields(mine), strict=True):
            assert identical(one, other)


def test_a_later_call_leaves_earlier_results_alone():
    ours, _ = both(PARAMETERS, Spectrum.of(PARAMETERS, 48_000))
    spectra = spectra_of(white_noise(0.3, 48_000), 48_000)
    first = ours.strongest(spectra)
    kept = [array.copy() for array in fields(first)]
    ours.strongest(spectra[::-1].copy())
    for one, other in zip(fields(first), kept, strict=True):
        assert identical(one, other)


def test_no_rows_hold_nothing():
    ours, _ = both(PARAMETERS, Spectrum.of(PARAMETERS, 48_000))
    assert len(ours.strongest(np.zeros((0, 2_251), dtype=np.complex128))) == 0


def test_a_copy_and_a_pickle_find_the_same():
    ours, _ = both(PARAMETERS, Spectrum.of(PARAMETERS, 44_100))
    spectra = spectra_of(chord(44_100), 44_100)
    for other in (copy.deepcopy(ours), pickle.loads(pickle.dumps(ours))):
        for one, two in zip(
            fields(ours.strongest(spectra)), fields(other.strongest(spectra)), strict=True
        ):
            assert identical(one, two)


# --- images -------------------------------------------------------------------------------------


@pytest.mark.parametrize("samplerate", [8_000, 44_100, 48_000])
def test_a_low_tone_is_found_at_the_same_frequency_in_any_phase(samplerate):
    # Cleared, what is left of the image's pull is what lines between the table's entries leave. A
    # wobble of 5e-4 Hz at 55 Hz, however slow, stands at -70 dB if it lasts 4 s.
    spectrum = Spectrum.of(PARAMETERS, samplerate)
    phases = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
    time = (np.arange(spectrum.window_frames) / samplerate)[None]
    for hz in (52.0, 55.5, 60.0, 83.25, 111.0, 138.75, 200.0, 215.0):
        spectra = spectrum.transform(0.3 * np.cos(2 * np.pi * hz * time + phases[:, None]))
        for form in both(PARAMETERS, spectrum):
            found = form.strongest(spectra)
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
    ours, _ = both(PARAMETERS, spectrum, **changes)
    spectra = spectra_of(white_noise(0.5, 8_000), 8_000)[:3].copy()
    expected = ours.strongest(spectra)
    parts = spectra[1].view(np.float64)
    places = {
        "everywhere": slice(None),
        "one bin": slice(100, 102),
        "every third bin": slice(6, None, 6),
        "imaginary": slice(1, None, 2),
    }
    parts[places[where]] = strange
    found = ours.strongest(spectra)
    for row in (0, 2):
        for one, other in zip(
            fields(found.take(found.row == row)),
            fields(expected.take(expected.row == row)),
            strict=True,
        ):
            assert identical(one, other)
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
    ours, _ = both(parameters, SMALL, peak_span_min=span, weakest_image=image)
    parts = scale * rng.standard_normal((3, 2 * SMALL.bins))
    strange = rng.random(parts.shape) < density
    parts[strange] = rng.choice(STRANGE, int(strange.sum()))
    found = ours.all_principal(parts.view(np.complex128))
    assert np.isfinite(fields(found)[:3]).all()
    assert len(ours.strongest(parts.view(np.complex128))) <= len(found)


# --- mistakes of a caller -----------------------------------------------------------------------


def good_call():
    """Return arguments that fit one another, in order and by name."""
    bins, rows, most = 21, 2, 5
    return {
        "spectra": np.zeros((rows, bins), dtype=np.complex128),
        "table": np.ones(64),
        "turn": np.ones((2, 12)),
        "first_sample": 1e-4,
        "bins": bins,
        "first": 1,
        "last": bins - 2,
        "bin_hz": 50.0,
        "threshold_hz": 0.3,
        "peak_span_min": 0.1,
        "weakest_image": 0.01,
        "side_lobe": 0.01,
        "most": most,
        "row": np.zeros(rows * most, dtype=np.intp),
        "found": np.zeros((4, rows * most)),
    }


MISTAKES = {
    "spectra of float64": ("spectra", np.zeros((2, 21)), TypeError),
    "spectra of complex64": ("spectra", np.zeros((2, 21), dtype=np.complex64), TypeError),
    "spectra of one row": ("spectra", np.zeros(21, dtype=np.complex128), ValueError),
    "strided spectra": ("spectra", np.zeros((2, 42), dtype=np.complex128)[:, ::2], ValueError),
    "narrow spectra": ("spectra", np.zeros((2, 20), dtype=np.complex128), ValueError),
    "spectra without columns": ("spectra", np.zeros((2, 0), dtype=np.complex128), ValueError),
    "more spectra than room": ("spectra", np.zeros((3, 21), dtype=np.complex128), ValueError),
    "spectra that are a list": ("spectra", [[0.0] * 21] * 2, TypeError),
    "spectra that are bytes": ("spectra", bytes(672), ValueError),
    "no spectra": ("spectra", None, TypeError),
    "an empty table": ("table", np.ones(0), ValueError),
    "a table of float32": ("table", np.ones(64, dtype=np.float32), TypeError),
    "a table of the other byte order": ("table", np.ones(64, dtype=">f8"), TypeError),
    "a turn of one row": ("turn", np.ones((1, 12)), ValueError),
    "a turn past the bins": ("turn", np.ones((2, 22)), ValueError),
    "no bins": ("bins", 0, ValueError),
    "bins under 0": ("bins", -1, ValueError),
    "bins past the spectra": ("bins", 22, ValueError),
    "bins past counting": ("bins", 2**80, OverflowError),
    "bins in halves": ("bins", 20.5, TypeError),
    "a threshold in words": ("threshold_hz", "loud", TypeError),
    "none at most": ("most", 0, ValueError),
    "under none at most": ("most", -(2**62), ValueError),
    "more than there is room for": ("most", 6, ValueError),
    "as many as can be, and no room": ("most", 2**62, ValueError),
    "one bin": ("bins", 1, ValueError),
    "a first bin without one before it": ("first", 0, ValueError),
    "a last bin without one behind it": ("last", 20, ValueError),
    "a short row": ("row", np.zeros(9, dtype=np.intp), ValueError),
    "a row of int32": ("row", np.zeros(10, dtype=np.int32), TypeError),
    "a row of float64": ("row", np.zeros(10), TypeError),
    "too little to find into": ("found", np.zeros((4, 9)), ValueError),
    "five things to find": ("found", np.zeros((5, 10)), ValueError),
    "a flat list to find into": ("found", np.zeros(40), ValueError),
    "strided room": ("found", np.zeros((4, 20))[:, ::2], ValueError),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_callers_mistake_is_refused(mistake):
    name, value, error = MISTAKES[mistake]
    arguments = good_call()
    assert probes.find(*arguments.values()) == 0
    arguments[name] = value
    with pytest.raises(error):
        probes.find(*arguments.values())


@pytest.mark.parametrize("name", ["row", "found"])
def test_room_for_results_must_be_writable(name):
    arguments = good_call()
    arguments[name].flags.writeable = False
    with pytest.raises(ValueError, match="read-only"):
        probes.find(*arguments.values())


@pytest.mark.parametrize("count", [0, 1, 14, 16])
def test_another_number_of_arguments_is_refused(count):
    with pytest.raises(TypeError):
        probes.find(*[*good_call().values(), None][:count])


def test_read_only_spectra_are_read():
    ours, _ = both(PARAMETERS, Spectrum.of(PARAMETERS, 8_000))
    spectra = spectra_of(white_noise(0.2, 8_000), 8_000)
    expected = ours.strongest(spectra)
    spectra.flags.writeable = False
    assert identical(ours.strongest(spectra).r, expected.r)


def test_every_buffer_is_let_go_of_after_a_call_and_after_a_mistake():
    # A bytearray refuses to grow while anybody holds its buffer.
    memory = bytearray(8 * 64)
    arguments = good_call() | {"table": np.frombuffer(memory, dtype=np.float64)}
    probes.find(*arguments.values())
    with pytest.raises(ValueError, match="most"):
        probes.find(*(arguments | {"most": 0}).values())
    with pytest.raises(TypeError, match="row"):
        probes.find(*(arguments | {"row": np.zeros(10)}).values())
    del arguments
    memory.extend(b"0")
