import copy
import itertools
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
from device.errors import UsageError
from tests.oracle import vibration_of
from tests.support import signals
from tests.support.parameters import LIMITS
from tests.support.recordings import require_recordings
from tests.support.signals import burst, joined, low_noise, made, silence, square, tone, white_noise

AGREEMENT = 1e-6
"""Of full scale: what the two owe each other. On what follows they are within 1e-8."""


def assert_agree(sound, samplerate, **options):
    """Play a sound through the core, and by the oracle; return the core's vibration."""
    core, oracle = made(sound, samplerate, **options), vibration_of(sound, samplerate, **options)
    during = core.process(sound)
    told = next((told for end, told in reversed(oracle.told) if end <= len(sound)), [])
    assert partials_of(core.principal) == pytest.approx(partials_of(told), abs=1e-6)
    whole = np.concatenate((during, core.finish()))
    assert whole.shape == oracle.samples.shape
    assert np.abs(whole - oracle.samples).max(initial=0.0) <= AGREEMENT
    assert (core.limited_samples, core.replaced_samples) == (oracle.limited, oracle.replaced)
    return during


def partials_of(told):
    """Return how many partials the latest hop vibrates, then what each is."""
    return [len(told), *np.ravel(sorted(told))]


@pytest.mark.parametrize("seconds", [5, pytest.param(15, marks=pytest.mark.exhaustive)])
def test_it_agrees_on_the_demo_scene(seconds):
    assert assert_agree(mixdown(demo_scene())[: seconds * 48_000], 48_000).any()


@pytest.mark.exhaustive
@pytest.mark.parametrize("level", [0.05, 1.0, 8.0])
def test_it_agrees_on_recordings_at_any_level(level):
    for path in require_recordings():
        sound, samplerate = soundfile.read(path, dtype="float32", always_2d=True)
        vibration = assert_agree(np.float32(level) * sound, samplerate)
        assert vibration.any() or level < 1.0, path.name


def swelling(samplerate):
    time = signals.times(1.0, samplerate)
    slow, fast = 1 + np.sin(2 * np.pi * 5 * time), 1 + np.sin(2 * np.pi * 31 * time)
    low, high = (tone(hz, 1.0, samplerate, 0.3) for hz in (440, 0.21 * samplerate))
    return low * slow + high * fast


def gaps(rate):
    rests = [silence(0.35 + 0.05 * n, rate) for n in range(4)]
    return joined(*(joined(white_noise(0.1, rate, 0.5, n), rest) for n, rest in enumerate(rests)))


def damaged(samplerate):
    sound = white_noise(0.6, samplerate, 0.5)
    sound[samplerate // 3 : samplerate // 3 + 50] = np.nan
    sound[samplerate // 2 : samplerate // 2 + 3] = np.inf, -np.inf, 1e30
    return sound


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
    "sweep": lambda rate: signals.chirp(60, 0.49 * rate, 1.5, rate),
    "swelling": swelling,
    "gaps": gaps,
    "damaged": damaged,
    # The spectrum of one sample is flat: there rounding would decide, if it were let.
    "clicks": lambda rate: joined(
        1.0 * (np.arange(rate) % (rate // 40) == 0), signals.one_sample(0.5, rate, 0.2)
    ),
    "equal tones": equal_tones,
}


@pytest.mark.parametrize("samplerate", [*signals.SAMPLERATES, 37_123])
@pytest.mark.parametrize("kind", SOUNDS)
def test_it_agrees_on_synthetic_sounds(kind, samplerate):
    assert_agree(SOUNDS[kind](samplerate), samplerate)


@pytest.mark.sweep
@pytest.mark.parametrize("samplerate", [1_000, 1_001, 1_400, 2_350, 3_900, 384_000, 768_000])
def test_it_agrees_at_the_ends_of_the_samplerates(samplerate):
    # 1 400 Hz: a spectrum of odd length; 2 350 Hz: of twice an odd length.
    for kind in ("noise", "sweep", "clicks", "square"):
        assert_agree(SOUNDS[kind](samplerate)[: samplerate // 2], samplerate)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("per_channel", [False, True])
@pytest.mark.parametrize("channels", [1, 2, 3, 64])
def test_it_agrees_on_any_channels(channels, per_channel, dtype):
    kinds = list(SOUNDS)
    sounds = [SOUNDS[kinds[index % len(kinds)]](8_000)[:4_000] for index in range(channels)]
    assert_agree(signals.columns(*sounds).astype(dtype), 8_000, per_channel=per_channel)


@pytest.mark.exhaustive
@pytest.mark.parametrize("kind", ["noise", "sweep", "square", "clicks", "Nyquist's frequency"])
def test_it_agrees_with_every_parameter_at_its_limits(kind):
    sound = SOUNDS[kind](16_000)[:8_000]  # two windows of the longest and a half
    cases = 0
    for name, window_s in itertools.product(LIMITS, (0.01, 0.04643, 0.2)):
        for value in (LIMITS[name].low, LIMITS[name].high):
            values: Any = {"window_s": window_s, "vibration_top_hz": 220.0, name: value}
            values["partials_max"] = int(values.get("partials_max", 16))
            if not TransformParameters.refusals(values):
                assert_agree(sound, 16_000, parameters=TransformParameters(**values))
                cases += 1
    assert cases > 30


VARIANTS: dict[str, dict[str, Any]] = {
    "by energy": {"amplitude_mapping": "energy"},
    "equal JNDs": {"mapping": "jnd"},
    "both": {"amplitude_mapping": "energy", "mapping": "jnd", "partials_max": 5},
    "followed": {"loudness_db": 30.0},
}
VARIANTS["all"] = VARIANTS["both"] | {"loudness_db": 40.0, "speech_suppression_db": 24.0}


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("variant", "samplerate"),
    [*((variant, 8_000) for variant in VARIANTS), ("both", 44_100), ("all", 44_100)],
)
def test_it_agrees_with_every_law_and_mapping(variant, samplerate):
    parameters = TransformParameters(**VARIANTS[variant])
    for make in SOUNDS.values():
        assert_agree(make(samplerate), samplerate, parameters=parameters)
    # Voices that share a programme.
    kinds = {"gaps": 1, "sweep": 0.05, "noise": 0.3, "bursts": 0.01}
    both = signals.columns(*(level * SOUNDS[kind](samplerate) for kind, level in kinds.items()))
    assert_agree(both[:7_000], samplerate, per_channel=True, parameters=parameters)


PIECES = ["tone", "clicks", "tones", "pairs", "noise", "step", "steps", "silence"]
SHARES, LEVELS = map(st.sampled_from, ([0.5, 1, 2, 4], [0.003, 0.05, 0.3, 1.0, 30.0]))
PIECE = st.tuples(st.sampled_from(PIECES), st.integers(1, 60), SHARES, LEVELS)
equals = given(
    pieces=st.lists(PIECE, min_size=1, max_size=5),
    samplerate=st.sampled_from([1_000, 1_024, 2_000, 8_000, 11_025, 16_000]),
    window_s=st.sampled_from([0.01, 0.02, 0.04643, 0.1, 0.2]),
    partials_max=st.sampled_from([1, 2, 16]),
    threshold_hz=st.sampled_from([0.001, 0.3, 2.0]),
    variant=st.sampled_from(list(VARIANTS)),
)


def agrees_between_equals(pieces, samplerate, window_s, partials_max, threshold_hz, variant):
    drawn = {"window_s": window_s, "threshold_hz": threshold_hz, "partials_max": partials_max}
    parameters = TransformParameters(vibration_top_hz=220.0, **(drawn | VARIANTS[variant]))
    window = parameters.window_frames(samplerate)

    def piece(kind, number, share, level):
        # Periods that divide the window put lines on bins and zeros beside them.
        frame = np.arange(3 * window)
        turns, middle = frame / (share * window), frame.size // 2
        shapes = {
            "tone": np.cos(2 * np.pi * number * turns),
            "clicks": frame % max(1, round(share * window / 3)) == 0,
            "tones": sum(np.cos(2 * np.pi * k * turns) for k in range(number, number + 5)),
            "pairs": 1.0 * (frame == middle) - (frame == min(frame.size - 1, middle + number)),
            "noise": np.random.default_rng(number).uniform(-1, 1, frame.size),
            "step": np.ones(frame.size),
            "steps": np.round(100 * np.cos(2 * np.pi * number * turns)) / 100,
            "silence": np.zeros(frame.size),
        }
        return level * shapes[kind]

    sound = joined(*(piece(*each) for each in pieces))
    try:
        assert_agree(sound, samplerate, parameters=parameters)
    except UsageError:
        # The band begins above half of so low a samplerate.
        assert samplerate == 1_000


@pytest.mark.exhaustive
@equals
@settings(max_examples=50)
def test_it_agrees_where_every_decision_is_between_equals(**drawn):
    agrees_between_equals(**drawn)


@pytest.mark.soak
@equals
@settings(max_examples=500)
def test_it_agrees_in_many_more_decisions_between_equals(**drawn):
    agrees_between_equals(**drawn)


@pytest.mark.parametrize("per_channel", [False, True])
@pytest.mark.parametrize("variant", ["by energy", "followed"])
def test_a_copy_and_a_pickle_go_on_where_the_stream_stands(per_channel, variant):
    gaps, noise, broken = (SOUNDS[kind](16_000) for kind in ("gaps", "noise", "damaged"))
    sound = signals.columns(joined(gaps, noise, broken), joined(-gaps, noise[::-1], broken))
    first, second = sound[:8_001], sound[8_001:]  # amid opposite channels
    parameters = TransformParameters(**VARIANTS[variant])
    transform = made(sound, 16_000, per_channel=per_channel, parameters=parameters)
    transform.process(first)
    others = [copy.deepcopy(transform), pickle.loads(pickle.dumps(transform))]
    expected = np.concatenate((transform.process(second), transform.finish()))
    for other in others:
        assert signals.identical(np.concatenate((other.process(second), other.finish())), expected)
        assert other.limited_samples == transform.limited_samples
        assert other.replaced_samples == transform.replaced_samples


@pytest.mark.parametrize("dtype", [np.float16, np.longdouble, ">f4", ">f8"])
def test_it_agrees_on_sound_of_unusual_types_and_places_in_memory(dtype):
    sound = signals.columns(white_noise(0.3, 8_000, 0.5), tone(300, 0.3, 8_000, 0.5)).astype(dtype)
    sound[100, 0] = np.nan
    shifted = np.zeros(sound.nbytes + 1, np.uint8)[1:].view(dtype).reshape(sound.shape)
    shifted[:] = sound
    assert not shifted.flags.aligned
    assert signals.identical(assert_agree(shifted, 8_000), assert_agree(sound, 8_000))


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
            assert signals.identical(one.process(dense), other.process(strided))


DTYPE = "is not sound in full scale; allowed: float32, float64"


@pytest.mark.parametrize(
    "block",
    [
        *(np.zeros((10, 3), np.float32), np.zeros(10), np.zeros((10, 2), np.int16)),
        *(np.zeros((10, 2), np.complex128), np.zeros((1, 10, 2)), np.zeros(())),
        *(np.full((10, 2), "loud"), [1, 2, 3]),
    ],
    ids=lambda block: f"{np.asarray(block).dtype} {np.shape(block)}",
)
@pytest.mark.parametrize("form", signals.FORMS)
def test_a_block_that_is_refused_leaves_the_stream_as_it_was(form, block):
    sound = signals.columns(white_noise(0.3, 8_000, 0.5), tone(300, 0.3, 8_000, 0.5))
    transform, other = made(sound, 8_000, form=form), made(sound, 8_000, form=form)
    first = transform.process(sound[:1_000])
    with pytest.raises(UsageError, match=rf"a block of.*({DTYPE}|allowed: \(frames, 2\))"):
        transform.process(block)
    whole = np.concatenate((first, transform.process(sound[1_000:]), transform.finish()))
    assert signals.identical(whole, np.concatenate((other.process(sound), other.finish())))
