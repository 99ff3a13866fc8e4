"""The core and its oracle: the same vibration, whatever the sound and its blocks."""

import copy
import functools
import pickle
from typing import Any

import numpy as np
import pytest
import soundfile
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.scenes import demo_scene
from audioflinger_hook.sources import mixdown
from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.design.synthesis import LiveGrid
from device.errors import UsageError
from tests.oracle import vibration_of
from tests.support.memory import memory_growth
from tests.support.parameters import LIMITS
from tests.support.recordings import require_recordings
from tests.support.signals import (
    SAMPLERATES,
    burst,
    chirp,
    columns,
    identical,
    in_blocks,
    joined,
    low_noise,
    made,
    one_sample,
    played,
    silence,
    square,
    times,
    tone,
    white_noise,
)

AGREEMENT = 1e-6
"""Of full scale: what the two owe each other. On what follows they are within 1e-8."""


def assert_agree(sound, samplerate, **options):
    """Play a sound through the core, and by the oracle; return the core's vibration."""
    core, oracle = made(sound, samplerate, **options), vibration_of(sound, samplerate, **options)
    during = core.process(sound)
    told = oracle.told_at(len(sound))
    assert partials_of(core.principal) == pytest.approx(partials_of(told), abs=1e-6)
    whole = np.concatenate((during, core.finish()))
    assert whole.shape == oracle.samples.shape
    assert np.abs(whole - oracle.samples).max(initial=0.0) <= AGREEMENT
    assert core.limited_samples == oracle.limited
    assert core.replaced_samples == oracle.replaced
    return during


def partials_of(told):
    """Return how many partials the latest hop vibrates, then what each is."""
    return [len(told), *np.ravel(sorted(told))]


# --- sounds -------------------------------------------------------------------------------------


def test_it_agrees_on_the_demo_scene():
    assert assert_agree(mixdown(demo_scene()), 48_000).any()


@pytest.mark.exhaustive
@pytest.mark.parametrize("level", [0.05, 1.0, 8.0])
def test_it_agrees_on_recordings_at_any_level(level):
    for path in require_recordings():
        sound, samplerate = soundfile.read(path, dtype="float32", always_2d=True)
        vibration = assert_agree(np.float32(level) * sound, samplerate)
        assert vibration.any() or level < 1.0, path.name


@pytest.mark.exhaustive
def test_it_agrees_where_speech_is_suppressed():
    parameters = TransformParameters(speech_suppression_db=24.0)
    paths = [path for path in require_recordings() if path.stem.startswith("Front_")]
    spoken = np.concatenate([soundfile.read(path)[0] for path in paths])
    speech = joined(spoken, spoken, silence(3.0, 48_000), spoken)
    effects = np.resize(mixdown(demo_scene()).mean(axis=1), speech.shape)
    for sound in (speech, speech + effects, columns(speech, effects)):
        lowered = assert_agree(sound, 48_000, parameters=parameters, per_channel=True)
        assert not identical(lowered, played(sound, 48_000, per_channel=True)[: len(sound)])


def sweep_up(samplerate):
    return chirp(60, 0.49 * samplerate, 1.5, samplerate)


def swelling(samplerate):
    time = times(1.0, samplerate)
    slow, fast = 1 + np.sin(2 * np.pi * 5 * time), 1 + np.sin(2 * np.pi * 31 * time)
    return (
        tone(440, 1.0, samplerate, 0.3) * slow
        + tone(0.21 * samplerate, 1.0, samplerate, 0.3) * fast
    )


def gaps(samplerate):
    pieces = [
        joined(white_noise(0.1, samplerate, 0.5, seed), silence(0.35 + 0.05 * seed, samplerate))
        for seed in range(4)
    ]
    return joined(*pieces)


def damaged(samplerate):
    sound = white_noise(0.6, samplerate, 0.5)
    sound[samplerate // 3 : samplerate // 3 + 50] = np.nan
    sound[samplerate // 2 : samplerate // 2 + 3] = np.inf, -np.inf, 1e30
    return sound


def clicks(samplerate):
    # The spectrum of one sample is flat: there rounding would decide, if it were let.
    period = np.zeros(samplerate // 40)
    period[0] = 1.0
    return joined(np.resize(period, samplerate), one_sample(0.5, samplerate, 0.2))


def equal_tones(samplerate):
    # On bins, in step and equally strong: every decision is between equals.
    window = TransformParameters().window_frames(samplerate)
    turns = np.arange(samplerate)[:, None] * (np.array([3, 5, 8, 11, 14]) / window)
    return 0.1 * np.cos(2 * np.pi * turns).sum(axis=1)


SOUNDS = {
    "noise": lambda rate: white_noise(1.0, rate),
    "faint noise": lambda rate: white_noise(1.0, rate, 0.02),
    "low noise": lambda rate: low_noise(1.0, rate, 0.05),
    "noise 60 dB over": lambda rate: white_noise(0.5, rate, 1_000.0),
    "tones": lambda rate: sum(tone(hz, 1.0, rate, 0.1) for hz in (110, 220, 330, 441, 450, 663)),
    "a tone 60 dB over": lambda rate: tone(150, 0.5, rate, 1_000.0),
    "two tones": lambda rate: tone(600, 0.7, rate, 0.4) + tone(630, 0.7, rate, 0.4),
    "square": lambda rate: square(83, 0.5, rate),
    "Nyquist's frequency": lambda rate: square(rate / 2, 0.5, rate),
    "DC": lambda rate: joined(silence(0.2, rate), np.full(rate // 2, 1.0)),
    "bursts": lambda rate: joined(*(burst(hz, 0.02, 0.3, rate, 0.8) for hz in (80, 700, 2_300))),
    "denormal numbers": lambda rate: joined(tone(300, 0.3, rate), np.full(rate, 1e-310)),
    "sweep": sweep_up,
    "swelling": swelling,
    "gaps": gaps,
    "damaged": damaged,
    "clicks": clicks,
    "equal tones": equal_tones,
}


@pytest.mark.parametrize("samplerate", [*SAMPLERATES, 37_123])
@pytest.mark.parametrize("kind", SOUNDS)
def test_it_agrees_on_synthetic_sounds(kind, samplerate):
    assert_agree(SOUNDS[kind](samplerate), samplerate)


@pytest.mark.sweep
@pytest.mark.parametrize("samplerate", [1_000, 1_001, 1_400, 2_350, 3_900, 384_000, 768_000])
def test_it_agrees_at_the_ends_of_the_samplerates(samplerate):
    # 1 400 Hz: a spectrum of odd length; 2 350 Hz: of twice an odd length.
    for kind in ("noise", "sweep", "clicks", "square"):
        assert_agree(SOUNDS[kind](samplerate)[: samplerate // 2], samplerate)


# --- channels and parameters ---------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("per_channel", [False, True])
@pytest.mark.parametrize("channels", [1, 2, 3, 64])
def test_it_agrees_on_any_channels(channels, per_channel, dtype):
    kinds = list(SOUNDS)
    sounds = [SOUNDS[kinds[index % len(kinds)]](8_000)[:4_000] for index in range(channels)]
    assert_agree(columns(*sounds).astype(dtype), 8_000, per_channel=per_channel)


def at_the_limits():
    """Return parameters with one of them at one of its limits, at three lengths of the window."""
    for name, limits in LIMITS.items():
        for value in (limits.low, limits.high):
            for window_s in (0.01, 0.04643, 0.2):
                values = {"window_s": window_s, "vibration_top_hz": 220.0, name: value}
                values["partials_max"] = int(values.get("partials_max", 16))
                if not TransformParameters.refusals(values):
                    yield values


@pytest.mark.exhaustive
@pytest.mark.parametrize("kind", ["noise", "sweep", "square", "clicks", "Nyquist's frequency"])
def test_it_agrees_with_every_parameter_at_its_limits(kind):
    sound = SOUNDS[kind](16_000)[:12_000]
    cases = list(at_the_limits())
    assert len(cases) > 30
    for values in cases:
        assert_agree(sound, 16_000, parameters=TransformParameters(**values))


VARIANTS: dict[str, dict[str, Any]] = {
    "by energy": {"amplitude_mapping": "energy"},
    "equal JNDs": {"mapping": "jnd"},
    "both": {"amplitude_mapping": "energy", "mapping": "jnd", "partials_max": 5},
    "followed": {"loudness_db": 30.0},
    "all": {
        "loudness_db": 40.0,
        "amplitude_mapping": "energy",
        "mapping": "jnd",
        "partials_max": 5,
        "speech_suppression_db": 24.0,
    },
}


@pytest.mark.sweep
@pytest.mark.parametrize("samplerate", [8_000, 44_100])
@pytest.mark.parametrize("variant", VARIANTS)
def test_it_agrees_with_every_law_and_mapping(variant, samplerate):
    parameters = TransformParameters(**VARIANTS[variant])
    for make in SOUNDS.values():
        assert_agree(make(samplerate), samplerate, parameters=parameters)


@pytest.mark.sweep
@pytest.mark.parametrize("variant", ["followed", "all"])
def test_it_agrees_on_voices_that_share_a_programme(variant):
    samplerate = 8_000
    sounds = [SOUNDS[kind](samplerate)[:7_000] for kind in ("gaps", "sweep", "noise", "bursts")]
    both = columns(
        *(level * each for level, each in zip((1, 0.05, 0.3, 0.01), sounds, strict=True))
    )
    parameters = TransformParameters(**VARIANTS[variant])
    assert_agree(both, samplerate, per_channel=True, parameters=parameters)


@pytest.mark.exhaustive
@given(
    pieces=st.lists(
        st.tuples(
            st.sampled_from(
                ["tone", "clicks", "tones", "pairs", "noise", "step", "steps", "silence"]
            ),
            st.integers(1, 60),
            st.sampled_from([0.5, 1, 2, 4]),
            st.sampled_from([0.003, 0.05, 0.3, 1.0, 30.0]),
        ),
        min_size=1,
        max_size=5,
    ),
    samplerate=st.sampled_from([1_000, 1_024, 2_000, 8_000, 11_025, 16_000]),
    window_s=st.sampled_from([0.01, 0.02, 0.04643, 0.1, 0.2]),
    partials_max=st.sampled_from([1, 2, 16]),
    threshold_hz=st.sampled_from([0.001, 0.3, 2.0]),
    variant=st.sampled_from(list(VARIANTS)),
)
@settings(max_examples=120)
def test_it_agrees_where_every_decision_is_between_equals(
    pieces, samplerate, window_s, partials_max, threshold_hz, variant
):
    parameters = TransformParameters(
        window_s=window_s,
        threshold_hz=threshold_hz,
        vibration_top_hz=220.0,
        **({"partials_max": partials_max} | VARIANTS[variant]),
    )
    window = parameters.window_frames(samplerate)

    def piece(kind, number, share, level):
        # Periods that divide the window put lines on bins and zeros beside them.
        frames = 3 * window
        turns = np.arange(frames) / (share * window)
        match kind:
            case "tone":
                return level * np.cos(2 * np.pi * number * turns)
            case "clicks":
                return level * (np.arange(frames) % max(1, round(share * window / 3)) == 0)
            case "tones":
                return level * sum(np.cos(2 * np.pi * k * turns) for k in range(number, number + 5))
            case "pairs":
                pair = np.zeros(frames)
                pair[[frames // 2, min(frames - 1, frames // 2 + number)]] = level, -level
                return pair
            case "noise":
                return level * np.random.default_rng(number).uniform(-1, 1, frames)
            case "step":
                return np.full(frames, level)
            case "steps":
                return np.round(100 * np.cos(2 * np.pi * number * turns)) * level / 100
        return np.zeros(frames)

    sound = joined(*(piece(*each) for each in pieces))
    try:
        assert_agree(sound, samplerate, parameters=parameters)
    except UsageError:
        # The band begins above half of so low a samplerate.
        assert samplerate == 1_000


# --- the stream ----------------------------------------------------------------------------------


@functools.cache
def whole(variant):
    """Return a sound of three channels, and its vibration by the oracle, of the mix and of each."""
    sound = columns(*(SOUNDS[kind](8_000) for kind in ("gaps", "bursts", "damaged")))
    parameters = TransformParameters(**VARIANTS.get(variant, {}))
    ways = {
        each: vibration_of(sound, 8_000, parameters, per_channel=each) for each in (False, True)
    }
    return sound, parameters, ways


@given(
    lengths=st.lists(st.integers(0, 3_000), max_size=60),
    per_channel=st.booleans(),
    variant=st.sampled_from(["paper", *VARIANTS]),
)
def test_it_agrees_at_any_split_of_the_sound(lengths, per_channel, variant):
    sound, parameters, ways = whole(variant)
    options = {"per_channel": per_channel, "parameters": parameters}
    vibration = in_blocks(sound, lengths, 8_000, **options)
    assert np.abs(vibration - ways[per_channel].samples).max() <= AGREEMENT


@pytest.mark.parametrize("per_channel", [False, True])
@pytest.mark.parametrize("variant", ["by energy", "followed"])
def test_a_copy_and_a_pickle_go_on_where_the_stream_stands(per_channel, variant):
    sound = columns(SOUNDS["gaps"](16_000), SOUNDS["noise"](16_000), SOUNDS["damaged"](16_000))
    first, second = sound[:5_001], sound[5_001:]
    parameters = TransformParameters(**VARIANTS[variant])
    transform = made(sound, 16_000, per_channel=per_channel, parameters=parameters)
    transform.process(first)
    others = [copy.deepcopy(transform), pickle.loads(pickle.dumps(transform))]
    expected = np.concatenate((transform.process(second), transform.finish()))
    for other in others:
        assert identical(np.concatenate((other.process(second), other.finish())), expected)
        assert other.limited_samples == transform.limited_samples
        assert other.replaced_samples == transform.replaced_samples


@pytest.mark.parametrize("dtype", [np.float16, np.longdouble, ">f4", ">f8"])
def test_it_agrees_on_sound_of_unusual_types(dtype):
    sound = columns(white_noise(0.3, 8_000, 0.5), tone(300, 0.3, 8_000, 0.5))
    sound[100, 0] = np.nan
    assert assert_agree(sound.astype(dtype), 8_000).any()


def test_a_sample_that_does_not_begin_where_its_type_should_is_read():
    sound = columns(white_noise(0.3, 8_000, 0.5), tone(300, 0.3, 8_000, 0.5)).astype(np.float32)
    shifted = np.zeros(sound.nbytes + 1, np.uint8)[1:].view(np.float32).reshape(sound.shape)
    shifted[:] = sound
    assert not shifted.flags.aligned
    expected = made(sound, 8_000).process(sound)
    assert identical(made(shifted, 8_000).process(shifted), expected)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("channels", [1, 2, 3])
def test_silence_is_the_same_however_its_frames_lie_in_memory(channels, dtype):
    # Silences that it falls asleep in; what then wakes it is one channel of one frame.
    rng = np.random.default_rng(0)
    sound = white_noise(4.0 * channels, 8_000, 0.5).reshape(-1, channels).astype(dtype)
    for first in (1_000, 9_000, 17_000, 25_000):
        sound[first : first + 6_000] = 0.0
        sound[first + rng.integers(5_000, 6_000), -1] = 1e-40
    sound[2_000:2_100] = -0.0
    apart = np.ones((len(sound), 2 * channels), dtype)[:, ::2]
    apart[:] = sound
    for block in (7, 100, 32_000):
        one, other = made(sound, 8_000), made(sound, 8_000)
        for first in range(0, len(sound), block):
            dense, strided = sound[first : first + block], apart[first : first + block]
            assert identical(one.process(dense), other.process(strided))


def test_it_agrees_after_a_silence_in_which_the_band_pass_comes_to_rest():
    noise = white_noise(0.2, 48_000, 0.5)
    assert assert_agree(joined(noise, silence(1.0, 48_000), noise), 48_000)[58_000:].any()


@pytest.mark.parametrize(
    "block",
    [
        np.zeros((10, 3), np.float32),
        np.zeros(10),
        np.zeros((10, 2), np.int16),
        np.zeros((10, 2), np.complex128),
        np.zeros((1, 10, 2)),
        np.zeros(()),
        np.full((10, 2), "loud"),
        [1, 2, 3],
    ],
    ids=lambda block: f"{np.asarray(block).dtype} {np.shape(block)}",
)
def test_a_block_that_is_refused_leaves_the_stream_as_it_was(block):
    sound = columns(white_noise(0.3, 8_000, 0.5), tone(300, 0.3, 8_000, 0.5))
    transform, other = made(sound, 8_000), made(sound, 8_000)
    first = transform.process(sound[:1_000])
    with pytest.raises(UsageError, match="a block of"):
        transform.process(block)
    whole = np.concatenate((first, transform.process(sound[1_000:]), transform.finish()))
    assert identical(whole, np.concatenate((other.process(sound), other.finish())))


@pytest.mark.soak
def test_a_million_hops_take_no_more_memory_than_a_thousand():
    samplerate = 1_000
    hop = LiveGrid.at(TransformParameters(), samplerate).hop_frames
    sound = joined(
        tone(200, 8.0, samplerate, 0.5), white_noise(4.0, samplerate), silence(2.0, 1_000)
    )
    loop = np.resize(sound, (1_000 * hop, 1)).astype(np.float32)
    held = memory_growth(made(loop, samplerate), loop, 100 * hop, 1_000_000 * hop)
    assert held.frames >= 1_000_000 * hop
    assert held.resident_kb < 256
    assert held.objects < 200
