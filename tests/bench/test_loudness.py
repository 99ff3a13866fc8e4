"""Loudness: values of ISO 532-1, MoSQITo's whole procedure, and the cache."""

import numpy as np
import pytest

from tools.bench.measures import loudness
from tools.bench.measures.loudness import FULL_SCALE_PA, loudness_sone, n5_phon, phon, slow_phon
from tools.bench.sounds.signals import SAMPLERATE, tone

mosqito = pytest.importorskip("mosqito.sq_metrics")


def at_spl(frequency_hz, level_db, duration_s=0.6):
    """A sine of that sound pressure level, where a full-scale one has 94 dB."""
    return tone(frequency_hz, 10.0 ** ((level_db - 94.0) / 20.0), duration_s)


def pulse(duration_s):
    """A 1 kHz tone pulse of 70 dB, as the standard's test signals 10 to 12."""
    return np.concatenate((np.zeros(2_400), at_spl(1_000.0, 70.0, duration_s), np.zeros(12_000)))


# ISO 532-1:2017, annex B: test signals 2 to 4, and the definition of the sone.
@pytest.mark.parametrize(
    ("frequency_hz", "level_db", "sone"),
    [(1_000.0, 40.0, 1.0), (250.0, 80.0, 14.655), (1_000.0, 60.0, 4.019), (4_000.0, 40.0, 1.549)],
)
def test_steady_tones_have_the_standard_s_loudness_within_one_percent(frequency_hz, level_db, sone):
    settled = loudness_sone(at_spl(frequency_hz, level_db))[-200:]
    assert settled == pytest.approx(sone, rel=0.01)
    if frequency_hz == 1_000.0:
        assert phon(settled) == pytest.approx(level_db, abs=0.5)


@pytest.mark.parametrize("duration_s", [0.01, 0.05])
def test_the_coarser_decay_gives_pulses_the_loudness_of_the_whole_procedure(duration_s):
    signal = pulse(duration_s)
    whole = mosqito.loudness_zwtv(FULL_SCALE_PA * signal, SAMPLERATE)[0]
    ours = loudness_sone(signal)
    for measure in (np.max, lambda sone: np.percentile(sone, 95.0)):
        assert measure(ours) == pytest.approx(measure(whole), rel=0.02)


def test_loudness_over_time_follows_the_level_of_pieces():
    quiet, loud = at_spl(1_000.0, 50.0, 0.5), at_spl(1_000.0, 70.0, 0.5)
    levels = slow_phon(np.concatenate((quiet, loud)), 0.25)
    assert (levels.shape, levels[1]) == ((4,), pytest.approx(50.0, abs=0.5))
    assert levels[3] == pytest.approx(70.0, abs=0.5)


def test_what_was_computed_is_read_from_the_cache(monkeypatch, tmp_path):
    monkeypatch.setattr(loudness, "CACHE", tmp_path / "cache" / "loudness.json")
    monkeypatch.setattr(loudness, "_memory", {})
    signal = pulse(0.02)
    first = n5_phon(signal, 0.1)
    monkeypatch.setattr(loudness, "_memory", {})
    monkeypatch.setattr(loudness, "loudness_sone", lambda _: pytest.fail("computed again"))
    assert n5_phon(signal, 0.1) == first
