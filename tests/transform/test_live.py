import numpy as np
import pytest
import soundfile
from hypothesis import example, given, settings
from hypothesis import strategies as st

from audioflinger_hook.transform import HapticTransform, TransformParameters
from audioflinger_hook.transform.principal import magnitude
from audioflinger_hook.transform.reference import ReferenceTransform
from tests.oracle.analysis import principal_in
from tests.support import signals
from tests.support.recordings import require_recordings
from tests.support.signals import SAMPLERATES, best_sinusoid, burst, felt_hz, joined, made, tone

PARAMETERS = TransformParameters()

AUDIBLE_HZ = 250.0
"""Above this a shaker is heard rather than felt."""

TONES_HZ = [55, 61.7, 80, 110, 150, 173.3, 220, 350, 511.1, 997, 1_566.6, 2_000.7]
TONES_HZ += [4_200, 8_000, 11_000]
SLOW_BEATS_HZ = {
    44_100: (79.0, 159.93, 638.9, 671.24, 703.2, 862.98),
    48_000: (55.75, 83.0, 112.0, 163.34, 652.5, 848.13, 880.8, 945.95),
}
"""Multiples of half the hop rate, and nearly: there a tone's phase against its own image turns so
slowly from hop to hop that no averaging takes the image's pull away."""

TONES = [(hz, amplitude) for hz in TONES_HZ for amplitude in (0.02, 0.6, 1.0)]


@pytest.mark.parametrize(
    ("hz", "amplitude", "samplerate"),
    [
        (*one, rate)
        for rate in SLOW_BEATS_HZ
        for one in (*TONES, *((hz, 0.3) for hz in SLOW_BEATS_HZ[rate]))
    ],
)
def test_a_steady_tone_is_a_pure_sinusoid_as_strong_as_in_the_reference(hz, amplitude, samplerate):
    sound = tone(hz, 5.0, samplerate, amplitude)
    vibration = made(sound, samplerate).process(sound)[:, 0]
    middle = vibration[round(1.5 * samplerate) : round(3.5 * samplerate)]
    found_hz, level, residual_db = best_sinusoid(*signals.thinned(middle, samplerate), felt_hz(hz))
    assert abs(found_hz - felt_hz(hz)) <= 0.05
    assert residual_db <= -70.0
    # The reference's own level moves by 0.2 dB; at full scale its side lobes can pass C_th.
    form = ReferenceTransform(PARAMETERS, samplerate)
    units = form.cut(sound)
    found = form.analyse(units)
    strengths = np.split(found.r, found.boundaries(len(units))[1:-1])
    # the median over units of the strongest P_k r_k / (1.30 fs/N)
    expected = np.median([r.max() ** 2 / r.sum() for r in strengths])
    level_db = 20 * np.log10(level * PARAMETERS.unit_strength_hz(samplerate) / expected)
    assert abs(level_db) <= (0.2 if amplitude < 1 else 0.3)


def steepest(vibration, samplerate):
    """Return the largest step, in units of what a full-scale sinusoid of 250 Hz can do."""
    return np.abs(np.diff(vibration)).max() * samplerate / (2 * np.pi * AUDIBLE_HZ)


def assert_inaudible(sound, samplerate):
    """Less than -50 dB of the vibration of a sound that comes to rest is audible."""
    calm = np.zeros((samplerate, *sound.shape[1:]))
    vibration = made(sound, samplerate).process(np.concatenate((sound, calm)))[:, 0]
    assert vibration.any()
    assert signals.energy_above_db(vibration, AUDIBLE_HZ, samplerate) <= -50.0
    # A signal that ends at 250 Hz and stays within its peak cannot be steeper than that.
    assert steepest(vibration, samplerate) <= np.abs(vibration).max()


def test_no_recording_makes_an_audible_vibration_or_a_step():
    for path in require_recordings():
        sound, samplerate = soundfile.read(path, always_2d=True)
        assert_inaudible(sound, samplerate)


@pytest.mark.parametrize("samplerate", SAMPLERATES)
@pytest.mark.parametrize("amplitude", [0.15, 1.0])
def test_white_noise_makes_no_audible_vibration_and_no_step(samplerate, amplitude):
    assert_inaudible(signals.white_noise(2.0, samplerate, amplitude), samplerate)


@pytest.mark.parametrize("samplerate", [44_100, 48_000])
def test_sounds_that_start_stop_or_merge_make_no_audible_vibration_and_no_step(samplerate):
    pulses = [burst(hz, 0.02, 0.33, samplerate, 0.8) for hz in (70, 210, 700, 2_300, 11_000)]
    merging = tone(1_000, 2.0, samplerate, 0.4, 0.0)
    for sound in (
        joined(*pulses),
        signals.one_sample(0.5, samplerate, 0.2),
        signals.square(83, 0.5, samplerate),
        signals.square(61, 0.5, samplerate),
        joined(signals.silence(0.25, samplerate), np.full(samplerate // 4, 0.8)),
        signals.chirp(60, 11_000, 1.0, samplerate, 1.0),
        *(merging + tone(1_000 + gap, 2.0, samplerate, 0.4, 1.0) for gap in (20, 30, 60, 90)),
    ):
        assert_inaudible(sound, samplerate)


def test_the_reference_form_does_make_such_steps():
    # So that the measure above is known to see one.
    sweep = signals.chirp(60, 11_000, 1.0, 48_000)
    vibration = signals.played(sweep, 48_000, form="reference")[:, 0]
    assert steepest(vibration, 48_000) > 3 * np.abs(vibration).max()


def agreement_with_reference(sound, samplerate):
    """Return how many principal frequencies of the same units, before any pruning, both forms find,
    the live one, the reference one; a pair may be half a bin apart."""
    form = ReferenceTransform(PARAMETERS, samplerate)
    units = np.concatenate((form.cut(sound), form.cut_last()))
    theirs = form._finder.all_principal(magnitude(form._spectrum.transform(units)))
    ours = principal_in(units, samplerate)
    reach_hz, both = samplerate / PARAMETERS.fft_length(samplerate) / 2, 0
    for unit in range(len(units)):
        free = list(ours.audio_hz[ours.row == unit])
        for hz in theirs.audio_hz[theirs.row == unit]:
            pair = next((other for other in free if abs(other - hz) <= reach_hz), None)
            if pair is not None:
                free.remove(pair)
                both += 1
    return np.array((both, len(ours), len(theirs)))


def test_it_finds_the_principal_frequencies_of_the_reference():
    recorded = [soundfile.read(path, always_2d=True) for path in require_recordings()]
    counts = sum(agreement_with_reference(sound.mean(axis=1), rate) for sound, rate in recorded)
    assert counts[2] > 1_000
    noises = [
        agreement_with_reference(noise, rate)
        for rate in (8_000, 44_100, 48_000)
        for noise in (signals.white_noise(1.0, rate), signals.low_noise(1.0, rate, 0.1))
    ]
    for both, ours, theirs in (counts, *noises):
        assert both / ours >= 0.95
        assert both / theirs >= 0.95


@pytest.mark.exhaustive
def test_every_tone_is_felt_equally_strong_at_all_samplerates():
    for hz in np.geomspace(150, 3_000, 40):
        sounds = [tone(hz, 1.0, samplerate, 0.3) for samplerate in SAMPLERATES]
        felt = [made(*one).process(one[0])[:, 0] for one in zip(sounds, SAMPLERATES, strict=True)]
        ends = [signals.thinned(one[one.size // 2 :], one.size) for one in felt]
        assert np.ptp(20 * np.log10([best_sinusoid(*end, felt_hz(hz))[1] for end in ends])) <= 0.1


def loud_piece(kind, hz, amplitude, samplerate):
    hz = min(hz, 0.45 * samplerate)
    return {
        "tone": lambda: tone(hz, 0.1, samplerate, amplitude),
        "square": lambda: signals.square(hz, 0.1, samplerate, amplitude),
        "noise": lambda: signals.white_noise(0.1, samplerate, amplitude, seed=round(hz)),
        "burst": lambda: burst(hz, 0.02, 0.1, samplerate, amplitude),
        "sample": lambda: signals.one_sample(0.1, samplerate, 0.05, amplitude),
        "DC": lambda: np.full(samplerate // 10, amplitude),
        "silence": lambda: signals.silence(0.1, samplerate),
    }[kind]()


@given(
    parts=st.lists(
        st.tuples(
            st.sampled_from(["tone", "square", "noise", "burst", "sample", "DC", "silence"]),
            st.floats(50, 12_000),
            st.sampled_from([0.3, 1.0, 1.0, 2.0, 30.0, 1_000.0]),
        ),
        min_size=1,
        max_size=6,
    ),
    layers=st.integers(1, 3),
    samplerate=st.sampled_from([8_000, 16_000, 44_100, 48_000, 192_000]),
)
@example(parts=[("tone", 150.0, 1.0)], layers=3, samplerate=48_000)
@example(parts=10 * [("tone", 150.0, 1e3), ("tone", 3e3, 1e3)], layers=1, samplerate=44_100)
@example(parts=[("square", 12_000.0, 1.0)], layers=1, samplerate=48_000)
@example(parts=5 * [("noise", 1.0, 1e3)], layers=1, samplerate=192_000)
@settings(max_examples=150)
def test_no_mix_of_loud_things_exceeds_full_scale(parts, layers, samplerate):
    pieces = [loud_piece(kind, hz, amplitude, samplerate) for kind, hz, amplitude in parts]
    # The same pieces in other orders on top of one another.
    sound = np.sum([joined(*pieces[turn:], *pieces[:turn]) for turn in range(layers)], axis=0)
    sound = np.clip(sound, -1_000, 1_000)
    transform = made(sound, samplerate)
    vibration = np.concatenate((transform.process(sound), transform.finish()))
    assert np.isfinite(vibration).all()
    assert np.abs(vibration).max() < 1.0
    assert transform.limited_samples <= vibration.size


def test_the_limiter_counts_what_it_changes_and_leaves_quiet_sound_alone():
    quiet, loud = tone(150, 1.0, 48_000, 0.5), tone(150, 1.0, 48_000, 4.0)
    transform = made(quiet, 48_000)
    transform.process(quiet)
    assert transform.limited_samples == 0
    transform.process(loud)
    # All of it but the hops before the tone fills a window.
    assert 0.9 * loud.size <= transform.limited_samples <= loud.size


def test_a_limited_tone_is_still_pure():
    sound = tone(440, 3.0, 48_000, 10.0)
    vibration = made(sound, 48_000).process(sound)[48_000:, 0]
    assert best_sinusoid(*signals.thinned(vibration, 48_000), felt_hz(440))[2] <= -60.0
    assert 0.95 < np.abs(vibration).max() < 1.0


@pytest.mark.parametrize("samplerate", [8_000, 44_100, 48_000, 192_000])
@pytest.mark.parametrize("hz", [60.0, 100.0, 145.0, 300.0, 1_000.0, 3_000.0])
def test_the_level_of_what_lasts_follows_as_late_as_declared(samplerate, hz):
    time = signals.times(4.0, samplerate)
    swell_hz = 2.0
    sound = tone(hz, 4.0, samplerate, 0.3) * (1 + 0.6 * np.sin(2 * np.pi * swell_hz * time))
    transform = made(sound, samplerate)
    strength, rate = signals.thinned(transform.process(sound)[:, 0], samplerate)
    strength = signals.envelope(strength, rate)[round(rate) : round(3 * rate)]
    turn = np.exp(-2j * np.pi * swell_hz * (np.arange(strength.size) / rate))
    delay_s = -(np.angle((strength * turn).sum()) + np.pi / 2) / (2 * np.pi * swell_hz)
    delay_s %= 1 / swell_hz
    # Declared for 60 Hz of vibration (145 Hz of audio). The low-pass delays 170 Hz (3 kHz) by
    # 1.6 ms more; and the band-pass, which is no part of the latency, delays 60 Hz of audio 3 ms.
    assert abs(delay_s - transform.tonal_latency_frames / samplerate) <= 0.0035


def test_the_declared_latency_is_about_the_same_time_at_every_samplerate():
    transforms = [HapticTransform(samplerate) for samplerate in SAMPLERATES]
    for transform in transforms:
        assert transform.latency_s == transform.latency_frames / transform.samplerate
        assert transform.latency_s <= 0.010
        assert transform.tonal_latency_frames <= 0.045 * transform.samplerate
    # Hop and low rate are whole frames: they differ by a few per cent from rate to rate.
    assert np.ptp([transform.latency_s for transform in transforms]) <= 0.001


@pytest.mark.parametrize("samplerate", [8_000, 44_100, 48_000])
def test_after_the_sound_it_rings_out_into_exact_zeros(samplerate):
    sound = joined(tone(200, 0.5, samplerate), signals.white_noise(0.2, samplerate))
    transform = made(sound, samplerate)
    transform.process(sound)
    ringing = transform.process(signals.silence(0.6, samplerate))
    assert np.abs(ringing).max() > 0.01
    # The last hops fall silent together: no step above the ringing's own end.
    assert np.abs(ringing[ringing[:, 0].nonzero()[0][-100:], 0]).max(initial=0.0) < 1e-9
    assert not transform.process(signals.silence(2.0, samplerate)).any()


def test_finish_gives_what_silence_would_have_brought():
    sound = tone(300, 0.31, 44_100)
    finished, transform = signals.played(sound, 44_100), made(sound, 44_100)
    silenced = transform.process(np.concatenate((sound, np.zeros(transform.latency_frames))))
    assert signals.identical(finished, silenced)
