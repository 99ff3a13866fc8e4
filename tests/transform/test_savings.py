"""The named savings and corrections: what each may change, which for most of them is nothing.

Each is switched off or undone, and the result compared with the transform as it is.
"""

from dataclasses import replace

import numpy as np
import pytest
import soundfile
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import butter, sosfilt

from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform import reference as reference_form
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.design.synthesis import LiveGrid
from audioflinger_hook.transform.haptic import CoreStream
from audioflinger_hook.transform.input_stage import (
    BandPass,
    design_band_pass,
    replace_unusable,
)
from audioflinger_hook.transform.mapping import vibration_hz
from audioflinger_hook.transform.principal import PrincipalFinder, Spectrum, magnitude, parabola
from audioflinger_hook.transform.reference import ReferenceTransform
from tests.oracle import settings_of, vibrate
from tests.oracle.analysis import all_principal, strongest_principal
from tests.oracle.loudness import at_hz
from tests.support.recordings import require_recordings
from tests.support.signals import (
    best_sinusoid,
    burst,
    chirp,
    columns,
    envelope,
    five_tones,
    identical,
    joined,
    low_noise,
    one_sample,
    played,
    silence,
    square,
    thinned,
    tone,
    white_noise,
)
from tools.bench.sections.savings import FAINT, SAVINGS, Saving

PARAMETERS = TransformParameters()
HOP_FRAMES = LiveGrid.at(PARAMETERS, 48_000).hop_frames


def changed(design, section, **values):
    """Return a design with other values in one section."""
    return replace(design, **{section: replace(getattr(design, section), **values)})


def clear_no_image(design):
    """Let every peak keep its image: none is above this amplitude."""
    return changed(design, "analysis", weakest_image=np.inf)


def leave_out_no_side_lobe(design):
    """Keep peaks however far they are under the highest."""
    return changed(design, "analysis", side_lobe=0.0)


def vibration_of(design, sound):
    """Return all vibration of a sound by a design."""
    stream = CoreStream(design, 1, False)
    return np.concatenate((stream.process(sound[:, None]), stream.finish()))[:, 0]


def spectra_of(design, windows):
    """Return the spectra that the analysis looks at, of band-passed windows."""
    analysis = design.analysis
    spectrum = Spectrum(design.samplerate, analysis.window, analysis.fft_length)
    return spectrum.transform(windows)[:, : analysis.bins]


def without_silence_skip(sound, samplerate):
    """Return what the live form plays where every hop is analysed, however quiet."""
    design = LiveDesign.of(PARAMETERS, samplerate)
    return vibration_of(changed(design, "input", silence=0.0), sound)


def with_silence_skip(sound, samplerate):
    return vibration_of(LiveDesign.of(PARAMETERS, samplerate), sound)


@pytest.mark.sweep
@pytest.mark.parametrize("saving", SAVINGS, ids=lambda saving: saving.name)
def test_no_saving_changes_more_than_it_states(saving):
    clicks = np.zeros(24_000)
    clicks[::1_200] = 1.0
    sounds = [
        joined(clicks, silence(0.6, 48_000), white_noise(0.5, 48_000)),
        low_noise(0.5, 48_000, 0.02),
        *(
            soundfile.read(path)[0]
            for path in require_recordings()
            if path.stem in ("Side_Left", "Rear_Center")
        ),
    ]
    usual = LiveDesign.of(PARAMETERS, 48_000)
    for sound in sounds:
        change = vibration_of(saving.switch_off(usual), sound + FAINT)
        change -= vibration_of(usual, sound + FAINT)
        assert np.abs(change).max() <= saving.bound


def kept_alike(sound, saving):
    """Return the largest change of a partial's amplitude in hops that keep the same peaks.

    Then the number of hops that keep others, and of all hops.
    """
    ours = LiveDesign.of(PARAMETERS, 48_000)
    theirs = saving.switch_off(ours)
    reach_hz = ours.analysis.bin_hz / 2.0
    change, others = 0.0, 0
    hops = list(zip(windows_of(ours, sound), windows_of(theirs, sound), strict=True))
    for (found, amplitude), (their, their_amplitude) in hops:
        if (
            len(found) != len(their)
            or (np.abs(found.audio_hz - their.audio_hz) > reach_hz).any()
            or (np.abs(found.bandwidth_hz / their.bandwidth_hz - 1.0) > 0.1).any()
        ):
            others += 1
        else:
            change = max(change, np.abs(amplitude - their_amplitude).max(initial=0.0))
    return change, others, len(hops)


def windows_of(design, sound):
    """Yield what each hop's window holds, and its amplitudes by the level law."""
    grid = design.grid
    filtered = BandPass(design.input.band_b, design.input.band_a).process(sound)
    windows = sliding_window_view(filtered, grid.window_frames)[:: grid.hop_frames]
    found = strongest_principal(design.analysis, spectra_of(design, windows))
    for row in range(len(windows)):
        mine = found.take(found.row == row)
        yield mine, design.mapping.amplitudes(mine.amplitude, mine.r)


def test_images_of_high_peaks_change_next_to_nothing_where_they_decide_nothing():
    (saving,) = (saving for saving in SAVINGS if "high peaks" in saving.name)
    change, others, hops = kept_alike(white_noise(4.0, 48_000), saving)
    assert hops > 200
    assert 0.0 < change <= 0.001
    # Which of two peaks that tie for the last place is kept: 1 to 9 of 553 hops hold such a tie.
    assert others <= hops / 40


def test_what_keeps_other_peaks_is_counted_and_not_taken_for_a_change_of_one():
    def keep_one(design):
        return changed(design, "analysis", partials_max=1)

    change, others, hops = kept_alike(white_noise(0.5, 48_000), Saving("one peak", keep_one))
    assert (change, others) == (0.0, hops)


# --- silence ------------------------------------------------------------------------------------


@pytest.mark.parametrize("samplerate", [1_000, 8_000, 44_100, 48_000])
@pytest.mark.parametrize("factor", [0.3, 0.9, 1.0, 1.1, 3.0, 30.0])
def test_leaving_out_quiet_hops_changes_no_byte_around_the_threshold(samplerate, factor):
    threshold = factor * PARAMETERS.threshold_hz / samplerate
    sound = joined(
        white_noise(0.3, samplerate, threshold),
        square(90, 0.2, samplerate, threshold),
        silence(0.6, samplerate),
        burst(200, 0.02, 0.35, samplerate, 0.5),
        white_noise(0.2, samplerate, threshold, seed=1),
        one_sample(0.2, samplerate, 0.1, threshold),
        low_noise(0.2, samplerate, threshold) if samplerate > 1_000 else silence(0.1, samplerate),
        one_sample(0.2, samplerate, 0.1, 1.0),
    )
    assert identical(with_silence_skip(sound, samplerate), without_silence_skip(sound, samplerate))


@pytest.mark.sweep
def test_leaving_out_quiet_hops_changes_no_byte_of_a_recording():
    for path in require_recordings()[::4]:
        sound, samplerate = soundfile.read(path, always_2d=True)
        # Quiet enough that its pauses fall under the threshold.
        quiet = 0.05 * sound.mean(axis=1)
        for channel in (quiet, 20 * quiet):
            assert identical(
                with_silence_skip(channel, samplerate),
                without_silence_skip(channel, samplerate),
            ), path.name


@given(
    seed=st.integers(0, 2**32 - 1),
    kind=st.sampled_from(["noise", "signs", "one sample", "two samples", "chirp", "step"]),
    window_s=st.sampled_from([0.01, 0.04643, 0.2]),
    samplerate=st.sampled_from([1_000, 8_000, 48_000]),
)
@settings(max_examples=60)
def test_nothing_under_the_silence_threshold_can_be_principal(seed, kind, window_s, samplerate):
    parameters = TransformParameters(window_s=window_s, vibration_top_hz=220.0)
    design = LiveDesign.of(parameters, samplerate)
    frames = parameters.window_frames(samplerate)
    rng = np.random.default_rng(seed)
    window = {
        "noise": lambda: rng.uniform(-1, 1, frames),
        "signs": lambda: rng.choice([-1.0, 1.0], frames),
        "one sample": lambda: np.eye(1, frames, int(rng.integers(frames)))[0],
        "two samples": lambda: np.eye(2, frames, int(rng.integers(frames // 2))).sum(axis=0),
        "chirp": lambda: np.cos(np.pi * np.arange(frames) ** 2 / (2 * frames)),
        "step": lambda: np.sign(np.arange(frames) - rng.integers(frames) + 0.5),
    }[kind]()
    spectra = spectra_of(design, design.input.silence * window[None, :])
    assert len(all_principal(design.analysis, spectra)) == 0


def test_cutting_the_ringing_off_changes_less_than_1e_8():
    # The low-pass rings longest at its edge, to which the top of the band is mapped.
    # The second tone begins with a hop of its own accord: where it wakes what sleeps, one does.
    pause = (100 * HOP_FRAMES - 14_400) / 48_000
    sound = joined(tone(11_900, 0.3, 48_000), silence(pause, 48_000), tone(60, 0.2, 48_000))
    design = LiveDesign.of(PARAMETERS, 48_000)
    longer = changed(design, "synthesis", ring_hops=5 * design.synthesis.ring_hops)
    cut = vibration_of(design, sound)
    uncut = vibration_of(longer, sound)
    # -160 dB; the last step of 24-bit sound is at -138 dB.
    assert np.abs(cut - uncut).max() < 1e-8


# --- batches and views --------------------------------------------------------------------------


@pytest.mark.sweep
@pytest.mark.parametrize("at_once", [1, 2, 5, 1_000])
def test_how_many_units_are_analysed_at_once_changes_no_byte(monkeypatch, at_once):
    sound = joined(
        low_noise(0.5, 48_000, 0.04),
        silence(0.6, 48_000),
        five_tones(0.3, 48_000),
        white_noise(0.3, 48_000),
    )
    usual = played(sound, 48_000, form="reference")
    monkeypatch.setattr(reference_form, "UNITS_AT_ONCE", at_once)
    assert identical(played(sound, 48_000, form="reference"), usual)


def test_sound_without_damage_is_passed_on_without_a_copy():
    sound = columns(white_noise(0.1, 48_000), tone(300, 0.1, 48_000)).astype(np.float32)
    usable, replaced = replace_unusable(sound)
    assert usable is sound
    assert replaced == 0


# --- arithmetic ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("samplerate", "rounding"),
    # The poles of a 50 Hz high-pass crowd at 1 the closer, the higher the samplerate is.
    [(1_000, 1e-10), (8_000, 1e-10), (48_000, 1e-10), (96_000, 1e-10), (192_000, 1e-8),
     (768_000, 1e-6)],
)  # fmt: skip
def test_one_recursion_rounds_almost_as_little_as_second_order_sections(samplerate, rounding):
    sound = joined(
        white_noise(0.2, samplerate), square(50, 0.5, samplerate), tone(60, 0.3, samplerate)
    )
    band = 50.0 if samplerate <= 24_000 else (50.0, 12_000.0)
    kind = "highpass" if samplerate <= 24_000 else "bandpass"
    expected = sosfilt(butter(2, band, kind, fs=samplerate, output="sos"), sound)
    # A tenth of what two implementations of the reference form owe each other, or far less.
    filtered = BandPass(*design_band_pass(PARAMETERS, samplerate)).process(sound)
    assert np.abs(filtered - expected).max() < rounding


def test_the_guard_against_denormal_numbers_is_not_felt():
    sound = joined(silence(0.2, 48_000), white_noise(0.5, 48_000), tone(300, 0.3, 48_000, 0.02))
    design = LiveDesign.of(PARAMETERS, 48_000)
    unguarded = changed(design, "input", denormal_guard=0.0)
    change = vibration_of(unguarded, sound) - vibration_of(design, sound)
    assert np.abs(change).max() < 1e-12
    reference, plain = (ReferenceTransform(PARAMETERS, 48_000) for _ in range(2))
    plain._bandpass = BandPass(*design_band_pass(PARAMETERS, 48_000), 0.0)
    assert np.abs(plain.process(sound) - reference.process(sound)).max() < 1e-12


def test_magnitudes_without_an_overflow_guard_are_those_with_one():
    spectra = Spectrum.of(PARAMETERS, 48_000).transform(
        np.stack([white_noise(0.04643, 48_000, level)[:2_229] for level in (1e-6, 1.0, 1e3)])
    )
    # Two roundings of a square and one of a root: 2 units in the last place.
    np.testing.assert_allclose(magnitude(spectra), np.abs(spectra), rtol=4e-16)


@pytest.mark.parametrize("samplerate", [1_000, 8_000, 44_100, 48_000, 192_000])
def test_the_low_passs_ripple_is_undone_for_steady_vibration(samplerate):
    s = settings_of(LiveDesign.of(PARAMETERS, samplerate))
    hops = round(0.6 * samplerate / s.hop_frames)
    for hz in (21.54, 60.0, 150.0, 200.0, 219.9):
        level = 0.5 * at_hz(s, s.gain_table, hz)
        glides = [
            (hop * s.ticks, 0, hz, hz, level, level, hop * s.hop_s * hz) for hop in range(hops)
        ]
        vibration, _, _ = vibrate(s, glides, [], [1.0] * hops * s.ticks)
        _, felt, residual_db = best_sinusoid(
            *thinned(vibration[vibration.size // 2 :], samplerate), hz
        )
        # A table of 0.25 Hz: between its entries the gain is interpolated.
        assert abs(20 * np.log10(2.0 * felt)) < 0.02
        # The images of the interpolation, under -80 dB at any rate.
        assert residual_db < -80.0


# --- candidates ---------------------------------------------------------------------------------


def amplitude_spectra(samplerate):
    """Return amplitude spectra of many kinds of window, (rows, bins)."""
    frames = PARAMETERS.window_frames(samplerate)
    sound = joined(
        white_noise(0.5, samplerate),
        white_noise(0.3, samplerate, 0.02),
        low_noise(0.4, samplerate, 0.05),
        five_tones(0.3, samplerate),
        tone(997, 0.2, samplerate, 1.0),
        chirp(60, 11_000, 0.4, samplerate),
        one_sample(0.2, samplerate, 0.1),
        square(110, 0.2, samplerate),
        silence(0.1, samplerate),
    )
    filtered = BandPass(*design_band_pass(PARAMETERS, samplerate)).process(sound)
    windows = sliding_window_view(filtered, frames)[:: frames // 4]
    return magnitude(Spectrum.of(PARAMETERS, samplerate).transform(windows))


def all_fields(found):
    return (found.row, found.audio_hz, found.amplitude, found.bandwidth_hz, found.r)


@pytest.mark.parametrize("samplerate", [8_000, 44_100, 48_000])
@pytest.mark.parametrize("threshold_hz", [0.001, 0.3, 10.0])
def test_the_bound_from_valley_to_valley_leaves_out_nothing_that_is_principal(
    samplerate, threshold_hz
):
    parameters = TransformParameters(threshold_hz=threshold_hz)
    spectrum = Spectrum.of(parameters, samplerate)
    amplitude = amplitude_spectra(samplerate)
    bounded, unbounded = with_and_without_the_bound(parameters, spectrum, amplitude)
    assert len(bounded) > 10
    for ours, theirs in zip(all_fields(bounded), all_fields(unbounded), strict=True):
        assert identical(ours, theirs)


def with_and_without_the_bound(parameters, spectrum, amplitude):
    """Return what the reference form finds in amplitudes with the bound and without it."""
    bins = amplitude.shape[1]
    finders = [PrincipalFinder(parameters, spectrum.bin_hz, bins) for _ in range(2)]
    finders[1]._peak_span_min = -1.0
    return [finder.all_principal(amplitude) for finder in finders]


@given(
    amplitudes=st.lists(st.floats(1e-12, 10.0), min_size=3, max_size=60),
    threshold_hz=st.floats(0.001, 100.0),
)
@settings(max_examples=300)
def test_the_bound_leaves_out_nothing_principal_in_any_spectrum(amplitudes, threshold_hz):
    # Bins of 20 Hz put a spectrum as short as this into the band.
    parameters = TransformParameters(threshold_hz=threshold_hz, window_s=0.025)
    spectrum = Spectrum.of(parameters, 2_400)
    assert spectrum.bin_hz == 20.0
    found = with_and_without_the_bound(parameters, spectrum, np.array([amplitudes]))
    for ours, theirs in zip(*map(all_fields, found), strict=True):
        assert identical(ours, theirs)


@given(left=st.floats(0, 1 - 1e-6), right=st.floats(0, 1), scale=st.floats(1e-9, 1e3))
@settings(max_examples=300)
def test_interpolation_raises_a_peak_by_9_8_in_the_power_0_2_at_most(left, right, scale):
    offset, height = parabola(
        np.array([left * scale]), np.array([scale]), np.array([right * scale])
    )
    # The curvature is at least 2e-7 of the height, so rounding moves the top by under 1e-8.
    assert abs(offset[0]) <= 0.5 + 1e-8
    assert scale * (1 - 1e-12) <= height[0] <= scale * (9 / 8) ** 5 * (1 + 1e-12)


@given(rows=st.permutations(range(8)), count=st.integers(1, 8))
@settings(max_examples=30)
def test_a_rows_principal_frequencies_depend_on_that_row_alone(rows, count):
    spectra = amplitude_spectra_few()
    chosen = list(rows[:count])
    finder = PrincipalFinder(PARAMETERS, 48_000 / PARAMETERS.fft_length(48_000), spectra.shape[1])
    together = finder.find(spectra[chosen])
    for place, row in enumerate(chosen):
        alone = finder.find(spectra[row : row + 1])
        mine = together.take(together.row == place)
        for ours, theirs in zip(all_fields(mine)[1:], all_fields(alone)[1:], strict=True):
            assert identical(ours, theirs)


def amplitude_spectra_few():
    spectra = amplitude_spectra(48_000)
    return spectra[:: len(spectra) // 8][:8]


# --- corrections of the live form ---------------------------------------------------------------


def wobble_hz(hz, samplerate, corrected):
    """Return the largest error of the strongest vibration frequency over many windows."""
    design = LiveDesign.of(PARAMETERS, samplerate)
    design = design if corrected else clear_no_image(design)
    band_pass = BandPass(*design_band_pass(PARAMETERS, samplerate))
    filtered = band_pass.process(tone(hz, 1.5, samplerate, 0.5))
    filtered = filtered[samplerate // 4 :]
    windows = sliding_window_view(filtered, PARAMETERS.window_frames(samplerate))[::301]
    found = strongest_principal(design.analysis, spectra_of(design, windows))
    loudest = np.zeros(len(windows))
    np.maximum.at(loudest, found.row, found.r)
    strongest = found.audio_hz[found.r == loudest[found.row]]
    assert strongest.size == len(windows)
    expected = vibration_hz(np.array([hz]), PARAMETERS)
    return np.abs(vibration_hz(strongest, PARAMETERS) - expected).max()


@pytest.mark.parametrize("samplerate", [8_000, 44_100, 48_000])
def test_clearing_the_image_calms_the_wobble_of_low_tones_tenfold(samplerate):
    # Not of every single one: some stand where a side lobe of their image is 0 anyhow.
    before, after = (
        max(wobble_hz(hz, samplerate, corrected) for hz in (55.0, 60.0, 70.0, 85.0, 100.0))
        for corrected in (False, True)
    )
    assert after < before / 10
    assert before > 0.1
    assert after < 0.02


@pytest.mark.parametrize("samplerate", [44_100, 48_000])
def test_clearing_images_leaves_high_tones_as_they_are(samplerate):
    design = LiveDesign.of(PARAMETERS, samplerate)
    sound = tone(5_000, 0.5, samplerate) + tone(9_000, 0.5, samplerate)
    windows = sliding_window_view(sound, PARAMETERS.window_frames(samplerate))[::500]
    spectra = spectra_of(design, windows)
    sections = design.analysis, clear_no_image(design).analysis
    both = [all_principal(section, spectra) for section in sections]
    high = [found.take(found.audio_hz > 4_000) for found in both]
    for ours, theirs in zip(all_fields(high[0]), all_fields(high[1]), strict=True):
        assert identical(ours, theirs)


@pytest.mark.parametrize(("hz", "samplerate"), [(1_641.9, 44_100), (1_566.6, 44_100)])
def test_leaving_out_side_lobes_makes_a_loud_tone_pure(hz, samplerate):
    residuals = []
    for kept in (True, False):
        design = LiveDesign.of(PARAMETERS, samplerate)
        if kept:
            design = leave_out_no_side_lobe(design)
        vibration = vibration_of(design, tone(hz, 3.0, samplerate, 1.0))
        vibration = vibration[samplerate : 3 * samplerate]
        felt_hz = float(vibration_hz(np.array([hz]), PARAMETERS)[0])
        residuals.append(best_sinusoid(*thinned(vibration, samplerate), felt_hz)[2])
    assert residuals[1] <= -60.0 < residuals[0]


def test_what_the_side_lobe_rule_leaves_out_of_recordings_carries_under_a_hundredth_of_them():
    for path in require_recordings()[::3]:
        sound, samplerate = soundfile.read(path, always_2d=True)
        design = LiveDesign.of(PARAMETERS, samplerate)
        filtered = BandPass(*design_band_pass(PARAMETERS, samplerate)).process(sound.mean(axis=1))
        frames = PARAMETERS.window_frames(samplerate)
        windows = sliding_window_view(filtered, frames)[::frames]
        spectra = spectra_of(design, windows)
        found = all_principal(design.analysis, spectra)
        every = replace(design.analysis, partials_max=design.analysis.bins)
        kept = strongest_principal(every, spectra)
        # r^2 is what a partial's vibration goes by.
        assert (kept.r**2).sum() >= 0.99 * (found.r**2).sum(), path.name


@pytest.mark.parametrize("hz", [200.0, 1_000.0, 4_000.0])
def test_averaging_small_changes_takes_6_db_of_jitter_from_a_tone_in_noise(hz):
    sound = tone(hz, 3.0, 48_000, 0.3) + white_noise(3.0, 48_000, 0.003)
    felt_hz = float(vibration_hz(np.array([hz]), PARAMETERS)[0])
    residuals = []
    design = LiveDesign.of(PARAMETERS, 48_000)
    for one in (changed(design, "tracking", steady_gain=1.0), design):
        vibration = vibration_of(one, sound)[48_000:-12_000]
        residuals.append(best_sinusoid(*thinned(vibration, 48_000), felt_hz)[2])
    # A share of 0.15 leaves 0.08 of white jitter's energy, 11 dB less; neighbouring windows
    # overlap, so that theirs is not quite white.
    assert residuals[1] < residuals[0] - 6.0


def test_a_clear_change_of_loudness_is_not_averaged_but_followed_at_once():
    quiet, loud = tone(300, 0.5, 48_000, 0.1), tone(300, 1.0, 48_000, 0.4)[24_000:]
    # Without a seam: both are the same wave, so that one partial goes on through the change.
    design = LiveDesign.of(PARAMETERS, 48_000)
    vibration = vibration_of(design, joined(quiet, loud))[design.tonal_latency_frames :]
    strength = envelope(*thinned(vibration, 48_000))
    steady = strength[2_800:2_900].mean()
    # 30 ms (a window's half, a hop) after the change it stands within 5 % of its new level.
    assert strength[round(0.535 * 3_000)] == pytest.approx(steady, rel=0.05)
