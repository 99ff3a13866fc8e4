"""Cosines added up two ways: where only float32 is wanted, the quick way gives the same float32."""

from itertools import pairwise

import numpy as np
import pytest

from audioflinger_hook.transform import HapticTransform, TransformParameters
from audioflinger_hook.transform.reference import Superposition
from tests.support.signals import chirp, five_tones, identical, silence, white_noise

RATE = 48_000


def single(values):
    return np.asarray(values, np.float32)


def units_of_partials(counts, top_hz=220.0, seed=3):
    """Weights and frequencies of units with so many partials each, and where they begin."""
    generator = np.random.default_rng(seed)
    edges = np.concatenate(([0], np.cumsum(counts)))
    weight = 10.0 ** generator.uniform(-4.0, 0.5, edges[-1])
    return weight, generator.uniform(10.0, top_hz, edges[-1]), edges


def both_ways(superposition, weight, hz, edges):
    exact = [
        superposition.exact(weight[first:end], hz[first:end]) for first, end in pairwise(edges)
    ]
    return np.stack(exact), superposition.single(weight, hz, edges)


@pytest.mark.parametrize(
    ("frames", "samplerate", "top_hz"),
    [(2_229, 48_000, 220.0), (2_048, 44_100, 220.0), (46, 1_000, 60.0), (38_400, 192_000, 400.0)],
)
def test_rounded_to_float32_every_sample_is_that_of_the_equation(frames, samplerate, top_hz):
    superposition = Superposition(frames, samplerate)
    counts = [3, 0, 16, 1, 64, 0] * 4
    exact, quick = both_ways(superposition, *units_of_partials(counts, top_hz))
    assert quick.shape == (len(counts), frames)
    assert identical(single(quick), single(exact))
    assert not quick[1].any()


def test_no_unit_with_a_partial_is_silence():
    superposition = Superposition(2_229, RATE)
    exact, quick = both_ways(superposition, *units_of_partials([0, 0]))
    assert identical(exact, quick)
    assert not quick.any()


def test_sums_on_an_edge_of_float32_go_the_way_that_the_equation_goes(monkeypatch):
    # One partial each, as strong as it takes to bring one frame half-way between two floats.
    frames, units = 2_229, 500
    generator = np.random.default_rng(5)
    hz, frame = generator.uniform(20.0, 220.0, units), generator.integers(1, frames, units)
    cosine = np.cos(hz * (2.0 * np.pi * np.arange(frames) / RATE)[frame])
    below = single(0.3 * cosine)
    weight = (0.5 * (below.astype(float) + np.nextafter(below, single(9.0)))) / cosine
    superposition, edges = Superposition(frames, RATE), np.arange(units + 1)
    exact, quick = both_ways(superposition, weight, hz, edges)
    assert identical(single(quick), single(exact))
    monkeypatch.setattr(Superposition, "_settle", lambda *_: None)
    unsettled = superposition.single(weight, hz, edges)
    assert np.count_nonzero(single(unsettled) != single(exact)) > 0.1 * units


def test_a_quick_sum_is_off_by_far_less_than_what_is_taken_for_its_error(monkeypatch):
    errors = []

    def noted(_, sums, weight, hz, edges):
        totals = np.add.reduceat(weight, edges[:-1])
        errors.append((sums.copy(), totals))

    monkeypatch.setattr(Superposition, "_settle", noted)
    superposition = Superposition(2_229, RATE)
    exact, quick = both_ways(superposition, *units_of_partials([16] * 200))
    ((_, totals),) = errors
    apart = np.abs(exact - quick).max(axis=1) / totals
    # The least that `_settle` takes for 16 partials under 220 Hz is 8 epsilons of 64 rad.
    assert apart.max() < 0.25 * 8 * 64 * 2.0**-52


@pytest.mark.parametrize("blocksize", [1_000, 32_768])
@pytest.mark.parametrize("per_channel", [False, True])
@pytest.mark.parametrize(
    "sound",
    [
        white_noise(3.0, RATE),
        five_tones(3.0, RATE),
        chirp(20.0, 20_000.0, 3.0, RATE),
        silence(0.5, RATE),
    ],
    ids=["noise", "five tones", "chirp", "silence"],
)
def test_vibration_wanted_as_float32_is_the_reference_forms(sound, per_channel, blocksize):
    sound = np.stack((sound, 0.3 * sound[::-1]), axis=1)
    made = []
    for rounded in (False, True):
        transform = HapticTransform(
            RATE, 2, form="reference", per_channel=per_channel, single=rounded
        )
        parts = [
            transform.process(sound[first : first + blocksize])
            for first in range(0, len(sound), blocksize)
        ]
        made.append(np.concatenate([*parts, transform.finish()]))
    assert identical(single(made[0]), single(made[1]))


def test_it_holds_with_every_partial_there_may_be():
    parameters = TransformParameters(threshold_hz=0.001, partials_max=64, vibration_top_hz=400.0)
    sound = white_noise(4.0, 22_050)
    exact, quick = (
        HapticTransform(22_050, 1, parameters, form="reference", single=rounded).process(sound)
        for rounded in (False, True)
    )
    assert np.abs(exact).max() > 0.001
    assert identical(single(exact), single(quick))
    assert not identical(exact, quick)


def test_unless_float32_is_asked_for_nothing_is_summed_the_quick_way(monkeypatch):
    monkeypatch.setattr(Superposition, "single", lambda *_: pytest.fail("summed the quick way"))
    assert HapticTransform(RATE, 1, form="reference").process(white_noise(0.2, RATE)).any()
