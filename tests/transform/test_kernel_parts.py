"""The kernel's parts by themselves, and what it refuses to be made of or to work on."""

import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.fft import rfft

from audioflinger_hook.core import blob
from audioflinger_hook.core.compiled_core import Core
from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.design import LiveDesign
from device.errors import InternalError
from tests.support.kernel_probes import probes
from tests.support.memory import resident_bytes
from tests.support.signals import SAMPLERATES, identical, joined, silence, tone, white_noise

if probes is None:
    pytest.skip("no C compiler", allow_module_level=True)

RATE = 8_000
# With everything that can be switched on, so that all of it meets what does not fit.
DESIGN = LiveDesign.of(TransformParameters(speech_suppression_db=12.0), RATE)
SETTINGS: dict[str, Any] = DESIGN.settings()
VALUES: dict[str, Any] = blob.unpack(DESIGN.to_bytes())


def design_of(values, channels=1, each=False):
    return blob.pack({"inputs": channels, "per_channel": int(each), **values})


WHOLE = design_of(VALUES)


def made(channels=1, each=False, **changes):
    return Core(design_of({**VALUES, **changes}, channels, each))


def played(kernel, sound):
    return kernel.vibrate(sound if sound.ndim == 2 else sound[:, None])


# --- spectra and functions -----------------------------------------------------------------------

LENGTHS = {
    *(TransformParameters().fft_length(samplerate) for samplerate in (1_000, *SAMPLERATES)),
    *(2**a * 3**b * 5**c for a in range(6) for b in range(4) for c in range(4)),
    2**13,
    3**7,
    5**5,
} - {1}


def test_every_spectrum_is_scipys():
    rng = np.random.default_rng(0)
    for length in sorted(LENGTHS):
        for frames in {length // 2, max(1, length // 2 - 1), max(1, length // 3), length}:
            samples = rng.standard_normal(frames)
            expected = rfft(samples, length)
            bins = np.empty((2, length // 2 + 1))
            probes.spectrum(samples, length, bins)
            error = np.abs(bins[0] + 1j * bins[1] - expected).max()
            assert error <= 1e-15 * np.log2(length) * np.abs(expected).max(), length
            # The first of them alone are the same.
            few = np.empty((2, 1 + length // 5))
            probes.spectrum(samples, length, few)
            assert identical(few, np.ascontiguousarray(bins[:, : few.shape[1]]))


@pytest.mark.parametrize(
    ("frames", "length", "bins"),
    [
        (7, 14, 8),
        (11, 22, 3),
        (6, 5, 2),
        (2, 1 << 25, 2),
        (1, 0, 1),
        (1, -8, 1),
        (2, 8, 6),
        (2, 8, 0),
    ],
)
def test_a_spectrum_that_cannot_be_made_is_refused(frames, length, bins):
    with pytest.raises(ValueError, match=r"length|bins"):
        probes.spectrum(np.zeros(frames), length, np.zeros((2, bins)))


@given(st.lists(st.floats(1e-300, 1e300), min_size=1, max_size=40))
@settings(max_examples=200)
def test_fifth_roots_are_exact_but_for_a_unit_in_the_last_place(numbers):
    roots = np.array(numbers)
    probes.fifth_roots(roots)
    # In extended precision: 0.2 is not a fifth, which shows from 1e30 on.
    exact = np.array(numbers, dtype=np.longdouble) ** (np.longdouble(1) / 5)
    np.testing.assert_allclose(roots, exact.astype(np.float64), rtol=4e-16)


@pytest.mark.parametrize("strange", [np.inf, -np.inf, np.nan, -1.0, 5e-324, 1e-310, 1.7e308])
def test_a_fifth_root_of_anything_else_is_a_number_or_none_and_harms_no_neighbour(strange):
    roots = np.array([1.0, 32.0, strange, 243.0, 0.0, 1_024.0])
    probes.fifth_roots(roots)
    np.testing.assert_allclose(np.delete(roots, 2), [1.0, 2.0, 3.0, 0.0, 4.0], rtol=1e-15)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40))
@settings(max_examples=200)
def test_cosines_of_turns_are_exact_to_the_last_bits(turns):
    cosines = np.array(turns)
    probes.cosines(cosines)
    exact = np.cos(2 * np.pi * (np.array(turns) - np.rint(turns)))
    np.testing.assert_allclose(cosines, exact, rtol=0, atol=1e-15)


# --- settings ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", VALUES)
def test_a_kernel_is_not_made_without_a_value(name):
    given = {other: value for other, value in VALUES.items() if other != name}
    if name == "window_frames":  # the core has no transform then
        assert Core(design_of(given)).info.latency_frames == 0
        return
    with pytest.raises(InternalError, match=name):
        Core(design_of(given))


@pytest.mark.parametrize(
    ("design", "reason"),
    [
        (b"", "not a design"),
        (WHOLE[:16], "not a design"),
        (b"X" + WHOLE[1:], "not a design"),
        (WHOLE[:8] + b"\x63" + WHOLE[9:], "another version"),
        (WHOLE[:-8], "cut or too long"),
        (WHOLE + bytes(8), "cut or too long"),
        (WHOLE[:-8] + bytes(8), "checksum"),
        (blob.pack(VALUES), "lacks samplerate or inputs"),
    ],
)
def test_a_kernel_is_not_made_of_bytes_that_are_no_design(design, reason):
    with pytest.raises(InternalError, match=reason):
        Core(design)


@given(at=st.integers(0, len(WHOLE) - 1), flip=st.integers(1, 255))
def test_a_kernel_is_not_made_of_a_damaged_design(at, flip):
    damaged = bytearray(WHOLE)
    damaged[at] ^= flip
    with pytest.raises(InternalError, match="design"):
        Core(bytes(damaged))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("window_frames", SETTINGS["window_frames"] + 1),
        ("window_frames", 0),
        ("hop_frames", SETTINGS["hop_frames"] + 1),
        ("decimation", 0),
        ("steps", 0),
        ("hops_in_window", 0),
        ("fft_length", SETTINGS["window_frames"]),
        ("fft_length", 7 * 2**10),
        ("bins", 1),
        ("bins", SETTINGS["fft_length"]),
        ("first_bin", 0),
        ("last_bin", SETTINGS["bins"] - 1),
        ("partials_max", 0),
        ("partials_max", 2**40),
        ("ring_hops", 2**62),
        ("ring_hops", -1),
        ("samplerate", 0),
        ("samplerate", 2**40),
        ("silence", np.nan),
        ("gain_step_hz", 0.0),
        ("window", SETTINGS["window"][1:]),
        ("window", np.full_like(SETTINGS["window"], np.nan)),
        ("band_b", np.ones(1)),
        ("band_b", np.ones(30)),
        ("band_a", np.ones(2)),
        ("low_a", 2.0 * SETTINGS["low_a"]),
        ("image_table", np.zeros(0)),
        ("image_turn", np.zeros((2, SETTINGS["bins"] + 1))),
        ("image_turn", np.zeros(3)),
        ("attack", SETTINGS["attack"][1:]),
        ("seconds", np.zeros(1)),
        ("phases", np.ones(1)),
        ("phases", np.zeros((0, SETTINGS["decimation"]))),
        ("gain_table", np.ones(1)),
        ("ticks", 0),
        ("ticks", SETTINGS["ticks"] + 1),
        ("tick_steps", SETTINGS["tick_steps"] + 1),
        ("tick_frames", SETTINGS["tick_frames"] + 1),
        ("tick_frames", SETTINGS["short_frames"] + 1),
        ("tick_glide", SETTINGS["tick_glide"][1:]),
        ("tick_glide_s", SETTINGS["tick_glide_s"][1:]),
        ("find_onsets", 2),
        ("energy_mapping", 2),
        ("short_frames", 0),
        ("short_frames", SETTINGS["short_frames"] + 1),
        ("short_frames", SETTINGS["tick_frames"] - 1),
        ("short_window", SETTINGS["short_window"][1:]),
        ("short_length", SETTINGS["short_length"] + 1),
        ("short_length", 2 * (SETTINGS["short_frames"] // 2) - 2),
        ("short_length", 7 * 2**10),
        ("short_bins", 0),
        ("short_bins", SETTINGS["short_bins"] + 1),
        ("short_bins", SETTINGS["short_bins"] - 1),
        ("short_hz", SETTINGS["short_hz"][1:]),
        ("short_ticks", SETTINGS["short_ticks"] - 1),
        ("short_ticks", SETTINGS["short_ticks"] + 1),
        ("newest_frames", 0),
        ("newest_frames", SETTINGS["tick_frames"] + 1),
        ("newest_frames", SETTINGS["short_frames"] + 1),
        ("band_edges", SETTINGS["band_edges"][:1]),
        ("band_edges", SETTINGS["band_edges"][::-1].copy()),
        ("band_edges", SETTINGS["band_edges"] + SETTINGS["short_bins"]),
        ("band_edges", SETTINGS["band_edges"] - SETTINGS["band_edges"][0]),
        ("band_edges", SETTINGS["band_edges"] + 0.5),
        ("back_ticks", 2),
        ("back_ticks", 65),
        ("rest_ticks", SETTINGS["rearmed_ticks"] - 1),
        ("rest_ticks", 2**40),
        ("rearmed_ticks", 0),
        ("rearmed_ticks", SETTINGS["rest_ticks"] + 1),
        ("heard_ticks", 0),
        ("heard_ticks", SETTINGS["heard_ticks"] + 1),
        ("one_tone", SETTINGS["one_tone"][1:]),
        ("groups_max", 0),
        ("groups_max", SETTINGS["onset_partials_max"] + 1),
        ("onset_partials_max", SETTINGS["groups_max"] - 1),
        ("onset_partials_max", 17),
        ("rise_shares", np.zeros(0)),
        ("rise_shares", np.full_like(SETTINGS["rise_shares"], np.inf)),
        ("hold_hops", 2**40),
        ("speech_edges", SETTINGS["speech_edges"][1:]),
        ("speech_edges", SETTINGS["speech_edges"][::-1].copy()),
        ("speech_edges", SETTINGS["speech_edges"] + SETTINGS["bins"]),
        ("speech_edges", SETTINGS["speech_edges"] - 1e3),
        ("speech_centres_hz", np.ones(6)),
        ("speech_log_pitches", np.ones(1)),
        ("speech_log_pitches", SETTINGS["speech_log_pitches"][1:]),
        ("speech_teeth", SETTINGS["speech_teeth"] - 1.0),
        ("speech_teeth", SETTINGS["speech_teeth"] + SETTINGS["bins"]),
        ("speech_teeth", np.zeros(0)),
        ("speech_ramps", SETTINGS["speech_ramps"][1:]),
    ],
)
def test_a_kernel_is_not_made_of_settings_that_do_not_fit(name, value):
    if (name, value if isinstance(value, int) else 1) == ("window_frames", 0):
        assert made(window_frames=0).info.latency_frames == 0  # a core without a transform
        return
    with pytest.raises((InternalError, struct.error)):
        made(**{name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("steps", 4.0),
        ("steps", np.array([54.0])),
        ("hop_s", 1),
        ("hop_s", np.array([0.018])),
        ("window", 1),
        ("window", 1.0),
    ],
)
def test_a_kernel_is_not_made_of_settings_of_another_kind(name, value):
    with pytest.raises(InternalError, match=f"lacks .*{name}"):
        made(**{name: value})


@pytest.mark.parametrize("channels", [0, -1, 65, 2**70])
def test_a_kernel_has_one_channel_at_least_and_not_thousands(channels):
    with pytest.raises((InternalError, struct.error)):
        made(channels)


@pytest.mark.exhaustive
@given(data=st.data(), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=150)
def test_settings_of_any_numbers_make_a_kernel_that_runs_or_none(data, seed):
    rng = np.random.default_rng(seed)
    odd_numbers = st.sampled_from([0.0, -1.0, 1e-300, 1e300, np.inf, -np.inf, 0.5, np.nan, 3.0])
    odd_counts = st.sampled_from([0, 1, 2, 3, 5, 7, 60, 100, 1_000])
    changes = {}
    for name in data.draw(st.lists(st.sampled_from(sorted(SETTINGS)), min_size=1, max_size=4)):
        value = SETTINGS[name]
        if isinstance(value, np.ndarray):
            changes[name] = value * rng.uniform(-2.0, 2.0, value.shape)
        elif isinstance(value, int):
            changes[name] = data.draw(odd_counts)
        else:
            changes[name] = data.draw(odd_numbers)
    try:
        kernel = made(**changes)
    except (InternalError, struct.error):
        return
    for sound in (white_noise(0.3, RATE, 0.5), tone(300, 0.2, RATE, 1_000.0), silence(0.1, RATE)):
        played(kernel, sound)
    kernel.state = kernel.state


def test_a_kernel_that_is_let_go_of_gives_its_memory_back():
    def kernels(count):
        for _ in range(count):
            played(made(8, True), np.zeros((100, 8)))
            with pytest.raises(InternalError, match="fft_length"):
                made(fft_length=7 * 2**10)
        return resident_bytes()

    before = kernels(50)
    assert kernels(400) - before < 2**20


# --- blocks and states ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    "frames",
    [
        np.zeros((5, 1)),
        np.zeros(5),
        np.zeros((1, 5, 2)),
        np.zeros((5, 2), np.int32),
        np.zeros((5, 2), ">f4"),
        np.frombuffer(bytes(81), np.float64, 10, 1).reshape(5, 2),
    ],
    ids=["channels", "one dimension", "three", "integers", "byte order", "unaligned"],
)
def test_a_block_that_does_not_fit_is_refused(frames):
    kernel = made(2)
    before = kernel.state
    for process in (kernel.vibrate, kernel.process):
        with pytest.raises(InternalError, match="a block has"):
            process(frames)
    assert kernel.state == before
    assert kernel.vibrate(np.zeros((0, 2))).shape == (0, 1)


def test_sound_of_any_strides_gives_the_bytes_of_its_copy():
    sound = white_noise(0.4, RATE, 0.5)
    both = np.asfortranarray(np.column_stack([sound, np.flip(sound)]))
    for view in (both, both[::-1], both[:, ::-1], both.astype(np.float32)[::2]):
        expected = played(made(2), np.ascontiguousarray(view))
        assert identical(played(made(2), view), expected)


def test_a_state_can_be_kept_and_returned_to():
    sound = joined(white_noise(0.4, RATE, 0.5), tone(300, 0.4, RATE))
    kernel = made()
    played(kernel, sound[:2_000])
    kept = kernel.state
    expected = played(kernel, sound[2_000:])
    kernel.state = kept
    assert identical(played(kernel, sound[2_000:]), expected)
    other = made()
    other.state = kept
    assert identical(played(other, sound[2_000:]), expected)


@pytest.mark.parametrize(
    "state",
    [
        b"",
        made().state[:-1],
        made().state + b"0",
        b"\xff" * len(made().state),
        b"\x01" * len(made().state),
        np.full(len(made().state) // 8, 1.0).tobytes(),
        np.full(len(made().state) // 8, np.nan).tobytes(),
    ],
)
def test_a_state_that_no_kernel_has_is_refused(state):
    kernel = made()
    played(kernel, white_noise(0.4, RATE, 0.5))
    with pytest.raises(InternalError, match="state"):
        kernel.state = state
    assert np.isfinite(played(kernel, white_noise(0.4, RATE, 0.5))).all()


@given(seed=st.integers(0, 2**32 - 1), share=st.sampled_from([0.001, 0.1, 1.0]))
@settings(max_examples=100)
def test_a_state_of_any_numbers_is_refused_or_goes_on_without_a_fall(seed, share):
    rng = np.random.default_rng(seed)
    kernel = made()
    played(kernel, white_noise(0.4, RATE, 0.5))
    numbers = np.frombuffer(kernel.state, np.float64).copy()
    changed = rng.random(numbers.size) < share
    numbers[changed] = rng.choice([0.0, 1.0, -1.0, np.nan, np.inf, 1e300, 5e-324], changed.sum())
    # Counters stay: they are no numbers with a decimal point.
    numbers[:8] = np.frombuffer(kernel.state, np.float64)[:8]
    try:
        kernel.state = numbers.tobytes()
    except InternalError:
        return
    played(kernel, white_noise(0.4, RATE, 0.5))
