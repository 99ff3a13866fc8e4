"""Cosines added up two ways: where only float32 is wanted, the quick way gives the same float32."""

from itertools import pairwise

import numpy as np
import pytest

from audioflinger_hook.transform import HapticTransform
from audioflinger_hook.transform.reference import Superposition
from tests.support import signals

RATE = 48_000


def single(values):
    return np.asarray(values, np.float32)


def both_ways(superposition, weight, hz, edges):
    units = (slice(*unit) for unit in pairwise(edges))
    exact = np.stack([superposition.exact(weight[unit], hz[unit]) for unit in units])
    return exact, superposition.single(weight, hz, edges)


@pytest.mark.parametrize(
    ("frames", "samplerate", "top_hz"),
    [(2_229, 48_000, 220.0), (2_048, 44_100, 220.0), (46, 1_000, 60.0), (38_400, 192_000, 400.0)],
)
def test_rounded_to_float32_every_sample_is_that_of_the_equation(frames, samplerate, top_hz):
    superposition = Superposition(frames, samplerate)
    counts = [3, 0, 16, 1, 64, 0] * 4  # partials of each unit
    generator, edges = np.random.default_rng(3), np.concatenate(([0], np.cumsum(counts)))
    weight = 10.0 ** generator.uniform(-4.0, 0.5, edges[-1])
    hz = generator.uniform(10.0, top_hz, edges[-1])
    exact, quick = both_ways(superposition, weight, hz, edges)
    assert quick.shape == (len(counts), frames)
    assert signals.identical(single(quick), single(exact))
    assert not quick[1].any()


def test_sums_on_an_edge_of_float32_go_as_the_equation_and_only_there_the_quick_way(monkeypatch):
    # One partial each, as strong as it takes to bring one frame half-way between two floats.
    frames, units = 2_229, 500
    generator = np.random.default_rng(5)
    hz, frame = generator.uniform(20.0, 220.0, units), generator.integers(1, frames, units)
    cosine = np.cos(hz * (2.0 * np.pi * np.arange(frames) / RATE)[frame])
    below = single(0.3 * cosine)
    weight = (0.5 * (below.astype(float) + np.nextafter(below, single(9.0)))) / cosine
    superposition, edges = Superposition(frames, RATE), np.arange(units + 1)
    exact, quick = both_ways(superposition, weight, hz, edges)
    assert signals.identical(single(quick), single(exact))
    monkeypatch.setattr(Superposition, "_redo", lambda *_: None)
    unsettled = superposition.single(weight, hz, edges)
    assert np.count_nonzero(single(unsettled) != single(exact)) > 0.1 * units
    monkeypatch.setattr(Superposition, "single", lambda *_: pytest.fail("summed the quick way"))
    assert HapticTransform(RATE, 1, form="reference").process(signals.white_noise(0.2, RATE)).any()


@pytest.mark.parametrize("per_channel", [False, True])
@pytest.mark.parametrize(
    "sound",
    [
        *(
            signals.white_noise(3.0, RATE),
            signals.five_tones(3.0, RATE),
            signals.chirp(20.0, 20_000.0, 3.0, RATE),
        ),
        signals.silence(0.5, RATE),
    ],
    ids=["noise", "five tones", "chirp", "silence"],
)
def test_vibration_wanted_as_float32_is_the_reference_forms(sound, per_channel):
    both = signals.columns(sound, 0.3 * sound[::-1])
    options = {"form": "reference", "per_channel": per_channel}
    exact = signals.played(both, RATE, **options)
    for blocksize in (1_000, 32_768):
        blocks = [blocksize] * (sound.size // blocksize)
        quick = signals.in_blocks(both, blocks, RATE, single=True, **options)
        assert signals.identical(single(quick), single(exact))
        assert not (exact.any() and signals.identical(quick, exact))
